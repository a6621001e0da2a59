"""The cameras file: nothing is lost, 3DGS's own files are read, broken ones are refused in one line."""

import json

import numpy as np
import pytest

from diga3d_warp.errors import InputError
from diga3d_warp.scene.camera import Camera, Distortion, look_at
from diga3d_warp.scene.cameras_file import CameraSet, load_cameras, save_cameras


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
        ({"fx": float("nan")}, "not finite"),
        ({"rotation": [[1, 0], [0, 1]]}, "entry 0 is not a camera"),
        ({"split": "validation"}, "'validation' is missing or unknown"),
        ({"distortion": {"kind": "brown"}}, "'coefficients' is missing"),
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


def test_broken_file_is_named(tmp_path):
    path = tmp_path / "cameras.json"
    for text, said in (("[", "not valid JSON"), ("[]", "no list of cameras"), ("[3]", "entry 0 is not")):
        path.write_text(text)
        with pytest.raises(InputError, match=said):
            load_cameras(path)
    with pytest.raises(InputError, match="cannot be read"):
        load_cameras(tmp_path / "absent.json")
