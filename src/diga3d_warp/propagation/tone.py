"""Adapt the tone of pixels that are warped from one view to another.

A glossy floor, or an exposure that drifted, looks different in every view; colours of a reference would stand
out there as a patch. Around the hole both photographs show the same surface: their difference at the rim,
continued harmonically, is added to the fill. That is the membrane of Poisson image editing (Perez et al.
2003), on cells rather than pixels, so that texture does not leak in.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from diga3d_warp.surfaces.membrane import membrane


@dataclass(frozen=True)
class ToneSettings:
    """Scales at which the difference at the rim is measured.

    Attributes:
        cell: Side of the cells on which differences are averaged [px at an image diagonal of 630]. Light
            changes slowly; texture, which the warp shifts by a fraction of a pixel, averages out in 64 px.
        rim: Width of the rim, in the same measure [px]: two cells, so that every part of it fills some.
    """

    cell: float = 8.0
    rim: float = 16.0


TONE = ToneSettings()


def rim_of(hole: np.ndarray) -> np.ndarray:
    """The pixels around a hole, shape (H, W), bool."""
    import cv2

    radius = _pixels(TONE.rim, hole)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    return (cv2.dilate(hole.astype(np.uint8), disc) > 0) & ~hole


def tone_between(own: np.ndarray, shown: np.ndarray, rim: np.ndarray, hole: np.ndarray) -> np.ndarray:
    """Offset to add to colours warped into a hole, so that they continue the view's own.

    Args:
        own: The view's image, shape (H, W, 3), float32; read on the rim.
        shown: The other view's image, warped into this one, shape (H, W, 3), float32; read on the rim.
        rim: Where both are known, shape (H, W), bool.
        hole: Where the addition is wanted, shape (H, W), bool; apart from `rim`.

    Returns:
        shape (H, W, 3), float32; zero outside the hole, and in parts of it that have no rim.
    """
    import cv2
    from scipy.ndimage import label

    added = np.zeros_like(own)
    height, width = hole.shape
    size = _pixels(TONE.cell, hole)
    grid = -(-height // size), -(-width // size)
    cells = np.arange(height)[:, None] // size * grid[1] + np.arange(width)[None] // size
    difference = (own - shown)[rim].astype(np.float64)
    counts = np.bincount(cells[rim], minlength=grid[0] * grid[1])
    sums = np.stack([np.bincount(cells[rim], difference[:, c], grid[0] * grid[1]) for c in range(3)], axis=-1)
    means = (sums / np.maximum(counts, 1)[:, None]).reshape(*grid, 3)
    known = (counts >= max(size * size // 2, 1)).reshape(grid)
    wanted = (np.bincount(cells[hole], minlength=grid[0] * grid[1]) > 0).reshape(grid) & ~known
    regions, _ = label(wanted | known)
    wanted &= np.isin(regions, regions[known])
    if not known.any() or not hole.any():
        return added
    means[~known] = 0.0
    if wanted.any():
        means[wanted] = membrane(means, known, wanted)
    extent = (grid[1] * size, grid[0] * size)
    spread = cv2.resize(means.astype(np.float32), extent)[:height, :width]
    weight = cv2.resize((known | wanted).astype(np.float32), extent)[:height, :width]
    inside = hole & (weight > 0.0)
    added[inside] = spread[inside] / weight[inside][:, None]
    return added


def _pixels(length: float, hole: np.ndarray) -> int:
    return max(1, round(length * float(np.hypot(*hole.shape)) / 630.0))
