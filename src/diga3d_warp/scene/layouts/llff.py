"""LLFF captures (and SPIn-NeRF's): poses_bounds.npy, one row per image in sorted order."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.capture import Capture, Shot
from diga3d_warp.scene.colmap.files import find_file, read_cameras, read_points
from diga3d_warp.scene.photographs.folders import image_folders, images_below
from diga3d_warp.scene.poses import world_to_camera
from diga3d_warp.state import read_array

_REMEDY = "run LLFF's imgs2poses again"


def _rows(path: Path) -> np.ndarray:
    rows = read_array(path, _REMEDY)
    if rows.dtype.kind not in "fiu" or rows.ndim != 2 or rows.shape[1] != 17:
        raise InputError(f"{path}: expected one row of 17 numbers per image; {_REMEDY}")
    return rows.astype(np.float64)


def _camera(row: np.ndarray, lens: Camera | None) -> Camera:
    """The camera of a row; its pose has the columns down, right, backwards, centre."""
    matrix = row[:15].reshape(3, 5)
    (down, right, backwards, center), (height, width, focal) = matrix[:, :4].T, matrix[:, 4].tolist()
    if not (np.isfinite(row).all() and min(height, width, focal) > 0):
        raise InputError("it is not a camera")
    pose = world_to_camera(np.stack([right, down, -backwards], axis=1), center)
    own = lens or Camera(round(width), round(height), focal, focal, width / 2, height / 2, torch.eye(4))
    return own.with_pose(pose)


def _shared_lens(sparse: Path) -> tuple[Camera | None, list[str]]:
    """The one camera of sparse/0, with its distortion; None where there are none or several.

    Without the images file nothing tells which of several cameras took an image.
    """
    cameras_file = find_file(sparse, "cameras")
    cameras = list(read_cameras(cameras_file).values()) if cameras_file else []
    if len(cameras) == 1:
        return cameras[0], []
    bent = any(camera.distortion for camera in cameras)
    return None, [
        f"{cameras_file}: of several cameras the lens is not used: no images file says whose"
    ] * bent


def _complete(files: Sequence[Path], count: int) -> Sequence[Path] | None:
    """The images that rows belong to: all of a folder, or all of one ending where masks lie beside them."""
    endings = sorted({file.suffix for file in files})
    groups = [files, *([file for file in files if file.suffix == ending] for ending in endings)]
    return next((group for group in groups if len(group) == count), None)


def read_llff(root: Path, path: Path) -> Capture:
    """Read an LLFF scene: poses_bounds.npy with images, and lens and points of sparse/0 if they are there.

    Poses stay in COLMAP's world, which LLFF does not change, so the points of sparse/0 belong to them.

    Args:
        root: Scene folder.
        path: The file.

    Raises:
        InputError: the file is damaged, or no image folder holds as many images as it has rows.
    """
    rows = _rows(path)
    folders = image_folders(root)
    # SPIn-NeRF keeps masks in subfolders of the image folders: only the images at the top have rows.
    tops = {
        n: [file for file in images_below(folder) if file.parent == folder] for n, folder in folders.items()
    }
    # The rows name no images: only a complete folder tells which row is whose.
    complete = next((files for top in tops.values() if (files := _complete(top, len(rows)))), None)
    if complete is None:
        counts = ", ".join(f"{len(top)} in {folders[factor].name}" for factor, top in tops.items())
        raise InputError(
            f"{path}: {len(rows)} poses but {counts or 'no images'}; rows and images are matched by sorted "
            "order, so restore the missing images"
        )
    sparse = root / "sparse" / "0"
    lens, notes = _shared_lens(sparse)
    shots = []
    for file, row in zip(complete, rows, strict=True):
        try:
            shots.append(Shot(file.name, _camera(row, lens)))
        except InputError as error:
            raise InputError(f"{path}: the row of {file.name}: {error}; {_REMEDY}") from None
    points_file = find_file(sparse, "points3D")
    points, said = read_points(points_file) if points_file else (None, [])
    return Capture("llff", shots, folders, points, [*notes, *said])
