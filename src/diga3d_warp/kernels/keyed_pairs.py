"""Lists of gaussians by tile on CUDA: a key of tile and depth for each pair, and one sort of all keys.

It runs on CPU too, where the scatter is faster, so that tests without a GPU can compare the lists.

Invariants
- Keys are sorted stably from the order of emissions, so equal depths keep the order of their indices.
"""

from __future__ import annotations

import warp as wp

from diga3d_warp.kernels.launch import OPTIONS, launch
from diga3d_warp.kernels.tiles import Lists, checked, grid, tile_range

wp.set_module_options(OPTIONS)

first_tile, end_tile = tile_range(wp.float32)


@wp.func
def touched(center: wp.vec2, extent: wp.vec2, width: int, height: int) -> wp.vec4i:
    """First and end column, first and end row of the tiles that a box touches."""
    left = first_tile(center[0], extent[0], width)
    top = first_tile(center[1], extent[1], height)
    right = end_tile(center[0], extent[0], left, width)
    return wp.vec4i(left, right, top, end_tile(center[1], extent[1], top, height))


@wp.kernel
def count_pairs(
    offset: int,
    centers: wp.array(dtype=wp.vec2),
    extents: wp.array(dtype=wp.vec2),
    width: int,
    height: int,
    # outputs
    counts: wp.array(dtype=wp.int64),
):
    i = wp.tid() + offset
    r = touched(centers[i], extents[i], width, height)
    counts[i] = wp.int64(r[1] - r[0]) * wp.int64(r[3] - r[2])


@wp.kernel
def emit_pairs(
    offset: int,
    centers: wp.array(dtype=wp.vec2),
    extents: wp.array(dtype=wp.vec2),
    depth_keys: wp.array(dtype=int),
    sums: wp.array(dtype=wp.int64),
    columns: int,
    width: int,
    height: int,
    # outputs
    first: wp.array(dtype=int),
    keys: wp.array(dtype=wp.int64),
    sources: wp.array(dtype=int),
    emitters: wp.array(dtype=int),
):
    i = wp.tid() + offset
    r = touched(centers[i], extents[i], width, height)
    emission = int(sums[i])
    first[i] = emission
    for y in range(r[2], r[3]):
        for x in range(r[0], r[1]):
            keys[emission] = (wp.int64(y * columns + x) << wp.int64(32)) | wp.int64(depth_keys[i])
            sources[emission] = emission
            emitters[emission] = i
            emission += 1


@wp.func
def tile_of(key: wp.int64) -> int:
    return int(key >> wp.int64(32))


@wp.kernel
def name_pairs(
    offset: int,
    keys: wp.array(dtype=wp.int64),
    sources: wp.array(dtype=int),
    emitters: wp.array(dtype=int),
    # outputs
    starts: wp.array(dtype=int),
    gaussians: wp.array(dtype=int),
    emissions: wp.array(dtype=int),
):
    """Name the gaussian of each sorted pair, and the first pair of each tile. An empty tile begins where the
    next tile does."""
    j = wp.tid() + offset
    emissions[j] = sources[j]
    gaussians[j] = emitters[sources[j]]
    unstarted = int(0)
    if j > 0:
        unstarted = tile_of(keys[j - 1]) + 1
    for tile in range(unstarted, tile_of(keys[j]) + 1):
        starts[tile] = j


def list_by_keys(
    centers: wp.array, extents: wp.array, depth_keys: wp.array, width: int, height: int
) -> Lists:
    """List the gaussians of each tile by depth, on any device.

    Args:
        centers, extents: Boxes [px], shape (N,), vec2.
        depth_keys: Positive, growing with depth, shape (N,), int32.
        width, height: Image size [px].

    Raises:
        ValueError: more than 2^31 - 1 pairs.
    """
    device, count = centers.device, centers.shape[0]
    columns, rows = grid(width, height)
    counts = wp.zeros(count + 1, dtype=wp.int64, device=device)
    launch(count_pairs, count, [centers, extents, width, height], [counts], device=device)
    sums = wp.empty_like(counts)
    wp.utils.array_scan(counts, sums, inclusive=False)
    pairs = checked(int(sums[count:].numpy()[0]))

    first = wp.full(count + 1, pairs, dtype=int, device=device)
    # The sort swaps between two halves.
    keys = wp.empty(2 * pairs, dtype=wp.int64, device=device)
    sources = wp.empty(2 * pairs, dtype=int, device=device)
    emitters, gaussians, emissions = (wp.empty(pairs, dtype=int, device=device) for _ in range(3))
    launch(
        emit_pairs, count, [centers, extents, depth_keys, sums, columns, width, height],
        [first, keys, sources, emitters], device=device,
    )  # fmt: skip
    wp.utils.radix_sort_pairs(keys, sources, pairs)
    starts = wp.full(columns * rows + 1, pairs, dtype=int, device=device)
    launch(name_pairs, pairs, [keys, sources, emitters], [starts, gaussians, emissions], device=device)
    return Lists(starts, gaussians, first, emissions)
