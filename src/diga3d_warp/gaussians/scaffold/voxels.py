"""The grid of voxels that anchors lie on."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

CELLS_MOST = 2.0**40
"""Voxels along one axis at most: their numbers, and those of neighbours, are exact in float64 and int64."""

ENLARGED = 1.25
"""Factor by which voxels grow until few enough hold a point: with 2, a third of the budget would be left."""


def voxels_of(positions: np.ndarray, size: float) -> np.ndarray:
    """The voxel of each position, three numbers each, shape (P, 3), int64.

    Args:
        positions: Finite, shape (P, 3).
        size: Side of a voxel, above 0. Positions more than `CELLS_MOST` voxels away count as on that border.
    """
    cells = np.floor(np.asarray(positions, np.float64) / size)
    return np.clip(cells, -CELLS_MOST, CELLS_MOST).astype(np.int64)


def grouped(cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distinct voxels (V, 3) in lexicographic order, and the number of each position's voxel, shape (P,)."""
    order = np.lexsort(cells.T[::-1])
    ordered = cells[order]
    fresh = np.r_[True, (ordered[1:] != ordered[:-1]).any(axis=1)][: len(cells)]
    number = np.empty(len(cells), np.int64)
    number[order] = np.cumsum(fresh) - 1
    return ordered[fresh], number


def usual_distance(positions: np.ndarray) -> float:
    """Median distance of positions to their nearest neighbour that is apart; 1 if all coincide.

    Scaffold-GS takes it as the size of a voxel where none is given.
    """
    distinct = np.unique(positions, axis=0)
    if len(distinct) < 2:
        return 1.0
    distances = cKDTree(distinct).query(distinct, k=2)[0][:, 1]
    return float(np.median(distances[distances > 0.0])) if (distances > 0.0).any() else 1.0


def voxel_size(positions: np.ndarray, most: int) -> float:
    """Side of voxels of which at most `most` hold a position: their usual distance, enlarged until so.

    Args:
        positions: Finite, at least one, shape (P, 3).
        most: Largest number of voxels, at least 1. Eight voxels meet in the origin: fewer may not be reached,
            and the size is then that of one voxel to each side.
    """
    size = usual_distance(positions)
    reach = float(np.abs(positions).max(initial=0.0))
    while size <= reach and len(grouped(voxels_of(positions, size))[0]) > most:
        size *= ENLARGED
    return size
