"""COLMAP folders: every camera model, binary and text, against pycolmap; damaged files in one line."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from corner import same_camera

from diga3d_warp.errors import InputError
from diga3d_warp.scene.camera import Distortion
from diga3d_warp.scene.colmap.files import read_cameras, read_images, read_points
from diga3d_warp.scene.colmap.models import MODELS, camera_from_model, parameter_count
from diga3d_warp.scene.colmap.reconstruction import choose_reconstruction, read_colmap, write_colmap
from diga3d_warp.scene.scene import Points

# One set of parameters a model, and the same lens in our words.
PARAMETERS = {
    "SIMPLE_PINHOLE": ([200.0, 119.0, 88.0], 200.0, None),
    "PINHOLE": ([200.0, 210.0, 119.0, 88.0], 210.0, None),
    "SIMPLE_RADIAL": ([200.0, 119.0, 88.0, 0.05], 200.0, ("brown", 0.05, 0, 0, 0)),
    "RADIAL": ([200.0, 119.0, 88.0, 0.05, -0.02], 200.0, ("brown", 0.05, -0.02, 0, 0)),
    "OPENCV": (
        [200.0, 210.0, 119.0, 88.0, 0.05, -0.02, 1e-3, 2e-3],
        210.0,
        ("brown", 0.05, -0.02, 1e-3, 2e-3),
    ),
    "OPENCV_FISHEYE": (
        [200.0, 210.0, 119.0, 88.0, 0.1, 0.2, 0.3, 0.4],
        210.0,
        ("fisheye", 0.1, 0.2, 0.3, 0.4),
    ),
    "FULL_OPENCV": (
        [200.0, 210.0, 119.0, 88.0, 0.05, -0.02, 1e-3, 2e-3, 0.3, 0.0, 0.0, 0.0],
        210.0,
        ("brown5", 0.05, -0.02, 1e-3, 2e-3, 0.3),
    ),
    "FOV": ([200.0, 210.0, 119.0, 88.0, 0.0], 210.0, None),
    "THIN_PRISM_FISHEYE": (
        [200.0, 210.0, 119.0, 88.0, 0.1, 0.2, 0.0, 0.0, 0.3, 0.4, 0.0, 0.0],
        210.0,
        ("fisheye", 0.1, 0.2, 0.3, 0.4),
    ),
    "RAD_TAN_THIN_PRISM_FISHEYE": (
        [200.0, 210.0, 119.0, 88.0, 0.1, 0.2, 0.3, 0.4, *[0.0] * 8],
        210.0,
        ("fisheye", 0.1, 0.2, 0.3, 0.4),
    ),
    "SIMPLE_DIVISION": ([200.0, 119.0, 88.0, 0.0], 200.0, None),
    "DIVISION": ([200.0, 210.0, 119.0, 88.0, 0.0], 210.0, None),
    "SIMPLE_FISHEYE": ([200.0, 119.0, 88.0], 200.0, ("fisheye", 0, 0, 0, 0)),
    "FISHEYE": ([200.0, 210.0, 119.0, 88.0], 210.0, ("fisheye", 0, 0, 0, 0)),
    "EUCM": ([200.0, 210.0, 119.0, 88.0, 0.0, 1.5], 210.0, None),
    "SIMPLE_RADIAL_FISHEYE": ([200.0, 119.0, 88.0, 0.1], 200.0, ("fisheye", 0.1, 0, 0, 0)),
    "RADIAL_FISHEYE": ([200.0, 119.0, 88.0, 0.1, 0.2], 200.0, ("fisheye", 0.1, 0.2, 0, 0)),
}


def project(camera, points: np.ndarray) -> np.ndarray:
    """Pixels of camera-space points, written from COLMAP's documentation, shape (P, 2)."""
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    if camera.distortion is not None:
        a, b, c, d, *more = camera.distortion.coefficients
        if camera.distortion.kind != "fisheye":
            r2 = x**2 + y**2
            radial = 1 + a * r2 + b * r2**2 + sum(more) * r2**3
            x, y = (
                x * radial + 2 * c * x * y + d * (r2 + 2 * x**2),
                y * radial + 2 * d * x * y + c * (r2 + 2 * y**2),
            )
        else:
            radius = np.hypot(x, y)
            theta = np.arctan(radius)
            bent = theta * (1 + a * theta**2 + b * theta**4 + c * theta**6 + d * theta**8)
            x, y = x * bent / radius, y * bent / radius
    return np.stack([camera.fx * x + camera.cx, camera.fy * y + camera.cy], 1)


