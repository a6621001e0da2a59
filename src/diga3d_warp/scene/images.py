"""Photographs: which of several image folders to read, at which size, and whether a file is whole.

A photograph with an alpha channel is kept over one colour, with its alpha beside it. Both are linear in
colour times alpha: averaging them over areas brings in no fringe of what the file holds where nothing shows,
and the photograph over any other colour follows from the two.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np

from diga3d_warp.errors import InputError
from diga3d_warp.files import to_bytes

# A marker that ends the entropy-coded part of a JPEG: 0xff, not stuffed, no restart, no fill byte.
_JPEG_MARKER = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]")
_PNG_END = b"IEND\xaeB`\x82"
_TIFF = (b"II*\0", b"MM\0*")

BACKGROUND = (1.0, 1.0, 1.0)
"""Colour behind photographs that have transparent pixels, and behind their renderings, RGB: white, as in the
protocol of NeRF-synthetic."""


class Photograph(NamedTuple):
    """A photograph as views keep it.

    Attributes:
        pixels: RGB, over `BACKGROUND` where it is transparent, shape (H, W, 3), uint8.
        alpha: Opacity, shape (H, W), uint8; None where it is opaque everywhere.
    """

    pixels: np.ndarray
    alpha: np.ndarray | None = None


def choose_folder(folders: Mapping[int, Path], scale: float) -> tuple[Path, float]:
    """The image folder to read for a wanted scale, and the scale that is left to do by resizing.

    The scale is relative to the largest images that are there: with only `images_2`, scale 1 reads it as it
    is. The folder chosen is the smallest one whose images are at least as large as wanted.

    Args:
        folders: Image folders by the factor by which they are smaller than the originals.
        scale: Wanted scale in (0, 1].

    Raises:
        InputError: the scale is outside (0, 1].
    """
    if not 0.0 < scale <= 1.0:
        raise InputError(f"image scale {scale:g} is outside (0, 1]: 1 keeps the largest images present")
    largest = min(folders)
    # The tolerance lets 1/3 find images_3.
    chosen = max(factor for factor in folders if factor * scale <= largest * (1 + 1e-6))
    return folders[chosen], min(scale * chosen / largest, 1.0)


def _jpeg_is_whole(data: bytes) -> bool:
    """Whether a JPEG reaches its end marker; what follows it (a film, a second image) does not count."""
    position = 2
    while (marker := _JPEG_MARKER.search(data, position)) is not None:
        code, position = data[marker.start() + 1], marker.end()
        if code == 0xD9:
            return True
        position += int.from_bytes(data[position : position + 2], "big")
    return False


def read_image(path: Path, *, upright: bool = False) -> np.ndarray:
    """An image as uint8 RGB, shape (H, W, 3); an alpha channel is not read.

    Args:
        path: The file.
        upright: Turn it as its EXIF orientation says. Views are not turned, as COLMAP and nerfstudio do not:
            their calibration is that of the pixels as stored.

    Raises:
        InputError: the file is no image that OpenCV reads, or it is cut short.
    """
    import cv2

    flags = cv2.IMREAD_COLOR_RGB | (0 if upright else cv2.IMREAD_IGNORE_ORIENTATION)
    return _decoded(path, _whole(path), flags)


def read_photograph(path: Path, scale: float = 1.0) -> Photograph:
    """An image with its alpha, if it has one, resized.

    Args:
        path: The file, of 8 or 16 bits. Alpha is straight, as PNG and WebP define it.
        scale: In (0, 1].

    Raises:
        InputError: the file is no image that OpenCV reads, it is cut short, or alpha is 0 everywhere.
    """
    import cv2

    data = _whole(path)
    stored = _decoded(path, data, cv2.IMREAD_UNCHANGED)
    if stored.ndim == 3 and stored.shape[2] == 4 and stored[..., 3].min() < _white(stored):
        if not stored[..., 3].any():
            raise InputError(f"{path}: alpha is 0 everywhere; export it with the object opaque")
        return _composed(stored, scale, premultiplied=data[:4] in _TIFF and stored.dtype == np.uint8)
    if stored.ndim == 3 and stored.shape[2] == 3 and stored.dtype == np.uint8:
        pixels = np.ascontiguousarray(stored[..., ::-1])
    else:
        pixels = _decoded(path, data, cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION)
    return Photograph(resize_image(pixels, scale))


def _whole(path: Path) -> bytes:
    data = path.read_bytes()
    # OpenCV fills the missing part of a truncated file with grey and reports success.
    truncated = (data[:2] == b"\xff\xd8" and not _jpeg_is_whole(data)) or (
        data[:4] == b"\x89PNG" and _PNG_END not in data
    )
    if truncated:
        raise InputError(f"{path}: the image is cut short; copy it again")
    return data


def _decoded(path: Path, data: bytes, flags: int) -> np.ndarray:
    import cv2

    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags) if data else None
    if pixels is None:
        raise InputError(f"{path}: not readable as an image; copy it again")
    return pixels


def _white(stored: np.ndarray) -> float:
    """The value of white, and of full opacity."""
    return float(np.iinfo(stored.dtype).max) if np.issubdtype(stored.dtype, np.integer) else 1.0


def _composed(stored: np.ndarray, scale: float, premultiplied: bool) -> Photograph:
    """A decoded image, BGR and alpha, over `BACKGROUND`. OpenCV multiplies the colours of an 8-bit TIFF."""
    values = stored.astype(np.float32) / _white(stored)
    color, alpha = values[..., 2::-1], values[..., 3]
    if not premultiplied:
        color = color * alpha[..., None]
    composed = color + (1.0 - alpha)[..., None] * np.array(BACKGROUND, np.float32)
    return Photograph(to_bytes(resize_image(composed, scale)), to_bytes(resize_image(alpha, scale)))


def resize_image(pixels: np.ndarray, scale: float) -> np.ndarray:
    """A smaller copy of an image, averaged over areas; sizes are rounded, at least one pixel."""
    import cv2

    height, width = pixels.shape[:2]
    size = (max(round(width * scale), 1), max(round(height * scale), 1))
    return pixels if size == (width, height) else cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)


def read_photographs(
    files: Sequence[Path], scale: float, progress: bool
) -> Iterator[Photograph | InputError]:
    """Read and resize images on all cores, in order; what could not be read is yielded as its error."""
    from tqdm import tqdm

    def read(path: Path) -> Photograph | InputError:
        try:
            return read_photograph(path, scale)
        except InputError as error:
            return error

    with ThreadPoolExecutor() as pool:
        yield from tqdm(
            pool.map(read, files), "reading images", len(files), disable=not progress, leave=False
        )
