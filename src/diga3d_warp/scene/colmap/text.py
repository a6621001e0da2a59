"""Records of COLMAP's text files, also after editing in other programs.

Byte order marks, UTF-16, comments and blank lines anywhere, and the line endings of any system are accepted.
Names that are not UTF-8 keep their bytes (`surrogateescape`).
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator
from pathlib import Path

from diga3d_warp.errors import InputError

_BYTE_ORDER_MARKS = {codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
_NUMBERS = re.compile(rb"[-+.0-9eEnNaAiIfF \t]*")
_LONGEST_LINE = 60


def _lines(path: Path, data: bytes) -> Iterator[tuple[int, bytes]]:
    """Lines that are no comments, with their numbers from 1."""
    if (encoding := _BYTE_ORDER_MARKS.get(data[:2])) is not None:
        try:
            data = data.decode(encoding).encode()
        except UnicodeError:
            data = b"\0"
    if b"\0" in data:
        raise InputError(f"{path}: the file is not text; copy it again or rerun COLMAP")
    for number, line in enumerate(data.removeprefix(codecs.BOM_UTF8).splitlines(), start=1):
        stripped = line.strip()
        if not stripped.startswith(b"#"):
            yield number, stripped


def _damaged(path: Path, number: int, line: bytes) -> InputError:
    start = line[:_LONGEST_LINE].decode("ascii", "backslashreplace")
    return InputError(f"{path}: line {number}: cannot read {start!r}; copy the file again or rerun COLMAP")


def text_cameras(path: Path, data: bytes) -> Iterator[tuple[int, str, int, int, list[float]]]:
    """Camera id, model, width, height and parameters of each camera of a cameras.txt.

    Raises:
        InputError: a line is damaged.
    """
    for number, line in _lines(path, data):
        if not line:
            continue
        try:
            camera, model, width, height, *parameters = line.split()
            sizes = [float(width), float(height)]
            if not all(size.is_integer() for size in sizes):
                raise ValueError
            values = [float(value) for value in parameters]
            yield int(camera), model.decode("ascii").upper(), int(sizes[0]), int(sizes[1]), values
        except (ValueError, OverflowError):
            raise _damaged(path, number, line) from None


def text_images(path: Path, data: bytes) -> Iterator[tuple[str, int, tuple[float, ...]]]:
    """Name, camera id and pose (quaternion w x y z, translation) of each image of an images.txt.

    In COLMAP's files a line of observations follows each line of an image; it may be empty. Files in which
    these lines were left out, or blank lines were added, are read as well: a line of observations is
    recognised by its numbers, three for each.

    Raises:
        InputError: a line is neither.
    """
    observed = True  # whether the last image has had its line of observations
    any_image = False
    for number, line in _lines(path, data):
        if not line:
            continue
        image = _image(line)
        numbers = _NUMBERS.fullmatch(line) is not None and len(line.split()) % 3 == 0
        if image is not None and (observed or not numbers):
            yield image
            observed, any_image = False, True
        elif numbers and any_image and not observed:
            observed = True
        else:
            raise _damaged(path, number, line)


def _image(line: bytes) -> tuple[str, int, tuple[float, ...]] | None:
    """The image of a line; None if it is no line of an image."""
    fields = line.split(maxsplit=9)
    try:
        number, *pose, camera, name = fields
        int(number)
        numbers = tuple(float(value) for value in pose)
        return (name.decode("utf-8", "surrogateescape"), int(camera), numbers) if len(numbers) == 7 else None
    except ValueError:
        return None


def text_points(path: Path, data: bytes) -> Iterator[tuple[float, ...]]:
    """Position and colour of each point of a points3D.txt.

    Colours are of type int unless a file holds others.

    Raises:
        InputError: a line is damaged.
    """
    for number, line in _lines(path, data):
        if not line:
            continue
        try:
            _, x, y, z, red, green, blue, *_ = line.split(maxsplit=7)
            yield float(x), float(y), float(z), *(_color(value) for value in (red, green, blue))
        except ValueError:
            raise _damaged(path, number, line) from None


def _color(text: bytes) -> float:
    return int(text) if text.isdigit() and len(text) < 9 else float(text)
