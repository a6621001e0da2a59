"""COLMAP's cameras, images and points3D files, binary and text.

Read here rather than through `pycolmap.Reconstruction`, which hangs on an empty points3D.bin and refuses
a folder without images.bin, as LLFF captures have it. Format: https://colmap.github.io/format.html.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.scene.camera import Camera, Distortion, LensKind
from diga3d_warp.scene.scene import Points

# COLMAP's number of each model that is read here and the count of its parameters (sensor/models.h).
MODELS = {
    "SIMPLE_PINHOLE": (0, 3),
    "PINHOLE": (1, 4),
    "SIMPLE_RADIAL": (2, 4),
    "RADIAL": (3, 5),
    "OPENCV": (4, 8),
    "OPENCV_FISHEYE": (5, 8),
    "SIMPLE_RADIAL_FISHEYE": (8, 4),
    "RADIAL_FISHEYE": (9, 5),
}
_MODEL_OF_NUMBER = {number: name for name, (number, _) in MODELS.items()}
# Models that are refused, so that the refusal names them.
_REFUSED = {6: "FULL_OPENCV", 7: "FOV", 10: "THIN_PRISM_FISHEYE"}
_TWO_FOCALS = frozenset({"PINHOLE", "OPENCV", "OPENCV_FISHEYE"})


def find_file(folder: Path, stem: str) -> Path | None:
    """`stem`.bin or else `stem`.txt in a folder, or None."""
    candidates = (folder / f"{stem}.bin", folder / f"{stem}.txt")
    return next((path for path in candidates if path.is_file()), None)


def camera_from_model(model: str, width: int, height: int, parameters: list[float]) -> Camera:
    """A camera at the origin from COLMAP's model name and parameters.

    Raises:
        InputError: the model is not one of `MODELS`, or the count of parameters does not fit it.
    """
    if model not in MODELS:
        raise InputError(
            f"camera model {model} is not supported; undistort the images with `colmap image_undistorter`, "
            f"or use one of {', '.join(MODELS)}"
        )
    if len(parameters) != MODELS[model][1]:
        raise InputError(f"camera model {model} takes {MODELS[model][1]} parameters, not {len(parameters)}")
    focals = 2 if model in _TWO_FOCALS else 1
    fx, fy = parameters[0], parameters[focals - 1]
    cx, cy = parameters[focals : focals + 2]
    lens = parameters[focals + 2 :]
    k1, k2, k3, k4 = [*lens, 0.0, 0.0, 0.0, 0.0][:4]
    kind: LensKind = "fisheye" if model.endswith("FISHEYE") else "brown"
    distortion = Distortion(kind, (k1, k2, k3, k4)) if lens else None
    return Camera(width, height, fx, fy, cx, cy, torch.eye(4), distortion)


def read_cameras(path: Path) -> dict[int, Camera]:
    """Cameras at the origin, keyed by COLMAP's camera id.

    Raises:
        InputError: the file is damaged or holds a camera model that is not supported.
    """
    records = _binary_cameras(path) if path.suffix == ".bin" else _text_cameras(path)
    cameras = {}
    for number, model, width, height, parameters in records:
        try:
            cameras[number] = camera_from_model(model, width, height, parameters)
        except InputError as error:
            raise InputError(f"{path}: camera {number}: {error}") from None
    return cameras


def read_images(path: Path) -> dict[str, tuple[int, np.ndarray]]:
    """Camera id and world-to-camera transform, shape (4, 4), of each registered image, by name.

    Raises:
        InputError: the file is damaged.
    """
    records = _binary_images(path) if path.suffix == ".bin" else _text_images(path)
    return {name: (camera, _pose(pose, name, path)) for name, camera, pose in records}


def read_points(path: Path) -> Points:
    """Sparse points; those that are not finite are left out.

    Raises:
        InputError: the file is damaged.
    """
    records = list(_binary_points(path) if path.suffix == ".bin" else _text_points(path))
    positions = np.array([record[:3] for record in records], np.float64).reshape(-1, 3)
    colors = np.array([record[3:] for record in records], np.uint8).reshape(-1, 3)
    finite = np.isfinite(positions).all(axis=1)
    return Points(positions[finite], colors[finite])


def _pose(numbers: tuple[float, ...], name: str, path: Path) -> np.ndarray:
    length = np.linalg.norm(numbers[:4])
    # COLMAP writes unit quaternions; half of that leaves room for rounding in text files.
    if not (np.isfinite(numbers).all() and length > 0.5):
        raise InputError(f"{path}: the pose of {name} is not a rotation; rerun COLMAP or remove the image")
    w, x, y, z = np.array(numbers[:4]) / length
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    pose = np.eye(4)
    pose[:3, :3] += 2 * w * cross + 2 * cross @ cross
    pose[:3, 3] = numbers[4:7]
    return pose


class _Cursor:
    """Reads little-endian records one after another and refuses to run past the end of the file."""

    def __init__(self, path: Path) -> None:
        self.path, self.data, self.position = path, path.read_bytes(), 0

    def damaged(self, what: str) -> InputError:
        return InputError(f"{self.path}: {what}; copy the file again or rerun COLMAP")

    def take(self, layout: str) -> tuple:
        try:
            values = struct.unpack_from("<" + layout, self.data, self.position)
        except struct.error:
            raise self.damaged("the file ends too early or is damaged") from None
        self.position += struct.calcsize("<" + layout)
        return values

    def count(self, smallest_record: int) -> int:
        """A count of records that the rest of the file has room for."""
        (number,) = self.take("Q")
        if number * smallest_record > len(self.data) - self.position:
            raise self.damaged(f"it announces {number} records but ends too early, or it is damaged")
        return number

    def text(self) -> str:
        end = self.data.find(b"\0", self.position)
        if end < 0:
            raise self.damaged("the file ends too early or is damaged")
        raw, self.position = self.data[self.position : end], end + 1
        try:
            return raw.decode()
        except UnicodeDecodeError:
            raise self.damaged("an image name is not text: the file is damaged") from None

    def finish(self) -> None:
        if self.position != len(self.data):
            raise self.damaged(f"{len(self.data) - self.position} bytes follow the last record")


def _binary_cameras(path: Path) -> Iterator[tuple[int, str, int, int, list[float]]]:
    cursor = _Cursor(path)
    for _ in range(cursor.count(48)):
        number, model, width, height = cursor.take("IiQQ")
        if model not in _MODEL_OF_NUMBER:
            # The count of its parameters is unknown, so nothing after it can be read.
            yield number, _REFUSED.get(model, f"number {model}"), width, height, []
            return
        name = _MODEL_OF_NUMBER[model]
        yield number, name, width, height, list(cursor.take(f"{MODELS[name][1]}d"))
    cursor.finish()


def _binary_images(path: Path) -> Iterator[tuple[str, int, tuple[float, ...]]]:
    cursor = _Cursor(path)
    for _ in range(cursor.count(73)):
        _, *pose, camera = cursor.take("I7dI")
        name = cursor.text()
        observations = cursor.count(24)
        cursor.position += 24 * observations
        yield name, camera, tuple(pose)
    cursor.finish()


def _binary_points(path: Path) -> Iterator[tuple[float, ...]]:
    cursor = _Cursor(path)
    for _ in range(cursor.count(51)):
        _, *position_and_color, _ = cursor.take("Q3d3Bd")
        track = cursor.count(8)
        cursor.position += 8 * track
        yield tuple(position_and_color)
    cursor.finish()


def _lines(path: Path) -> list[str]:
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise InputError(f"{path}: the file is not text; copy it again or rerun COLMAP") from None
    return [line for line in text.splitlines() if not line.startswith("#")]


def _damaged_line(path: Path, line: str) -> InputError:
    return InputError(f"{path}: cannot read the line {line[:60]!r}; copy the file again or rerun COLMAP")


def _text_cameras(path: Path) -> Iterator[tuple[int, str, int, int, list[float]]]:
    for line in _lines(path):
        if not line.strip():
            continue
        try:
            number, model, width, height, *parameters = line.split()
            yield int(number), model, int(width), int(height), [float(p) for p in parameters]
        except ValueError:
            raise _damaged_line(path, line) from None


def _text_images(path: Path) -> Iterator[tuple[str, int, tuple[float, ...]]]:
    # Every image line is followed by a line of observations, which may be empty.
    for line in _lines(path)[::2]:
        if not line.strip():
            continue
        try:
            _, *pose, camera, name = line.strip().split(maxsplit=9)
            numbers = tuple(float(p) for p in pose)
            if len(numbers) != 7:
                raise ValueError
            yield name, int(camera), numbers
        except ValueError:
            raise _damaged_line(path, line) from None


def _text_points(path: Path) -> Iterator[tuple[float, ...]]:
    for line in _lines(path):
        if not line.strip():
            continue
        try:
            _, x, y, z, red, green, blue, *_ = line.split()
            yield float(x), float(y), float(z), int(red), int(green), int(blue)
        except ValueError:
            raise _damaged_line(path, line) from None
