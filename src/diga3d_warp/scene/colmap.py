"""COLMAP reconstructions: `sparse/` folders in and out."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from diga3d_warp.errors import InputError
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.capture import Capture, Shot, image_folders, image_key, inside
from diga3d_warp.scene.colmap_files import find_file, read_cameras, read_images, read_points
from diga3d_warp.scene.scene import Points

if TYPE_CHECKING:
    import pycolmap


# Where COLMAP, nerfstudio and people put a reconstruction, below the scene folder.
_SPARSE_FOLDERS = ("sparse/0", "sparse", "colmap/sparse/0")


def find_reconstruction(root: Path) -> Path | None:
    """The folder below `root` that holds a COLMAP reconstruction with images, or None."""
    folders = (root / name for name in _SPARSE_FOLDERS)
    return next((f for f in folders if find_file(f, "cameras") and find_file(f, "images")), None)


def read_colmap(root: Path, reconstruction: Path) -> Capture:
    """Read a COLMAP scene.

    Args:
        root: Scene folder with `images` or `images_N`.
        reconstruction: Folder with the cameras, images and points3D files, .bin or .txt; points3D may be
            missing.

    Raises:
        InputError: a file is missing or damaged, an image names a camera that is not there, or a camera
            model is not supported.
    """
    cameras_file, images_file = find_file(reconstruction, "cameras"), find_file(reconstruction, "images")
    if cameras_file is None or images_file is None:
        raise InputError(f"{reconstruction}: the cameras or images file is missing; rerun COLMAP")
    images = read_images(images_file)
    cameras = read_cameras(cameras_file, {number for _, number, _ in images})
    shots = []
    for name, number, pose in images:
        if number not in cameras:
            raise InputError(
                f"{images_file}: {name!r} was taken with camera {number}, which {cameras_file.name} lacks; "
                "use the files of one COLMAP run"
            )
        key = image_key(inside(root, name, images_file))
        try:
            shots.append(Shot(key, cameras[number].with_pose(pose)))
        except InputError as error:
            raise InputError(f"{images_file}: {name!r}: {error}") from None
    points_file = find_file(reconstruction, "points3D")
    points, notes = read_points(points_file) if points_file else (None, [])
    return Capture("colmap", shots, image_folders(root), points, notes)


def colmap_lens(camera: Camera) -> tuple[str, list[float]]:
    """COLMAP's name and parameters of a camera's lens: PINHOLE, OPENCV, FULL_OPENCV or OPENCV_FISHEYE."""
    focal_and_center = [camera.fx, camera.fy, camera.cx, camera.cy]
    lens = camera.distortion
    if lens is None:
        return "PINHOLE", focal_and_center
    if lens.kind == "brown5":
        return "FULL_OPENCV", [*focal_and_center, *lens.coefficients, 0.0, 0.0, 0.0]
    model = "OPENCV" if lens.kind == "brown" else "OPENCV_FISHEYE"
    return model, [*focal_and_center, *lens.coefficients]


def posed_reconstruction(cameras: Mapping[str, Camera]) -> pycolmap.Reconstruction:
    """A pycolmap reconstruction of posed images without points.

    Args:
        cameras: Camera of each image, keyed by image name with its ending. Identifiers count from 1 in
            sorted order of the names.
    """
    import pycolmap

    reconstruction = pycolmap.Reconstruction()
    for number, name in enumerate(sorted(cameras), start=1):
        camera = cameras[name]
        model, parameters = colmap_lens(camera)
        reconstruction.add_camera_with_trivial_rig(
            pycolmap.Camera(
                camera_id=number, model=model, width=camera.width, height=camera.height, params=parameters
            )
        )
        image = pycolmap.Image(name=name, camera_id=number, image_id=number)
        reconstruction.add_image_with_trivial_frame(image, pycolmap.Rigid3d(camera.pose[:3]))
    return reconstruction


def write_colmap(folder: Path, cameras: Mapping[str, Camera], points: Points, suffix: str = ".png") -> None:
    """Write `folder`/sparse/0 in COLMAP's binary form, replacing one that is there.

    Args:
        folder: Scene folder; made if missing. The images themselves are the caller's.
        cameras: Camera of each image, keyed by image name without ending.
        points: Sparse points; written without tracks.
        suffix: Ending of the image files.
    """
    import pycolmap

    reconstruction = posed_reconstruction({name + suffix: camera for name, camera in cameras.items()})
    for position, color in zip(points.positions, points.colors, strict=True):
        reconstruction.add_point3D(np.asarray(position, np.float64), pycolmap.Track(), color)
    finished = Path(folder) / "sparse" / "0"
    partial = finished.with_name("0.partial")
    if partial.exists():
        shutil.rmtree(partial)
    partial.mkdir(parents=True)
    reconstruction.write_binary(partial)
    if finished.exists():
        shutil.rmtree(finished)
    partial.rename(finished)