def test_models_are_those_of_pycolmap():
    theirs = {}
    for name, model in pycolmap.CameraModelId.__members__.items():
        if name != "INVALID":
            count = len(pycolmap.Camera.create_from_model_name(1, name, 100.0, 20, 10).params)
            theirs[name] = (int(model.value if hasattr(model, "value") else model), count)
    assert theirs == {name: (number, parameter_count(name)) for name, (number, _) in MODELS.items()}
    assert {*PARAMETERS, "EQUIRECTANGULAR"} == set(MODELS)


@pytest.mark.parametrize("model", PARAMETERS)
@pytest.mark.parametrize("form", ["bin", "txt"])
def test_camera_models_agree_with_pycolmap(tmp_path, corner, model, form):
    parameters, fy, lens = PARAMETERS[model]
    pose = next(iter(corner.cameras.values())).pose
    reconstruction = pycolmap.Reconstruction()
    theirs = pycolmap.Camera(camera_id=3, model=model, width=240, height=180, params=parameters)
    reconstruction.add_camera_with_trivial_rig(theirs)
    image = pycolmap.Image(name="left/view one.jpg", camera_id=3, image_id=9)
    reconstruction.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose[:3]))
    for position in corner.points.positions:
        reconstruction.add_point3D(position, pycolmap.Track(), np.array([1, 2, 3], np.uint8))
    sparse = tmp_path / "sparse"
    sparse.mkdir()
    reconstruction.write_binary(sparse) if form == "bin" else reconstruction.write_text(sparse)

    capture = read_colmap(tmp_path, choose_reconstruction(tmp_path).folder)

    (shot,) = capture.shots
    assert shot.name == "left/view one.jpg"
    expected = Distortion(lens[0], lens[1:]) if lens else None
    same_camera(shot.camera, replace(shot.camera, fx=200.0, fy=fy, cx=119.0, cy=88.0, distortion=expected))
    np.testing.assert_allclose(shot.camera.pose, pose, atol=1e-12)
    rays = np.array([[0.3, 0.2, 1.0], [-0.4, 0.1, 1.2], [0.1, -0.3, 0.9]])
    np.testing.assert_allclose(project(shot.camera, rays), theirs.img_from_cam(rays), atol=1e-9)
    np.testing.assert_allclose(
        np.sort(capture.points.positions, 0), np.sort(corner.points.positions, 0), atol=1e-12
    )
    assert (capture.points.colors == [1, 2, 3]).all()


@pytest.mark.parametrize(
    "lens",
    [
        None,
        ("brown", 0.1, 0.2, 0.01, 0.02),
        ("brown5", 0.1, 0.2, 0.01, 0.02, 0.3),
        ("fisheye", 0.1, 0.2, 0.3, 0.4),
    ],
)
def test_what_is_written_is_read_back(tmp_path, corner, lens):
    distortion = Distortion(lens[0], lens[1:]) if lens else None
    cameras = {name: replace(camera, distortion=distortion) for name, camera in corner.cameras.items()}
    for _ in range(2):  # the second time it replaces the first
        write_colmap(tmp_path, cameras, corner.points, suffix=".jpg")
    assert [p.name for p in (tmp_path / "sparse").iterdir()] == ["0"]

    capture = read_colmap(tmp_path, tmp_path / "sparse" / "0")

    assert {shot.name for shot in capture.shots} == {f"{name}.jpg" for name in cameras}
    for shot in capture.shots:
        same_camera(shot.camera, cameras[shot.name.removesuffix(".jpg")])
    np.testing.assert_array_equal(capture.points.positions, corner.points.positions)
    np.testing.assert_array_equal(capture.points.colors, corner.points.colors)
    assert pycolmap.Reconstruction(tmp_path / "sparse" / "0").num_reg_images() == len(cameras)


