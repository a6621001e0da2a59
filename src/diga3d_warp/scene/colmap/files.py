"""COLMAP's cameras, images and points3D files, binary and text.

Read here rather than through `pycolmap.Reconstruction`, which hangs on an empty points3D.bin and refuses
a folder without images.bin, as LLFF captures have it.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import numpy as np

from diga3d_warp.errors import InputError
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.colmap.binary import binary_cameras, binary_images, binary_points
from diga3d_warp.scene.colmap.models import camera_from_model
from diga3d_warp.scene.colmap.text import text_cameras, text_images, text_points
from diga3d_warp.scene.photographs.folders import entry
from diga3d_warp.scene.point_cloud import eight_bit
from diga3d_warp.scene.scene import Points

# Length of a pose's quaternion. COLMAP writes unit ones; the rest is room for rounding in text files.
_QUATERNION_LENGTHS = (0.5, 2.0)


def find_file(folder: Path, stem: str) -> Path | None:
    """`stem`.bin or else `stem`.txt in a folder, in upper or lower case; or None."""
    candidates = (entry(folder, f"{stem}{suffix}") for suffix in (".bin", ".txt"))
    return next((path for path in candidates if path is not None and path.is_file()), None)


def is_model(folder: Path) -> bool:
    """Whether a folder holds a reconstruction with images."""
    return find_file(folder, "cameras") is not None and find_file(folder, "images") is not None


def read_cameras(path: Path, used: Collection[int] | None = None) -> dict[int, Camera]:
    """Cameras at the origin, keyed by COLMAP's camera id.

    Args:
        path: cameras.bin or cameras.txt.
        used: Ids of the cameras that are wanted; None for all. Others may be of models that are not
            supported.

    Raises:
        InputError: the file is damaged, holds a camera twice, or a camera of a model that is not supported.
    """
    reader = binary_cameras if _is_binary(path) else text_cameras
    cameras: dict[int, Camera] = {}
    for number, model, width, height, parameters in reader(path, _read(path)):
        if used is not None and number not in used:
            continue
        if number in cameras:
            raise InputError(f"{path}: it holds camera {number} twice; use the files of one COLMAP run")
        try:
            cameras[number] = camera_from_model(model, width, height, parameters)
        except InputError as error:
            raise InputError(f"{path}: camera {number}: {error}") from None
    return cameras


def read_images(path: Path) -> list[tuple[str, int, np.ndarray]]:
    """Name, camera id and world-to-camera transform, shape (4, 4), of each registered image.

    Bytes of names that are not UTF-8 are kept as `surrogateescape` does.

    Raises:
        InputError: the file is damaged.
    """
    reader = binary_images if _is_binary(path) else text_images
    return [(name, camera, _pose(pose, name, path)) for name, camera, pose in reader(path, _read(path))]


def read_points(path: Path) -> tuple[Points, list[str]]:
    """Sparse points, and a note on those that are left out because they are not finite.

    Raises:
        InputError: the file is damaged.
    """
    reader = binary_points if _is_binary(path) else text_points
    records = list(reader(path, _read(path)))
    positions = np.array([record[:3] for record in records], np.float64).reshape(-1, 3)
    colors, notes = _colors(path, [record[3:] for record in records])
    finite = np.isfinite(positions).all(axis=1)
    if not finite.all():
        notes.append(f"{path}: left out {int((~finite).sum())} points with NaN or infinite positions")
    return Points(positions[finite], colors[finite]), notes


def _is_binary(path: Path) -> bool:
    return path.suffix.lower() == ".bin"


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise InputError(f"{path}: not readable ({reason}); copy it again or rerun COLMAP") from None


def _colors(path: Path, values: list[tuple[float, ...]]) -> tuple[np.ndarray, list[str]]:
    """Colours as uint8 (P, 3), and a note where their range was guessed."""
    colors = np.array(values, float if any(isinstance(v, float) for row in values for v in row) else int)
    colors = colors.reshape(-1, 3)
    wrong = ~(np.isfinite(colors) & (colors >= 0))
    if wrong.any():
        raise InputError(f"{path}: a colour is {colors[wrong][0]:g}, not 0 to 255; export the points again")
    if colors.dtype.kind == "i" and (colors <= 255).all():
        return colors.astype(np.uint8), []
    colors, note = eight_bit(colors)
    return colors, [f"{path}: {note}"] if note else []


def _pose(numbers: tuple[float, ...], name: str, path: Path) -> np.ndarray:
    length = np.linalg.norm(numbers[:4])
    shortest, longest = _QUATERNION_LENGTHS
    if not (np.isfinite(numbers).all() and shortest < length < longest):
        raise InputError(f"{path}: the pose of {name!r} is not a rotation; rerun COLMAP or remove the image")
    w, x, y, z = np.array(numbers[:4]) / length
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    pose = np.eye(4)
    pose[:3, :3] += 2 * w * cross + 2 * cross @ cross
    pose[:3, 3] = numbers[4:7]
    return pose
