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
from diga3d_warp.scene.colmap import find_reconstruction, read_colmap, write_colmap
from diga3d_warp.scene.colmap_files import MODELS, camera_from_model, read_points

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
    "SIMPLE_RADIAL_FISHEYE": ([200.0, 119.0, 88.0, 0.1], 200.0, ("fisheye", 0.1, 0, 0, 0)),
    "RADIAL_FISHEYE": ([200.0, 119.0, 88.0, 0.1, 0.2], 200.0, ("fisheye", 0.1, 0.2, 0, 0)),
}


def project(camera, points: np.ndarray) -> np.ndarray:
    """Pixels of camera-space points, written from COLMAP's documentation, shape (P, 2)."""
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    if camera.distortion is not None:
        a, b, c, d = camera.distortion.coefficients
        if camera.distortion.kind == "brown":
            r2 = x**2 + y**2
            radial = 1 + a * r2 + b * r2**2
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


def test_every_model_has_a_case():
    assert set(PARAMETERS) == set(MODELS)


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

    capture = read_colmap(tmp_path, find_reconstruction(tmp_path))

    (shot,) = capture.shots
    assert shot.key == "left/view one"
    expected = Distortion(lens[0], lens[1:]) if lens else None
    same_camera(shot.camera, replace(shot.camera, fx=200.0, fy=fy, cx=119.0, cy=88.0, distortion=expected))
    np.testing.assert_allclose(shot.camera.pose, pose, atol=1e-12)
    rays = np.array([[0.3, 0.2, 1.0], [-0.4, 0.1, 1.2], [0.1, -0.3, 0.9]])
    np.testing.assert_allclose(project(shot.camera, rays), theirs.img_from_cam(rays), atol=1e-9)
    np.testing.assert_allclose(
        np.sort(capture.points.positions, 0), np.sort(corner.points.positions, 0), atol=1e-12
    )
    assert (capture.points.colors == [1, 2, 3]).all()


@pytest.mark.parametrize("lens", [None, ("brown", 0.1, 0.2, 0.01, 0.02), ("fisheye", 0.1, 0.2, 0.3, 0.4)])
def test_what_is_written_is_read_back(tmp_path, corner, lens):
    distortion = Distortion(lens[0], lens[1:]) if lens else None
    cameras = {name: replace(camera, distortion=distortion) for name, camera in corner.cameras.items()}
    for _ in range(2):  # the second time it replaces the first
        write_colmap(tmp_path, cameras, corner.points, suffix=".jpg")
    assert [p.name for p in (tmp_path / "sparse").iterdir()] == ["0"]

    capture = read_colmap(tmp_path, tmp_path / "sparse" / "0")

    assert {shot.key for shot in capture.shots} == set(cameras)
    for shot in capture.shots:
        same_camera(shot.camera, cameras[shot.key])
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


@pytest.mark.parametrize("form", ["bin", "txt"])
def test_unsupported_models_are_named(tmp_path, form):
    reconstruction = pycolmap.Reconstruction()
    camera = pycolmap.Camera(camera_id=1, model="FULL_OPENCV", width=9, height=9, params=[1.0] * 12)
    reconstruction.add_camera_with_trivial_rig(camera)
    image = pycolmap.Image(name="a.jpg", camera_id=1, image_id=1)
    reconstruction.add_image_with_trivial_frame(image, pycolmap.Rigid3d())
    reconstruction.write_binary(tmp_path) if form == "bin" else reconstruction.write_text(tmp_path)
    with pytest.raises(InputError, match=r"FULL_OPENCV is not supported; undistort"):
        read_colmap(tmp_path, tmp_path)


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
    assert len(read_points(tmp_path / "sparse/0/points3D.bin")) == len(positions) - 1
