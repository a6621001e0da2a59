"""Labels: what one mask file holds, before it is known which of its labels are the object.

A label is a level of grey or alpha, a place in a palette (DAVIS, PASCAL VOC), or a colour. A mask of another
size is stretched to its image without interpolation, as SPIn-NeRF's loader does with its masks of 576 rows
for images of 567.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from diga3d_warp.errors import InputError
from diga3d_warp.scene.photographs.decoding import decode, read_bytes, turned

ASPECT = 0.02
"""Largest deviation of a mask's aspect ratio from its image's, as a fraction; 1.6 % in SPIn-NeRF."""

LABELS_MOST = 256
"""Most labels of a file whose colours are labels; a file with more holds shades."""

CHROMA = 16
"""Largest difference between the channels of a grey image that went through JPEG [levels of 255]."""


@dataclass(frozen=True, eq=False)
class Labels:
    """One mask.

    Attributes:
        file: Where it comes from.
        values: Its labels in rising order, shape (L,), int64; colours as 0xRRGGBB.
        index: Place of each pixel's label in `values`, shape (H, W).
        colored: Whether labels are colours.
        exact: Whether labels are as they were written: whole numbers, not changed by lossy compression.
        white: Level of white, 255 or 65535.
        tinted: Whether levels are the brightest channel of an image with many colours.
    """

    file: Path
    values: np.ndarray
    index: np.ndarray
    colored: bool
    exact: bool
    white: int
    tinted: bool = False

    def counts(self) -> dict[int, int]:
        """Pixels of each label."""
        count = np.bincount(self.index.ravel(), minlength=len(self.values)).tolist()
        return {value: n for value, n in zip(self.values.tolist(), count, strict=True) if n}

    def grey(self) -> np.ndarray:
        """Levels of 255, the brightest channel of colours, shape (H, W), uint8."""
        if self.colored:
            levels = np.max([self.values >> 16, self.values >> 8 & 255, self.values & 255], axis=0)
        else:
            levels = self.values * 255 // self.white
        return levels.astype(np.uint8)[self.index]

    def rgb(self) -> np.ndarray:
        """Labels as colours 0xRRGGBB, shape (L,)."""
        return self.values if self.colored else (self.values * 255 // self.white) * 0x010101


def read_labels(file: Path, width: int, height: int, turn: int = 1) -> Labels:
    """The labels of a mask file, at the size of its image.

    Alpha is read where it varies, else the palette, else the colour.

    Args:
        file: The mask.
        width, height: Size of the image [px].
        turn: EXIF orientation that a mask is turned by if only then it has the image's aspect ratio.

    Raises:
        InputError: the file is no image, its aspect ratio is not that of the image, or it holds numbers that
            are no labels.
    """
    data = read_bytes(file)
    stored = decode(data, file)
    rows, columns = stored.shape[:2]
    if not _fits(rows, columns, height, width):
        if not (turn >= 5 and _fits(columns, rows, height, width)):
            raise InputError(
                f"{file}: the mask is {columns} x {rows} px for an image of {width} x {height} px; write it "
                "with the aspect ratio of the image"
            )
        stored = turned(stored, turn)
    stored = stretched(_whole_numbers(stored, file), width, height)
    exact = data[:2] != b"\xff\xd8" and data[12:16] != b"VP8 " and data[4:8] != b"ftyp"
    palette = _palette(data)
    if palette is not None and stored.ndim == 3:
        return _labels(file, _places(_packed(stored), palette), exact)
    if stored.ndim == 2:
        return _labels(file, stored, exact)
    if stored.shape[2] == 4 and np.ptp(stored[..., 3]) > 0:
        return _labels(file, stored[..., 3], exact)
    brightest = stored[..., :3].max(axis=2)
    if int((brightest - stored[..., :3].min(axis=2)).max()) <= (0 if exact else CHROMA):
        return _labels(file, brightest, exact)
    if exact and stored.dtype == np.uint8:
        colors = replace(_labels(file, _packed(stored), exact), colored=True)
        if len(colors.values) <= LABELS_MOST:
            return colors
    return replace(_labels(file, brightest, exact=False), tinted=True)


def _fits(rows: int, columns: int, height: int, width: int) -> bool:
    return abs(rows * width / (columns * height) - 1) <= ASPECT


def stretched(mask: np.ndarray, width: int, height: int) -> np.ndarray:
    """A mask or labels (H, W, ...) of 8 or 16 bits, or bool, at another size: the nearest pixel of each."""
    import cv2

    if mask.shape[:2] == (height, width):
        return mask
    stored = mask.astype(np.uint8) if mask.dtype == bool else mask
    nearest = cv2.resize(stored, (width, height), interpolation=cv2.INTER_NEAREST_EXACT)
    return nearest.astype(mask.dtype, copy=False)


def _labels(file: Path, plane: np.ndarray, exact: bool) -> Labels:
    values, index = np.unique(plane, return_inverse=True)
    small = index.reshape(plane.shape).astype(np.min_scalar_type(max(len(values) - 1, 0)))
    white = 65535 if plane.dtype == np.uint16 else 255
    return Labels(file, values.astype(np.int64), small, False, exact, white)


def _whole_numbers(stored: np.ndarray, file: Path) -> np.ndarray:
    """A decoded mask as uint8 or uint16: numbers of 32 bits, and floats that are shares or numbers, too."""
    if stored.dtype in (np.uint8, np.uint16):
        return stored
    low, high = float(stored.min()), float(stored.max())
    if np.issubdtype(stored.dtype, np.floating) and low >= 0.0 and high <= 1.0:
        return np.rint(stored * 255.0).astype(np.uint8)
    if not (low >= 0.0 and high <= 65535.0 and (stored == np.rint(stored)).all()):
        raise InputError(f"{file}: the mask holds numbers from {low:g} to {high:g}; write it again as .png")
    return stored.astype(np.uint8 if high <= 255.0 else np.uint16)


def _packed(stored: np.ndarray) -> np.ndarray:
    """Colours 0xRRGGBB of an image BGR or BGRA, shape (H, W), uint32."""
    blue, green, red = (stored[..., channel].astype(np.uint32) for channel in range(3))
    return red << 16 | green << 8 | blue


def _palette(data: bytes) -> np.ndarray | None:
    """Colours 0xRRGGBB of the palette of a PNG, shape (P,), uint32; None for other images."""
    if data[:4] != b"\x89PNG" or data[25] != 3:
        return None
    place = data.find(b"PLTE")
    size = int.from_bytes(data[place - 4 : place], "big")
    colors = np.frombuffer(data[place + 4 : place + 4 + size - size % 3], np.uint8).reshape(-1, 3)
    return _packed(colors[:, ::-1])


def _places(packed: np.ndarray, palette: np.ndarray) -> np.ndarray:
    """Place of each colour in a palette, the first of equal ones, shape (H, W), uint8."""
    colors, places = np.unique(palette, return_index=True)
    found = np.minimum(np.searchsorted(colors, packed), len(colors) - 1)
    return places[found].astype(np.uint8)
