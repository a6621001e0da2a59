"""Rows of arrays turned into columns of lanes, and back."""

import numpy as np
import pytest
import warp as wp

from diga3d_warp.kernels.cells import aligned_function
from diga3d_warp.kernels.gaussian_lanes import moves_of, tables_of
from diga3d_warp.kernels.launch import OPTIONS, launch

SIZE = 16


@pytest.mark.parametrize("count", [1, 7, 16, 17, 45])
@pytest.mark.parametrize("dtype", [float, wp.vec2, wp.vec3, wp.vec4, wp.vec3d])
def test_short_rows(dtype, count):
    """Lane t of what is stored is t more than what was loaded, in every number of its row."""
    load, store = moves_of(dtype, SIZE)
    real = getattr(dtype, "_wp_scalar_type_", dtype)
    length = getattr(dtype, "_length_", 1)

    @wp.kernel(module="unique", module_options=OPTIONS)
    def run(offset: int, count: int, rows: wp.array(dtype=dtype), moved: wp.array(dtype=dtype)):
        first = SIZE * (wp.tid() + offset)
        lanes = wp.min(SIZE, count - first)
        columns = load(rows, first, lanes)
        for c in range(length):
            for t in range(SIZE):
                columns[c, t] = columns[c, t] + real(t)
        store(moved, first, lanes, columns)

    numbers = np.random.default_rng(1).normal(size=(count, length) if length > 1 else count)
    rows = wp.array(numbers, dtype=dtype, device="cpu")
    moved = wp.full(count + 3, dtype(-7.0), dtype=dtype, device="cpu")
    launch(run, -(-count // SIZE), [count, rows], [moved], device="cpu")
    shift = (np.arange(count) % SIZE).reshape(-1, *[1] * (numbers.ndim - 1))
    assert np.array_equal(moved.numpy()[:count], rows.numpy() + shift.astype(rows.numpy().dtype))
    assert (moved.numpy()[count:] == -7.0).all()
    launch(run, -(-count // SIZE), [count, rows], [None], device="cpu")  # nothing is written to no array


@pytest.mark.parametrize("count", [1, 16, 21, 64])
@pytest.mark.parametrize(("numbers", "stride"), [(3, 3), (12, 48), (16, 16), (27, 27), (27, 48), (48, 48)])
@pytest.mark.parametrize("real", [wp.float32, wp.float64])
def test_long_rows(real, numbers, stride, count):
    load, store, get, put = tables_of(numbers, SIZE, real)
    vec = wp.types.vector(length=SIZE, dtype=real)
    aligned = aligned_function(vec)

    @wp.kernel(module="unique", module_options=OPTIONS)
    def run(offset: int, count: int, stride: int, rows: wp.array(dtype=real), moved: wp.array(dtype=real)):
        first = SIZE * (wp.tid() + offset)
        lanes = wp.min(SIZE, count - first)
        table = aligned(wp.zeros(shape=wp.static(numbers + 1), dtype=vec))
        load(rows, stride, first, lanes, table)
        for q in range(numbers):
            for t in range(lanes):
                put(table, q, t, get(table, q, t) + real(1000 * q + t))
        store(moved, stride, first, lanes, table)

    given = np.random.default_rng(2).normal(size=(count, stride))
    rows = wp.array(given.ravel(), dtype=real, device="cpu")
    moved = wp.full(count * stride, real(-7.0), dtype=real, device="cpu")
    launch(run, -(-count // SIZE), [count, stride, rows], [moved], device="cpu")
    found = moved.numpy().reshape(count, stride)
    shift = 1000.0 * np.arange(numbers) + (np.arange(count) % SIZE)[:, None]
    expected = rows.numpy().reshape(count, stride)[:, :numbers] + shift.astype(found.dtype)
    assert np.array_equal(found[:, :numbers], expected)
    assert (found[:, numbers:] == -7.0).all()


def test_cells_of_an_aligned_array_cross_no_cache_line():
    vec = wp.types.vector(length=SIZE, dtype=float)
    aligned = aligned_function(vec)

    @wp.func_native("return (int)((size_t)values.data % sizeof(values.data[0]));")
    def rest(values: wp.array(dtype=vec)) -> int: ...

    @wp.kernel(module="unique", module_options=OPTIONS)
    def run(offset: int, rests: wp.array(dtype=int)):
        i = wp.tid() + offset
        cells = aligned(wp.zeros(shape=4, dtype=vec))
        rests[i] = rest(cells)

    rests = wp.full(3, -1, dtype=int, device="cpu")
    launch(run, 3, [], [rests], device="cpu")
    assert rests.numpy().tolist() == [0, 0, 0]
