"""COLMAP reconstructions: camera models, `sparse/` folders in and out."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.scene import Points

if TYPE_CHECKING:
    import pycolmap


def colmap_lens(camera: Camera) -> tuple[str, list[float]]:
    """COLMAP's name and parameters of a camera's lens: PINHOLE, OPENCV or OPENCV_FISHEYE."""
    focal_and_center = [camera.fx, camera.fy, camera.cx, camera.cy]
    if camera.distortion is None:
        return "PINHOLE", focal_and_center
    model = "OPENCV" if camera.distortion.kind == "brown" else "OPENCV_FISHEYE"
    return model, [*focal_and_center, *camera.distortion.coefficients]


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
    for leftover in (partial, finished):
        if leftover.exists():
            shutil.rmtree(leftover)
    partial.mkdir(parents=True)
    reconstruction.write_binary(partial)
    partial.rename(finished)
