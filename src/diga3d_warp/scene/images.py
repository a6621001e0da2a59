"""Photographs: which of several image folders to read, at which size, and whether a file is whole."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from diga3d_warp.errors import InputError

# A marker that ends the entropy-coded part of a JPEG: 0xff, not stuffed, no restart, no fill byte.
_JPEG_MARKER = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]")
_PNG_END = b"IEND\xaeB`\x82"


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
    """An image as uint8 RGB, shape (H, W, 3).

    Args:
        path: The file.
        upright: Turn it as its EXIF orientation says. Views are not turned, as COLMAP and nerfstudio do not:
            their calibration is that of the pixels as stored.

    Raises:
        InputError: the file is no image that OpenCV reads, or it is cut short.
    """
    import cv2

    data = path.read_bytes()
    # OpenCV fills the missing part of a truncated file with grey and reports success.
    truncated = (data[:2] == b"\xff\xd8" and not _jpeg_is_whole(data)) or (
        data[:4] == b"\x89PNG" and _PNG_END not in data
    )
    if truncated:
        raise InputError(f"{path}: the image is cut short; copy it again")
    flags = cv2.IMREAD_COLOR_RGB | (0 if upright else cv2.IMREAD_IGNORE_ORIENTATION)
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags) if data else None
    if pixels is None:
        raise InputError(f"{path}: not readable as an image; copy it again")
    return pixels


def resize_image(pixels: np.ndarray, scale: float) -> np.ndarray:
    """A smaller copy of uint8 RGB pixels, averaged over areas; sizes are rounded, at least one pixel."""
    import cv2

    height, width = pixels.shape[:2]
    size = (max(round(width * scale), 1), max(round(height * scale), 1))
    return pixels if size == (width, height) else cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)


def read_images(files: Sequence[Path], scale: float, progress: bool) -> Iterator[np.ndarray | InputError]:
    """Read and resize images on all cores, in order; what could not be read is yielded as its error."""
    from tqdm import tqdm

    def read(path: Path) -> np.ndarray | InputError:
        try:
            return resize_image(read_image(path), scale)
        except InputError as error:
            return error

    with ThreadPoolExecutor() as pool:
        yield from tqdm(
            pool.map(read, files), "reading images", len(files), disable=not progress, leave=False
        )
