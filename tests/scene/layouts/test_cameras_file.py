"""The cameras file: nothing is lost, 3DGS's own files are read, broken ones are refused in one line."""

import json

import numpy as np
import pytest

from diga3d_warp.errors import InputError
from diga3d_warp.scene.camera import Camera, Distortion, look_at
from diga3d_warp.scene.layouts.cameras_file import CameraSet, load_cameras, save_cameras


def camera(eye, distortion=None) -> Camera:
    return Camera(64, 48, 70.0, 71.5, 30.25, 25.0, look_at(eye, np.zeros(3)), distortion)


def test_round_trip(tmp_path):
    lens = Distortion("fisheye", (0.1, -0.02, 0.003, 1e-4))
    cameras = CameraSet(
        {"a": camera([3.0, 1.0, 2.0], lens), "b": camera([0.1, -4.0, 1.0])}, {"c": camera([1.0, 2, 3])}
    )
    save_cameras(tmp_path / "cameras.json", cameras)
    back = load_cameras(tmp_path / "cameras.json")
    assert list(back.train) == ["a", "b"]
    assert list(back.test) == ["c"]
    for group in ("train", "test"):
        for name, expected in getattr(cameras, group).items():
            read = getattr(back, group)[name]
            for key in ("width", "height", "fx", "fy", "cx", "cy", "distortion"):
                assert getattr(read, key) == getattr(expected, key)
            np.testing.assert_allclose(read.pose, expected.pose, atol=1e-14)


def test_file_of_3dgs_is_read(tmp_path):
    # Rotation is camera to world: this camera stands at (1, 2, 3), its axes turned by 90 degrees about z.
    entry = {
        "id": 0, "img_name": "00001", "width": 100, "height": 50, "position": [1, 2, 3],
        "rotation": [[0, -1, 0], [1, 0, 0], [0, 0, 1]], "fx": 80, "fy": 80,
    }  # fmt: skip
    (tmp_path / "cameras.json").write_text(json.dumps([entry]))
    read = load_cameras(tmp_path / "cameras.json").train["00001"]
    assert (read.cx, read.cy, read.distortion) == (50, 25, None)
    np.testing.assert_allclose(read.center, [1, 2, 3])
    np.testing.assert_allclose(read.pose[0, :3], [0, 1, 0])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"fx": None}, "entry 0 is not a camera"),
        ({"rotation": [[1, 0], [0, 1]]}, "entry 0 is not a camera"),
        ({"fx": float("nan")}, "fx is nan, not a number"),
        ({"width": "wide"}, "width is 'wide', not a number"),
        ({"height": -48}, "sees nothing"),
        ({"img_name": None}, "img_name is None, not a name"),
        ({"img_name": ["a"]}, "not a name"),
        ({"position": [0, 1]}, r"shapes \(3, 3\) and \(2,\)"),
        ({"position": "here"}, "position is 'here', not a table of numbers"),
        ({"position": [0, 0, float("inf")]}, "not finite"),
        ({"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}, "mirror image"),
        ({"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 0]]}, "not a rotation"),
        ({"rotation": [[1, 0, 0], [0, 2, 0], [0, 0, 1]]}, "not a rotation"),
        ({"k1": 0.1}, "k1 is 0.1, but 3DGS cameras have no lens"),
        ({"split": "validation"}, "split is 'validation', neither 'train' nor 'test'"),
        ({"distortion": 3}, "distortion is 3, not a kind"),
        ({"distortion": {"kind": "brown"}}, "coefficients is missing"),
        ({"distortion": {"kind": "odd", "coefficients": [0] * 4}}, "lens kind 'odd' is unknown"),
        ({"distortion": {"kind": "brown", "coefficients": [0] * 3}}, "must be 4 numbers"),
    ],
)
def test_broken_entry_is_named(tmp_path, change, said):
    path = tmp_path / "cameras.json"
    save_cameras(path, CameraSet({"a": camera([3.0, 1.0, 2.0])}))
    entries = json.loads(path.read_text())
    path.write_text(json.dumps([{**entries[0], **change}]))
    with pytest.raises(InputError, match=said) as error:
        load_cameras(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_numbers_as_text_and_null(tmp_path):
    path = tmp_path / "cameras.json"
    save_cameras(path, CameraSet({"a": camera([3.0, 1.0, 2.0])}))
    (entry,) = json.loads(path.read_text())
    path.write_text(json.dumps([{**entry, "img_name": 7, "width": "64.0", "cx": None, "cy": None, "k1": 0}]))
    read = load_cameras(path).train["7"]
    assert (read.width, read.cx, read.cy) == (64, 32, 24)


@pytest.mark.parametrize("split", ["train", "test"])
def test_two_cameras_of_one_name_are_refused(tmp_path, split):
    """3DGS names images without their folders, so nothing tells which of two files is meant."""
    path = tmp_path / "cameras.json"
    save_cameras(path, CameraSet({"left/a": camera([3.0, 1.0, 2.0])}, {"right/a": camera([2.0, 1.0, 2.0])}))
    assert len(load_cameras(path).test) == 1
    entries = json.loads(path.read_text())
    path.write_text(
        json.dumps([{**entries[0], "img_name": "a"}, {**entries[1], "img_name": "a", "split": split}])
    )
    with pytest.raises(InputError, match=r"cameras\.json: two cameras are called a: 3DGS leaves out folders"):
        load_cameras(path)


def test_broken_file_is_named(tmp_path):
    path = tmp_path / "cameras.json"
    for text, said in (("[", "not valid JSON"), ("[]", "no list of cameras"), ("[3]", "entry 0 is not")):
        path.write_text(text)
        with pytest.raises(InputError, match=said):
            load_cameras(path)
    with pytest.raises(InputError, match="cannot be read"):
        load_cameras(tmp_path / "absent.json")
