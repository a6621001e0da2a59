"""Binning: which gaussians each tile blends, front to back.

Gaussians are sorted by depth once; (tile, gaussian) pairs are then dealt to their tiles in that order, a
stable counting sort by tile. The sorted gaussians are dealt by a fixed number of dealers, each over a range
of its own with a counter of its own per tile, so dealers run on different threads and the result is the
same for any number of them.

Invariants
- Counting and dealing read the same ranges of tiles, so every slot that was counted is filled.
- Equal depths keep the order of their indices.
- Depths of drawn gaussians are positive floats, whose bits sort like integers.
- Pairs are numbered in 32 bits; more of them raise an error before anything is written.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from diga3d_warp.config import TILE
from diga3d_warp.kernels.launch import OPTIONS, launch

wp.set_module_options(OPTIONS)

DEALERS = 16
"""Ranges of the depth order that are dealt independently: enough for 8 threads at two ranges each, few
enough that a counter per tile and dealer stays small (17k counters at 648 x 420 px)."""

PIXEL_LIMIT = wp.constant(1.0e6)
"""Pixel coordinates are clamped to this before they become integers; no image is larger."""

ROUNDING = 2.0**-22
"""Share of a coordinate by which a box grows that is rounded to float32: four times the rounding's own."""


@dataclass(frozen=True)
class Bins:
    """Pairs of tiles and gaussians, in the order of blending.

    Attributes:
        columns, rows: Size of the tile grid.
        gaussians: Index of the gaussian of each pair, tile after tile, shape (P,), int32.
        starts: First pair of each tile, and P at the end, shape (columns * rows + 1,), int32.
        order: Drawn gaussians by depth, shape (M,), int32.
        first: First emission of each drawn gaussian, and P at the end, shape (M + 1,), int32.
        slots: Pair that each emission went to, shape (P,), int32. Emissions of one gaussian are adjacent, so
            `slots[first[k]:first[k + 1]]` are the pairs of gaussian `order[k]`.
    """

    columns: int
    rows: int
    gaussians: wp.array
    starts: wp.array
    order: wp.array
    first: wp.array
    slots: wp.array

    @property
    def pair_count(self) -> int:
        return self.gaussians.shape[0]


@wp.func
def tile_range(center: wp.vec2, extent: wp.vec2, columns: int, rows: int) -> wp.vec4i:
    """Tiles that the ellipse's box touches: first and end column, first and end row.

    A pixel is touched if its centre is, hence the shift by half a pixel.
    """
    x0 = wp.clamp(center[0] - extent[0] - 0.5, -PIXEL_LIMIT, PIXEL_LIMIT)
    x1 = wp.clamp(center[0] + extent[0] - 0.5, -PIXEL_LIMIT, PIXEL_LIMIT)
    y0 = wp.clamp(center[1] - extent[1] - 0.5, -PIXEL_LIMIT, PIXEL_LIMIT)
    y1 = wp.clamp(center[1] + extent[1] - 0.5, -PIXEL_LIMIT, PIXEL_LIMIT)
    side = float(TILE)
    return wp.vec4i(
        wp.clamp(int(wp.floor(wp.ceil(x0) / side)), 0, columns),
        wp.clamp(int(wp.floor(wp.floor(x1) / side)) + 1, 0, columns),
        wp.clamp(int(wp.floor(wp.ceil(y0) / side)), 0, rows),
        wp.clamp(int(wp.floor(wp.floor(y1) / side)) + 1, 0, rows),
    )


@wp.kernel
def count_tiles(
    offset: int,
    centers: wp.array(dtype=wp.vec2),
    extents: wp.array(dtype=wp.vec2),
    columns: int,
    rows: int,
    # outputs
    ranges: wp.array(dtype=wp.vec4i),
    tiles: wp.array(dtype=int),
):
    i = wp.tid() + offset
    if not (extents[i][0] > 0.0):
        ranges[i] = wp.vec4i(0, 0, 0, 0)
        tiles[i] = 0
        return
    r = tile_range(centers[i], extents[i], columns, rows)
    ranges[i] = r
    tiles[i] = wp.max(r[1] - r[0], 0) * wp.max(r[3] - r[2], 0)


# Each is one move; Warp's indexing would multiply by strides and wrap negative cells, for every pair.
@wp.func_native("return cells.data[cell]++;")
def take(cells: wp.array(dtype=int), cell: int) -> int: ...


@wp.func_native("cells.data[cell] = value;")
def put(cells: wp.array(dtype=int), cell: int, value: int): ...


