"""Tiles of an image: which of them a gaussian's box touches, and the lists of gaussians by tile.

Invariants
- Culling against the image, counting pairs of tiles and gaussians and listing them all use `tile_range`: a
  gaussian is visible exactly if it has pairs, and every slot that was counted is filled.
- A box is clamped before its coordinates become integers: a box far away does not wrap around into a tile.
- Pairs are numbered in 32 bits; more of them are an error, before any is written.
"""

import math
from functools import cache
from typing import Any, NamedTuple

import warp as wp

from diga3d_warp.config import TILE

PIXEL_LIMIT = 1.0e6
"""Pixel coordinates are clamped to this before they become integers; no image is larger, and its tiles are
numbered in 16 bits."""

TILE_SHIFT = int(math.log2(TILE))
"""A pixel's tile is its coordinate shifted right, which rounds down for negative ones too."""


class TileRange(NamedTuple):
    """Warp functions for the tiles that a box touches along one axis of an image.

    A gaussian is visible if and only if neither of its two ranges is empty.

    Attributes:
        first: (center, extent, size) -> first tile. A pixel is touched if its centre is.
        end: (center, extent, first, size) -> one past the last tile; `first` if there are none, as for a
            culled gaussian of extent 0 and for a box beyond the last pixel's outer edge.
    """

    first: Any
    end: Any


@cache
def tile_range(real: Any) -> TileRange:
    """The functions for centres and extents [px] of a scalar type; `size` is the image's, an int [px]."""
    half, zero, limit = real(0.5), real(0.0), real(PIXEL_LIMIT)

    @wp.func
    def tile_count(size: int) -> int:
        return (size + wp.static(TILE - 1)) >> wp.static(TILE_SHIFT)

    @wp.func
    def first(center: real, extent: real, size: int) -> int:
        low = wp.clamp(center - extent - half, -limit, limit)
        return wp.clamp(int(wp.ceil(low)) >> wp.static(TILE_SHIFT), 0, tile_count(size))

    @wp.func
    def end(center: real, extent: real, first: int, size: int) -> int:
        high = wp.clamp(center + extent - half, -limit, limit)
        last = wp.clamp((int(wp.floor(high)) >> wp.static(TILE_SHIFT)) + 1, first, tile_count(size))
        # The last column and row of tiles reach beyond the image.
        touches = wp.where(extent > zero, 1, 0) & wp.where(center - extent <= real(size), 1, 0)
        return wp.where(touches != 0, last, first)

    return TileRange(first, end)


def grid(width: int, height: int) -> tuple[int, int]:
    """Columns and rows of the tiles that cover an image [px]."""
    return -(-width // TILE), -(-height // TILE)


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
