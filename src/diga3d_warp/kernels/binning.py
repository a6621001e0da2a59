"""Binning: which gaussians each tile blends, front to back.

On CPU gaussians are sorted by depth and their pairs are scattered to the tiles (`pair_scatter`); on CUDA
every pair gets a key of tile and depth, and the keys are sorted (`keyed_pairs`). Both give the same lists.

Invariants
- Equal depths keep the order of their indices.
- Depths of drawn gaussians are positive floats, whose bits sort like integers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from diga3d_warp.config import TILE
from diga3d_warp.kernels.keyed_pairs import list_by_keys
from diga3d_warp.kernels.pair_scatter import list_by_scatter
from diga3d_warp.kernels.tiles import grid

ROUNDING = 2.0**-22
"""Share of a coordinate by which a box grows that is rounded to float32: four times the rounding's own."""


@dataclass(frozen=True)
class Bins:
    """Pairs of tiles and gaussians, in the order of blending.

    Attributes:
        columns, rows: Size of the tile grid.
        starts, gaussians, first, emissions: As in `tiles.Lists`.
    """

    columns: int
    rows: int
    starts: wp.array
    gaussians: wp.array
    first: wp.array
    emissions: wp.array

    @property
    def pair_count(self) -> int:
        return self.gaussians.shape[0]

    def regions(self, region: int) -> int:
        """Number of squares of `region` px in all tiles, the indices of a compositing launch."""
        return self.columns * self.rows * (TILE // region) ** 2


def rounded_outwards(centers: wp.array, extents: wp.array) -> tuple[wp.array, wp.array]:
    """Boxes of float64 as boxes of float32 that hold them; those of (0, 0) stay empty."""
    middle, half = centers.numpy(), extents.numpy()
    half = np.where(half > 0.0, half + ROUNDING * (np.abs(middle) + half), 0.0)
    return tuple(
        wp.array(part.astype(np.float32), dtype=wp.vec2, device=centers.device) for part in (middle, half)
    )


def depth_keys(depths: wp.array) -> wp.array:
    """Positive integers that grow with depth, shape (N,), int32: bits of a float32, ranks of float64."""
    if depths.dtype == wp.float32:
        return depths.view(wp.int32)
    ranks = np.empty(depths.shape[0], np.int32)
    ranks[np.argsort(depths.numpy(), kind="stable")] = np.arange(depths.shape[0])
    return wp.array(ranks, dtype=int, device=depths.device)


def bin_gaussians(centers: wp.array, depths: wp.array, extents: wp.array, width: int, height: int) -> Bins:
    """List the gaussians of each tile, front to back.

    Args:
        centers: Pixel positions, shape (N,), vec2 of float32, or of float64 like all others.
        depths: Depths along the camera axis, positive where drawn, shape (N,).
        extents: Half width and height of the box to draw [px], shape (N,), vec2; (0, 0) means culled.
        width, height: Image size [px].

    Raises:
        ValueError: more than 2^31 - 1 pairs.
    """
    if depths.dtype == wp.float64:
        centers, extents = rounded_outwards(centers, extents)
    listed = list_by_scatter if depths.device.is_cpu else list_by_keys
    return Bins(*grid(width, height), *listed(centers, extents, depth_keys(depths), width, height))