@wp.kernel
def count_dealt(
    offset: int,
    order: wp.array(dtype=int),
    ranges: wp.array(dtype=wp.vec4i),
    columns: int,
    rows: int,
    # outputs
    counters: wp.array(dtype=int),
):
    dealer = wp.tid() + offset
    drawn = order.shape[0]
    for k in range(dealer * drawn // DEALERS, (dealer + 1) * drawn // DEALERS):
        r = ranges[order[k]]
        for y in range(r[2], r[3]):
            row = (dealer * rows + y) * columns
            for x in range(r[0], r[1]):
                take(counters, row + x)


@wp.kernel
def deal(
    offset: int,
    order: wp.array(dtype=int),
    first: wp.array(dtype=int),
    ranges: wp.array(dtype=wp.vec4i),
    columns: int,
    rows: int,
    # outputs
    cursors: wp.array(dtype=int),
    gaussians: wp.array(dtype=int),
    slots: wp.array(dtype=int),
):
    dealer = wp.tid() + offset
    drawn = order.shape[0]
    for k in range(dealer * drawn // DEALERS, (dealer + 1) * drawn // DEALERS):
        i = order[k]
        emission = int(first[k])
        r = ranges[i]
        for y in range(r[2], r[3]):
            row = (dealer * rows + y) * columns
            for x in range(r[0], r[1]):
                slot = take(cursors, row + x)
                put(gaussians, slot, i)
                put(slots, emission, slot)
                emission += 1


def depth_order(depths: np.ndarray, drawn: np.ndarray) -> np.ndarray:
    """Indices `drawn` sorted by depth, ties by index, shape (M,), int32."""
    if depths.dtype == np.float64:
        return drawn[np.argsort(depths[drawn], kind="stable")].astype(np.int32)
    bits = depths[drawn].view(np.int32)
    count = len(drawn)
    keys = wp.array(np.concatenate([bits, bits]), dtype=wp.int32, device="cpu")
    values = wp.array(np.concatenate([drawn, drawn]).astype(np.int32), dtype=wp.int32, device="cpu")
    wp.utils.radix_sort_pairs(keys, values, count)
    return values.numpy()[:count]


def rounded_outwards(centers: wp.array, extents: wp.array) -> tuple[wp.array, wp.array]:
    """Boxes of float64 as boxes of float32 that hold them; those of (0, 0) stay empty."""
    middle, half = centers.numpy(), extents.numpy()
    half = np.where(half > 0.0, half + ROUNDING * (np.abs(middle) + half), 0.0)
    return tuple(
        wp.array(part.astype(np.float32), dtype=wp.vec2, device=centers.device) for part in (middle, half)
    )


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
    device = centers.device
    if depths.dtype == wp.float64:
        centers, extents = rounded_outwards(centers, extents)
    columns, rows = -(-width // TILE), -(-height // TILE)
    count = centers.shape[0]
    ranges = wp.empty(count, dtype=wp.vec4i, device=device)
    tiles = wp.empty(count, dtype=int, device=device)
    launch(count_tiles, count, [centers, extents, columns, rows], [ranges, tiles], device=device)

    counts = tiles.numpy()
    drawn = np.flatnonzero(counts)
    sequence = depth_order(depths.numpy(), drawn)
    first = np.zeros(len(drawn) + 1, np.int64)
    np.cumsum(counts[sequence], out=first[1:])
    pairs = int(first[-1])
    if pairs > np.iinfo(np.int32).max:
        raise ValueError(
            f"{pairs} pairs of tiles and gaussians are more than 2^31 - 1: "
            "render a smaller image or fewer gaussians"
        )

    order = wp.array(sequence, dtype=int, device=device)
    emissions = wp.array(first.astype(np.int32), dtype=int, device=device)
    counters = wp.zeros(DEALERS * columns * rows, dtype=int, device=device)
    launch(
        count_dealt, DEALERS, [order, ranges, columns, rows], [counters],
        device=device, work=pairs,
    )  # fmt: skip
    # A dealer's first slot in a tile comes after all earlier tiles and, in the tile, after earlier dealers.
    dealt = counters.numpy().reshape(DEALERS, columns * rows)
    ends = np.cumsum(dealt.T, dtype=np.int64).reshape(columns * rows, DEALERS)
    starts = np.concatenate([[0], ends[:, -1]]).astype(np.int32)
    cursors = wp.array((ends - dealt.T).T.astype(np.int32).reshape(-1), dtype=int, device=device)

    gaussians = wp.empty(pairs, dtype=int, device=device)
    slots = wp.empty(pairs, dtype=int, device=device)
    launch(
        deal, DEALERS, [order, emissions, ranges, columns, rows], [cursors, gaussians, slots],
        device=device, work=pairs,
    )  # fmt: skip
    return Bins(columns, rows, gaussians, wp.array(starts, dtype=int, device=device), order, emissions, slots)
