"""Copies: whether image files in two folders show the same photographs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from diga3d_warp.errors import InputError
from diga3d_warp.scene.photographs.decoding import read_header
from diga3d_warp.scene.photographs.names import image_key


@dataclass(frozen=True)
class CopyCheck:
    """Thresholds for two folders that hold the same photographs.

    Attributes:
        names: Share of the smaller folder's images that have a namesake in the other.
        samples: Namesakes that are compared.
        side: Side of the grey thumbnails that are compared [px]: fine enough to tell neighbours apart.
        likeness: Least correlation of all thumbnails. Smaller, recompressed copies of photographs reach 0.99;
            neighbouring views of three captures reach 0.95 at most.
        strays: Up to this many images lie beside folders of photographs as a preview or cover.
    """

    names: float = 0.8
    samples: int = 3
    side: int = 32
    likeness: float = 0.96
    strays: int = 2


COPIES = CopyCheck()


def are_copies(files: Sequence[Path], others: Sequence[Path], changed: bool) -> bool:
    """Whether a group holds copies of another: the same names, and `changed` or the same content."""
    ours, theirs = ({image_key(path.name): path for path in group} for group in (files, others))
    common = sorted(ours.keys() & theirs.keys())
    if not common or len(common) < COPIES.names * min(len(ours), len(theirs)):
        return False
    return changed or all(likeness(ours[key], theirs[key]) >= COPIES.likeness for key in spread(common))


def likeness(first: Path, second: Path) -> float:
    """Correlation of two images as grey thumbnails, in [-1, 1]; 0 where one cannot be read or is flat."""
    small = [_thumbnail(path) for path in (first, second)]
    if small[0] is None or small[1] is None:
        return 0.0
    a, b = ((image - image.mean()).ravel() for image in small if image is not None)
    return float(a @ b / max(np.linalg.norm(a) * np.linalg.norm(b), 1e-12))


def _thumbnail(path: Path) -> np.ndarray | None:
    import cv2

    flags = {8: cv2.IMREAD_REDUCED_GRAYSCALE_8, 4: cv2.IMREAD_REDUCED_GRAYSCALE_4,
             2: cv2.IMREAD_REDUCED_GRAYSCALE_2, 1: cv2.IMREAD_GRAYSCALE}  # fmt: skip
    try:
        header = read_header(path)
    except InputError:
        return None
    reduced = min(header.width, header.height) // (2 * COPIES.side)
    flag = flags[max((factor for factor in flags if factor <= reduced), default=1)]
    pixels = cv2.imdecode(np.fromfile(path, np.uint8), flag | cv2.IMREAD_IGNORE_ORIENTATION)
    if pixels is None:
        return None
    return cv2.resize(pixels, (COPIES.side, COPIES.side), interpolation=cv2.INTER_AREA).astype(np.float32)


def spread(items: Sequence) -> list:
    """A few items, evenly spread."""
    count = min(len(items), COPIES.samples)
    return [items[i] for i in np.linspace(0, len(items) - 1, count).round().astype(int)] if count else []