@pytest.mark.parametrize("stem", ["cameras", "images", "points3D"])
@pytest.mark.parametrize("damage", ["empty", "half", "junk", "huge count", "longer"])
def test_damaged_binary_files_are_named(colmap_scene: Path, stem, damage):
    path = colmap_scene / "sparse" / "0" / f"{stem}.bin"
    data = path.read_bytes()
    path.write_bytes(
        {
            "empty": b"",
            "half": data[: len(data) // 2],
            "junk": b"\x07" * len(data),
            "huge count": b"\xff" * 8 + data[8:],
            "longer": data + b"\0",
        }[damage]
    )
    with pytest.raises(InputError, match=rf"{stem}\.bin: .*; .*COLMAP") as caught:
        read_colmap(colmap_scene, path.parent)
    assert "\n" not in str(caught.value)


def write_small(folder: Path, corner) -> None:
    """Two images and three points."""
    points = Points(corner.points.positions[:3], corner.points.colors[:3])
    write_colmap(folder, dict(list(corner.cameras.items())[:2]), points)


@pytest.mark.parametrize("stem", ["cameras", "images", "points3D"])
def test_a_binary_file_cut_anywhere_is_refused(tmp_path, corner, stem):
    write_small(tmp_path, corner)
    path = tmp_path / "sparse" / "0" / f"{stem}.bin"
    data = path.read_bytes()
    read = {"cameras": read_cameras, "images": read_images, "points3D": read_points}[stem]
    read(path)
    for length in range(len(data)):
        path.write_bytes(data[:length])
        with pytest.raises(InputError, match=rf"{stem}\.bin: .*; copy the file again or rerun COLMAP"):
            read(path)


@pytest.mark.parametrize("stem", ["cameras", "images", "points3D"])
def test_a_binary_file_with_a_bit_changed_anywhere_is_read_or_refused(tmp_path, corner, stem):
    write_small(tmp_path, corner)
    sparse = tmp_path / "sparse" / "0"
    data = (sparse / f"{stem}.bin").read_bytes()
    for place in range(0, len(data), 3):
        damaged = bytearray(data)
        damaged[place] ^= 1 << (7 - place % 8)
        (sparse / f"{stem}.bin").write_bytes(damaged)
        try:
            read_colmap(tmp_path, sparse)
        except InputError as error:
            assert "\n" not in str(error) and str(error).encode()


@pytest.mark.parametrize("stem", ["cameras", "images", "points3D"])
@pytest.mark.parametrize("content", ["1 what", "\u00e4 \u00f6 \u00fc", b"\xff\xfe\x00junk"])
def test_damaged_text_files_are_named(colmap_scene: Path, stem, content):
    sparse = colmap_scene / "sparse" / "0"
    pycolmap.Reconstruction(sparse).write_text(sparse)
    for path in sparse.glob("*.bin"):
        path.unlink()
    assert len(read_colmap(colmap_scene, sparse).shots) == 6
    (sparse / f"{stem}.txt").write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputError, match=rf"{stem}\.txt: "):
        read_colmap(colmap_scene, sparse)


BENDING = {
    "FULL_OPENCV": "k5",
    "FOV": "omega",
    "THIN_PRISM_FISHEYE": "sy1",
    "RAD_TAN_THIN_PRISM_FISHEYE": "s4",
    "SIMPLE_DIVISION": "k",
    "DIVISION": "k",
    "EUCM": "alpha",
    "EQUIRECTANGULAR": "",
}
"""A parameter of each model that is not followed."""


