"""Reading of photographs: choice of the image folder, decoding, alpha, and resizing.

A photograph with an alpha channel is composited over one colour and stored with its alpha. Both are linear in
premultiplied colour, so that averaging over areas brings in no fringe of the colours of transparent pixels,
and the photograph over any other colour follows from the two.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from threading import Condition
from typing import NamedTuple, TypeVar

import numpy as np

from diga3d_warp.errors import InputError
from diga3d_warp.files import to_bytes
from diga3d_warp.scene.photographs.decoding import LIMITS, decode, read_bytes, read_header, turned

T = TypeVar("T")

_TIFF = (b"II*\0", b"MM\0*")
_FINE = 65535  # composed colours are kept in 16 bits until they are averaged
_ROW_PIXELS = 1 << 20  # composed at a time
FLOAT_SLACK = 0.05
"""How far floats of an image may lie outside of [0, 1]: what sharpening and resampling overshoot; clipped."""

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


def read_image(path: Path, *, upright: bool = False) -> np.ndarray:
    """An image as uint8 RGB, shape (H, W, 3); an alpha channel is not read.

    Args:
        path: The file.
        upright: Turn it as its EXIF orientation says.

    Raises:
        InputError: the file is no image that is read, or it is cut short.
    """
    data = read_bytes(path)
    pixels = _rgb(decode(data, path), path)
    return turned(pixels, read_header(data, path).orientation) if upright else pixels


def read_photograph(path: Path, scale: float = 1.0, orientation: int = 1) -> Photograph:
    """An image with its alpha, if it has one, resized.

    Args:
        path: The file, of 8 or 16 bits, or of floats in [0, 1]. Alpha is straight, as PNG and WebP define it.
        scale: In (0, 1].
        orientation: Turn it by this EXIF orientation; 1 leaves it as stored.

    Raises:
        InputError: the file is no image that is read, it is cut short, or alpha is 0 everywhere.
    """
    data = read_bytes(path)
    width = read_header(data, path).width
    stored = decode(data, path, scale)
    scale = min(scale * width / stored.shape[1], 1.0)
    if stored.ndim == 3 and stored.shape[2] == 4 and stored[..., 3].min() < _white(stored, path):
        if not stored[..., 3].any():
            raise InputError(f"{path}: alpha is 0 everywhere; export it with the object opaque")
        over, alpha = _composed(stored, path, premultiplied=data[:4] in _TIFF and stored.dtype == np.uint8)
        small = [to_bytes(resize_image(plane, scale) / np.float32(_FINE)) for plane in (over, alpha)]
        return Photograph(turned(small[0], orientation), turned(small[1], orientation))
    return Photograph(turned(_rgb(resize_image(stored, scale), path), orientation))


def _white(stored: np.ndarray, name: Path) -> float:
    """The value of white, and of full opacity.

    Raises:
        InputError: the numbers are of a type, or in a range, that no photograph has.
    """
    if stored.dtype in (np.uint8, np.uint16):
        return float(np.iinfo(stored.dtype).max)
    if stored.dtype not in (np.float32, np.float64):
        raise InputError(f"{name}: the image holds {stored.dtype} numbers; write it with 8 or 16 bits")
    low, high = float(stored.min()), float(stored.max())
    if not (low >= -FLOAT_SLACK and high <= 1.0 + FLOAT_SLACK):
        raise InputError(
            f"{name}: the image holds floats from {low:g} to {high:g}; map them to [0, 1], or write 8 bits"
        )
    return 1.0


def _rgb(stored: np.ndarray, name: Path) -> np.ndarray:
    """A decoded image as uint8 RGB, shape (H, W, 3), without its alpha."""
    color = stored[..., None].repeat(3, axis=2) if stored.ndim == 2 else stored[..., 2::-1]
    if stored.dtype == np.uint8:
        return np.ascontiguousarray(color)
    scaled = np.multiply(color, 255.0 / _white(stored, name), dtype=np.float32)
    return np.rint(np.clip(scaled, 0.0, 255.0, out=scaled), out=scaled).astype(np.uint8)


def _composed(stored: np.ndarray, name: Path, premultiplied: bool) -> tuple[np.ndarray, np.ndarray]:
    """A decoded image, BGR and alpha, over `BACKGROUND`, and its alpha, in parts of `_FINE`, uint16.

    OpenCV multiplies the colours of an 8-bit TIFF by alpha. Rows are composed a few at a time: in floats, the
    whole of a large image would take several times its memory.
    """
    over = np.empty((*stored.shape[:2], 3), np.uint16)
    alphas = np.empty(stored.shape[:2], np.uint16)
    white = _white(stored, name)
    rows = max(1, _ROW_PIXELS // stored.shape[1])
    for top in range(0, len(stored), rows):
        part = slice(top, top + rows)
        values = np.clip(stored[part].astype(np.float32) / white, 0.0, 1.0)
        color, alpha = values[..., 2::-1], values[..., 3]
        if not premultiplied:
            color = color * alpha[..., None]
        over[part] = np.rint((color + (1.0 - alpha)[..., None] * np.array(BACKGROUND, np.float32)) * _FINE)
        alphas[part] = np.rint(alpha * _FINE)
    return over, alphas


def resize_image(pixels: np.ndarray, scale: float) -> np.ndarray:
    """A smaller copy of an image, averaged over areas; sizes are rounded, at least one pixel."""
    import cv2

    height, width = pixels.shape[:2]
    size = (max(round(width * scale), 1), max(round(height * scale), 1))
    return pixels if size == (width, height) else cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)


class _Room:
    """Lets threads decode as long as their images together stay within a number of pixels; one always may."""

    def __init__(self, pixels: int) -> None:
        self._size = self._free = pixels
        self._changed = Condition()

    @contextmanager
    def of(self, pixels: int) -> Iterator[None]:
        taken = min(pixels, self._size)
        with self._changed:
            self._changed.wait_for(lambda: self._free >= taken)
            self._free -= taken
        try:
            yield
        finally:
            with self._changed:
                self._free += taken
                self._changed.notify_all()


class Wanted(NamedTuple):
    """A photograph to be read.

    Attributes:
        file: The file.
        scale: Size to read it at, in (0, 1].
        orientation: EXIF orientation to turn it by; 1 leaves it as stored.
    """

    file: Path
    scale: float = 1.0
    orientation: int = 1


def check_memory(wanted: Sequence[Wanted]) -> None:
    """Refuse photographs that do not fit into memory together, before any is decoded.

    Raises:
        InputError: they take more than is free.
    """
    import psutil

    size = 0.0
    for one in wanted:
        try:
            header = read_header(one.file)
        except InputError:
            continue  # who decodes the file says so
        size += 3.0 * header.width * header.height * one.scale**2
    free = psutil.virtual_memory().available
    if size > free:
        raise InputError(
            f"{len(wanted)} photographs such as {wanted[0].file} take {size / 1e9:.1f} GB at this size, and "
            f"{free / 1e9:.1f} GB are free: use a smaller --image-scale"
        )


def read_photographs(wanted: Sequence[Wanted], progress: bool) -> Iterator[Photograph | InputError]:
    """Read and resize images on all cores, in order; what could not be read is yielded as its error."""
    reads = [(one.file, partial(read_photograph, *one)) for one in wanted]
    return read_in_parallel(reads, "reading images", progress)


def read_in_parallel(
    reads: Sequence[tuple[Path, Callable[[], T]]], label: str, progress: bool
) -> Iterator[T | InputError]:
    """Results of functions that each decode one image, in order; of one that raises InputError the error.

    They run on all cores, but few large images are decoded at the same time: see `DecodingLimits.at_once`.

    Args:
        reads: Image files, and what reads them.
        label: Label of the progress bar.
        progress: Show it.
    """
    from tqdm import tqdm

    room = _Room(LIMITS.at_once)

    def run(one: tuple[Path, Callable[[], T]]) -> T | InputError:
        file, read = one
        try:
            header = read_header(file)
            with room.of(header.width * header.height):
                return read()
        except InputError as error:
            return error

    with ThreadPoolExecutor() as pool:
        yield from tqdm(pool.map(run, reads), label, len(reads), disable=not progress, leave=False)
