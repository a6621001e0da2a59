"""Sparse points to start from, no more than a fit can hold: thinned evenly in space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from diga3d_warp.scene.morton import BITS, morton_keys
from diga3d_warp.scene.scene import Points


@dataclass(frozen=True)
class ThinningSettings:
    """The box that is divided into cells.

    Attributes:
        core: Quantiles of the coordinates between which the core of the points lies. Reconstructions have
            some points thousands of scene sizes away, and a box around these would be one cell to the rest.
        margin: How far the box reaches beyond the core on each side [core sizes]. Points outside count as on
            its border.
    """

    core: tuple[float, float] = (0.01, 0.99)
    margin: float = 2.0


THINNING = ThinningSettings()


def thinned(points: Points, most: int, settings: ThinningSettings = THINNING) -> Points:
    """At most that many of the points, the same at each call.

    Of the coarsest octree level with at least `most` cells that hold points, each cell keeps the point
    nearest to the mean of its points; of these, every n-th along the Morton curve is kept. Dense regions lose
    more than sparse ones.

    Args:
        points: With finite positions.
        most: Largest number of points, at least 1.
        settings: Which box is divided.
    """
    if len(points) <= most:
        return points
    keys = _keys(points.positions, settings)
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    positions = points.positions[order]
    for level in range(BITS + 1):
        cells = keys >> np.uint64(3 * (BITS - level))
        first = np.flatnonzero(np.r_[True, cells[1:] != cells[:-1]])
        if len(first) >= most:
            kept = _nearest_to_mean(positions, first)
            break
    else:  # so many points coincide that even the finest cells are too few
        kept = np.arange(len(points))
    rows = order[kept[np.linspace(0, len(kept) - 1, most).round().astype(int)]]
    rows.sort()
    return Points(points.positions[rows], points.colors[rows])


def _keys(positions: np.ndarray, settings: ThinningSettings) -> np.ndarray:
    low, high = np.quantile(positions, settings.core, axis=0)
    reach = settings.margin * (high - low).max()
    return morton_keys(positions, low - reach, np.maximum(high, low) + reach)


def _nearest_to_mean(positions: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Row of each group's point nearest to the group's mean, shape (G,); groups begin at the rows `first`."""
    sizes = np.diff(np.r_[first, len(positions)])
    group = np.repeat(np.arange(len(first)), sizes)
    means = np.add.reduceat(positions, first, axis=0) / sizes[:, None]
    distances = ((positions - means[group]) ** 2).sum(axis=1)
    order = np.lexsort((distances, group))
    return order[first]