@pytest.mark.parametrize("model", BENDING)
@pytest.mark.parametrize("form", ["bin", "txt"])
def test_unsupported_lenses_are_named_unless_no_image_uses_them(tmp_path, form, model):
    reconstruction = pycolmap.Reconstruction()
    bent = pycolmap.Camera.create_from_model_name(1, model, 9.0, 9, 9)
    if name := BENDING[model]:
        names = MODELS[model][1].split()
        bent.params = [bent.params[i] if n in ("f", "fx", "fy", "cx", "cy") else 0.25 * (n == name)
                       for i, n in enumerate(names)]  # fmt: skip
    for number, camera in ((1, bent), (2, pycolmap.Camera.create_from_model_name(2, "PINHOLE", 9.0, 9, 9))):
        reconstruction.add_camera_with_trivial_rig(camera)
        image = pycolmap.Image(name=f"{number}.jpg", camera_id=number, image_id=number)
        reconstruction.add_image_with_trivial_frame(image, pycolmap.Rigid3d())
    reconstruction.write_binary(tmp_path) if form == "bin" else reconstruction.write_text(tmp_path)
    said = (
        f"{model} with {name} = 0.25 is not supported; undistort"
        if name
        else f"{model} is not supported; cut"
    )
    with pytest.raises(InputError, match=rf"cameras\.{form}: camera 1: camera model {said}"):
        read_colmap(tmp_path, tmp_path)
    assert list(read_cameras(tmp_path / f"cameras.{form}", {2})) == [2]


def test_an_unknown_model_in_text_is_named_unless_no_image_uses_it(tmp_path):
    path = tmp_path / "cameras.txt"
    path.write_text("1 PINHOLE 9 9 9 9 4.5 4.5\n2 SPIRAL 9 9 1 2 3\n")
    assert list(read_cameras(path, {1})) == [1]
    with pytest.raises(InputError, match="camera 2: camera model SPIRAL is not known; undistort"):
        read_cameras(path)


def test_a_camera_that_is_there_twice(tmp_path):
    path = tmp_path / "cameras.txt"
    path.write_text("1 PINHOLE 9 9 9 9 4.5 4.5\n1 PINHOLE 9 9 8 8 4.5 4.5\n")
    with pytest.raises(InputError, match=r"cameras\.txt: it holds camera 1 twice"):
        read_cameras(path)


def test_wrong_count_of_parameters():
    with pytest.raises(InputError, match="takes 4 parameters, not 3"):
        camera_from_model("PINHOLE", 9, 9, [1.0, 1.0, 1.0])


def test_an_image_of_an_unknown_camera(colmap_scene: Path, tmp_path_factory, corner):
    other = tmp_path_factory.mktemp("other")
    name, camera = next(iter(corner.cameras.items()))
    write_colmap(other, {name: camera}, corner.points)
    shutil.copy(other / "sparse/0/cameras.bin", colmap_scene / "sparse/0/cameras.bin")
    with pytest.raises(InputError, match=r"camera 2, which cameras\.bin lacks"):
        read_colmap(colmap_scene, colmap_scene / "sparse/0")


def test_a_name_outside_the_scene(tmp_path, corner):
    name, camera = next(iter(corner.cameras.items()))
    write_colmap(tmp_path, {"../../" + name: camera}, corner.points)
    with pytest.raises(InputError, match="leaves the scene folder"):
        read_colmap(tmp_path, tmp_path / "sparse/0")


def test_points_that_are_not_finite_are_left_out(tmp_path, corner):
    positions = corner.points.positions.copy()
    positions[3, 1] = np.nan
    write_colmap(tmp_path, corner.cameras, replace(corner.points, positions=positions))
    points, notes = read_points(tmp_path / "sparse/0/points3D.bin")
    assert len(points) == len(positions) - 1 and "left out 1 points" in notes[0]
