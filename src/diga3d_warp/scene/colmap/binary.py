"""Records of COLMAP's binary files. Format: https://colmap.github.io/format.html."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

from diga3d_warp.errors import InputError
from diga3d_warp.scene.colmap.models import MODELS, parameter_count

_MODEL_OF_NUMBER = {number: name for name, (number, _) in MODELS.items()}


class _Cursor:
    """Reads little-endian records one after another and refuses to run past the end of the file."""

    def __init__(self, path: Path, data: bytes) -> None:
        self.path, self.data, self.position = path, data, 0

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
        """A number of records, checked against the rest of the file."""
        (number,) = self.take("Q")
        if number * smallest_record > len(self.data) - self.position:
            raise self.damaged(f"it announces {number} records but ends too early, or it is damaged")
        return number

    def text(self) -> str:
        end = self.data.find(b"\0", self.position)
        if end < 0:
            raise self.damaged("the file ends too early or is damaged")
        raw, self.position = self.data[self.position : end], end + 1
        return raw.decode("utf-8", "surrogateescape")

    def finish(self) -> None:
        if self.position != len(self.data):
            raise self.damaged(f"{len(self.data) - self.position} bytes follow the last record")


def binary_cameras(path: Path, data: bytes) -> Iterator[tuple[int, str, int, int, list[float]]]:
    """Camera id, model, width, height and parameters of each camera of a cameras.bin.

    Raises:
        InputError: the file is damaged, or holds a model whose count of parameters is unknown.
    """
    cursor = _Cursor(path, data)
    for _ in range(cursor.count(40)):
        number, model, width, height = cursor.take("IiQQ")
        if model not in _MODEL_OF_NUMBER:
            raise cursor.damaged(
                f"camera {number} has model number {model}, unknown to COLMAP 4.2: the file is damaged "
                "or of a newer version, which can write it as text"
            )
        name = _MODEL_OF_NUMBER[model]
        yield number, name, width, height, list(cursor.take(f"{parameter_count(name)}d"))
    cursor.finish()


def binary_images(path: Path, data: bytes) -> Iterator[tuple[str, int, tuple[float, ...]]]:
    """Name, camera id and pose (quaternion w x y z, translation) of each image of an images.bin.

    Raises:
        InputError: the file is damaged.
    """
    cursor = _Cursor(path, data)
    for _ in range(cursor.count(73)):
        _, *pose, camera = cursor.take("I7dI")
        name = cursor.text()
        observations = cursor.count(24)
        cursor.position += 24 * observations
        yield name, camera, tuple(pose)
    cursor.finish()


def binary_points(path: Path, data: bytes) -> Iterator[tuple[float, ...]]:
    """Position and colour of each point of a points3D.bin.

    Raises:
        InputError: the file is damaged.
    """
    cursor = _Cursor(path, data)
    for _ in range(cursor.count(51)):
        _, *position_and_color, _ = cursor.take("Q3d3Bd")
        track = cursor.count(8)
        cursor.position += 8 * track
        yield tuple(position_and_color)
    cursor.finish()
