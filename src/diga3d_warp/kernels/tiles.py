"""Tiles of an image: which of them a gaussian's box touches, and the lists of gaussians by tile.

Invariants
- Whoever counts pairs of tiles and gaussians and whoever lists them take the same range, so every slot that
  was counted is filled.
- A box is clamped before its coordinates become integers: what lies far off wraps into no tile.
- Pairs are numbered in 32 bits; of more of them none is written.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import warp as wp

from diga3d_warp.config import TILE
from diga3d_warp.kernels.launch import OPTIONS

wp.set_module_options(OPTIONS)

PIXEL_LIMIT = wp.constant(1.0e6)
"""Pixel coordinates are clamped to this before they become integers; no image is larger, and its tiles are
numbered in 16 bits."""

TILE_SHIFT = wp.constant(int(math.log2(TILE)))
"""A pixel's tile is its coordinate shifted right, which rounds down for negative ones too."""


@wp.func
def first_tile(center: float, extent: float, count: int) -> int:
    """First of the tiles along an axis that a box touches. A pixel is touched if its centre is, hence 0.5."""
    low = wp.clamp(center - extent - 0.5, -PIXEL_LIMIT, PIXEL_LIMIT)
    return wp.clamp(int(wp.ceil(low)) >> TILE_SHIFT, 0, count)


@wp.func
def end_tile(center: float, extent: float, first: int, count: int) -> int:
    """One past the last of these tiles; `first` if there are none, as for a culled gaussian of extent 0."""
    high = wp.clamp(center + extent - 0.5, -PIXEL_LIMIT, PIXEL_LIMIT)
    end = wp.clamp((int(wp.floor(high)) >> TILE_SHIFT) + 1, first, count)
    return wp.where(extent > 0.0, end, first)


class Lists(NamedTuple):
    """Pairs of tiles and gaussians in the order of blending.

    Attributes:
        starts: First pair of each tile, and P at the end, shape (columns * rows + 1,), int32.
        gaussians: Gaussian of each pair, tile after tile, shape (P,), int32.
        first: First emission of each gaussian, and P at the end, shape (N + 1,), int32. Pairs are emitted
            gaussian after gaussian: those of gaussian i are the emissions from `first[i]` to `first[i + 1]`.
        emissions: Emission of each pair, shape (P,), int32.
    """

    starts: wp.array
    gaussians: wp.array
    first: wp.array
    emissions: wp.array


def checked(pairs: int) -> int:
    """The number of pairs, if 32 bits can count them.

    Raises:
        ValueError: more than 2^31 - 1.
    """
    if pairs > 0x7FFFFFFF:
        raise ValueError(
            f"{pairs} pairs of tiles and gaussians are more than 2^31 - 1: "
            "render a smaller image or fewer gaussians"
        )
    return pairs
