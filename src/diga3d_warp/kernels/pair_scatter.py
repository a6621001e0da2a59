"""Lists of gaussians by tile on CPU: sort by depth once, then scatter pairs to their tiles in that order.

The scatter is a stable counting sort in a fixed number of chunks of gaussians, each with a counter of its own
for every tile: chunks run on different threads, and the result is the same for any number of them. Depths are
sorted by NumPy, whose sort of 64-bit integers runs on vectors: a million takes 8 ms on one core, as long as
three passes of a radix sort on two.

Invariants
- Equal depths keep the order of their indices.
- An element is a gaussian's depth key, in the upper 32 bits, and its index. Keys are positive integers.
- Counting and scattering use the same chunks, so every slot that was counted is filled.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from diga3d_warp.kernels.cells import cells_of, take
from diga3d_warp.kernels.launch import OPTIONS, launch
from diga3d_warp.kernels.tiles import Lists, checked, grid, tile_range

wp.set_module_options(OPTIONS)

CHUNKS = 16
"""Chunks that are scattered independently: enough for 8 threads at two chunks each, few enough that a counter
for each tile and chunk stays small (18k counters at 648 x 420 px)."""

AHEAD = wp.constant(16)
"""Elements by which a chunk prefetches: gaussians are stored in another order than that of their depths."""

read_range, _, fetch_range, _ = cells_of(wp.vec4us)
read_element, write_element, *_ = cells_of(wp.uint64)
read_int, write_int, fetch_int, _ = cells_of(int)
first_tile, end_tile = tile_range(wp.float32)


# Vectors are read and written by their components: a loop that passes whole ones around stays scalar.
@wp.func_native("return values.data[cell].c[axis];")
def component(values: wp.array(dtype=wp.vec2), cell: int, axis: int) -> float: ...


WRITE_RANGE = """
auto& range = values.data[cell];
range.c[0] = left;
range.c[1] = across;
range.c[2] = top;
range.c[3] = down;
"""


@wp.func_native(WRITE_RANGE)
def write_range(
    values: wp.array(dtype=wp.vec4us), cell: int, left: int, across: int, top: int, down: int
): ...


@wp.func
def begin(chunk: int, count: int) -> int:
    """First element of a chunk."""
    return chunk * (count // CHUNKS) + wp.min(chunk, count % CHUNKS)


@wp.func
def index_of(element: wp.uint64) -> int:
    return int(element & wp.uint64(0xFFFFFFFF))


@wp.kernel
def measure(
    offset: int,
    centers: wp.array(dtype=wp.vec2),
    extents: wp.array(dtype=wp.vec2),
    width: int,
    height: int,
    # outputs
    ranges: wp.array(dtype=wp.vec4us),
    emitted: wp.array(dtype=wp.int64),
    visible: wp.array(dtype=int),
):
    """Ranges of tiles, and sums over a chunk. No branch, so that the loop runs on vectors."""
    chunk = wp.tid() + offset
    count = centers.shape[0]
    total = wp.int64(0)
    touching = int(0)
    i = begin(chunk, count)
    end = begin(chunk + 1, count)
    while i < end:
        x = component(centers, i, 0)
        y = component(centers, i, 1)
        ex = component(extents, i, 0)
        ey = component(extents, i, 1)
        left = first_tile(x, ex, width)
        top = first_tile(y, ey, height)
        across = end_tile(x, ex, left, width) - left
        down = end_tile(y, ey, top, height) - top
        write_range(ranges, i, left, across, top, down)
        tiles = wp.int64(across) * wp.int64(down)
        total += tiles
        touching += wp.where(tiles > wp.int64(0), 1, 0)
        i += 1
    emitted[chunk] = total
    visible[chunk] = touching


@wp.kernel
def collect(
    offset: int,
    keys: wp.array(dtype=int),
    ranges: wp.array(dtype=wp.vec4us),
    emission_bases: wp.array(dtype=int),
    element_bases: wp.array(dtype=int),
    # outputs
    first: wp.array(dtype=int),
    elements: wp.array(dtype=wp.uint64),
):
    """Number emissions through all chunks, and line up visible gaussians as elements to sort."""
    chunk = wp.tid() + offset
    count = keys.shape[0]
    slot = int(element_bases[chunk])
    emission = int(emission_bases[chunk])
    for i in range(begin(chunk, count), begin(chunk + 1, count)):
        write_int(first, i, emission)
        r = read_range(ranges, i)
        tiles = int(r[1]) * int(r[3])
        emission += tiles
        if tiles > 0:
            key = wp.uint64(read_int(keys, i))
            write_element(elements, slot, (key << wp.uint64(32)) | wp.uint64(i))
            slot += 1


@wp.func
def next_cell(cell: int, column: int, across: int, columns: int) -> int:
    """The tile after `cell` in a range of tiles, of which `column` is the column."""
    return cell + wp.where(column + 1 == across, columns - across + 1, 1)


@wp.kernel
def count_tiles(
    offset: int,
    elements: wp.array(dtype=wp.uint64),
    ranges: wp.array(dtype=wp.vec4us),
    columns: int,
    rows: int,
    # outputs
    counters: wp.array(dtype=int),
):
    chunk = wp.tid() + offset
    count = elements.shape[0]
    end = begin(chunk + 1, count)
    for k in range(begin(chunk, count), end):
        fetch_range(ranges, index_of(read_element(elements, wp.min(k + AHEAD, end - 1))))
        r = read_range(ranges, index_of(read_element(elements, k)))
        across = int(r[1])
        cell = (chunk * rows + int(r[2])) * columns + int(r[0])
        column = int(0)
        # One loop over both directions: its end is guessed wrongly once a gaussian, not once a row.
        for _ in range(across * int(r[3])):
            take(counters, cell)
            cell = next_cell(cell, column, across, columns)
            column = wp.where(column + 1 == across, 0, column + 1)


@wp.kernel
def scatter_pairs(
    offset: int,
    elements: wp.array(dtype=wp.uint64),
    ranges: wp.array(dtype=wp.vec4us),
    first: wp.array(dtype=int),
    columns: int,
    rows: int,
    # outputs
    cursors: wp.array(dtype=int),
    gaussians: wp.array(dtype=int),
    emissions: wp.array(dtype=int),
):
    chunk = wp.tid() + offset
    count = elements.shape[0]
    end = begin(chunk + 1, count)
    for k in range(begin(chunk, count), end):
        ahead = index_of(read_element(elements, wp.min(k + AHEAD, end - 1)))
        fetch_range(ranges, ahead)
        fetch_int(first, ahead)
        i = index_of(read_element(elements, k))
        r = read_range(ranges, i)
        across = int(r[1])
        cell = (chunk * rows + int(r[2])) * columns + int(r[0])
        column = int(0)
        emission = int(read_int(first, i))
        for _ in range(across * int(r[3])):
            slot = take(cursors, cell)
            write_int(gaussians, slot, i)
            write_int(emissions, slot, emission)
            emission += 1
            cell = next_cell(cell, column, across, columns)
            column = wp.where(column + 1 == across, 0, column + 1)


def list_by_scatter(centers: wp.array, extents: wp.array, keys: wp.array, width: int, height: int) -> Lists:
    """List the gaussians of each tile by key, on CPU.

    Args:
        centers, extents: Boxes [px], shape (N,), vec2.
        keys: Positive, growing with depth, shape (N,), int32.
        width, height: Image size [px].

    Raises:
        ValueError: more than 2^31 - 1 pairs.
    """
    count, (columns, rows) = centers.shape[0], grid(width, height)
    ranges, first = _empty(count, wp.vec4us), _empty(count + 1, int)
    emitted, visible = _empty(CHUNKS, wp.int64), _empty(CHUNKS, int)
    _launch(measure, count, [centers, extents, width, height], [ranges, emitted, visible])
    emission_bases, element_bases = _sums(emitted), _sums(visible)
    pairs = checked(int(emission_bases[-1]))
    first[count:].fill_(pairs)
    elements = _empty(int(element_bases[-1]), wp.uint64)
    _launch(
        collect, count, [keys, ranges, _ints(emission_bases), _ints(element_bases)], [first, elements]
    )  # fmt: skip
    elements.numpy().sort()

    counters = wp.zeros(CHUNKS * columns * rows, dtype=int, device="cpu")
    _launch(count_tiles, pairs, [elements, ranges, columns, rows], [counters])
    starts, cursors = _slots(counters)
    gaussians, emissions = _empty(pairs, int), _empty(pairs, int)
    _launch(
        scatter_pairs, pairs, [elements, ranges, first, columns, rows], [cursors, gaussians, emissions]
    )  # fmt: skip
    return Lists(starts, gaussians, first, emissions)


def _slots(counters: wp.array) -> tuple[wp.array, wp.array]:
    """First slot of each cell and the end, (C + 1,), and of each chunk in each cell, (CHUNKS * C,).

    A chunk's first slot in a cell comes after all earlier cells and, in the cell, after earlier chunks.
    """
    counted = counters.numpy().reshape(CHUNKS, -1)
    starts = np.zeros(counted.shape[1] + 1, np.int32)
    np.cumsum(counted.sum(0, dtype=np.int32), out=starts[1:])
    earlier = np.cumsum(counted, axis=0, dtype=np.int32) - counted
    return _ints(starts), _ints(starts[:-1] + earlier)


def _sums(values: wp.array) -> np.ndarray:
    return np.concatenate([[0], np.cumsum(values.numpy(), dtype=np.int64)])


def _ints(values: np.ndarray) -> wp.array:
    return wp.array(values.astype(np.int32).reshape(-1), dtype=int, device="cpu")


def _empty(count: int, dtype: Any) -> wp.array:
    return wp.empty(count, dtype=dtype, device="cpu")


def _launch(kernel: wp.Kernel, work: int, inputs: list, outputs: list) -> None:
    """Run a kernel over all chunks; `work` is the number of elements in all of them."""
    launch(kernel, CHUNKS, inputs, outputs, device="cpu", work=work // CHUNKS + 1, uneven=True)
