"""Gaussians in SIMD lanes: rows of an array, moved to and from the lanes of vectors.

Arrays hold one row for each gaussian. A thread takes many gaussians, as many at a time as a vector has lanes.
It loads their rows as the columns of a matrix, so that a row of the matrix is a vector with one gaussian in
each lane, computes in one loop over lanes, and stores the results as rows again.

Invariants
- Lanes beyond the last gaussian are zero in a matrix that was loaded, and what they were in a table; neither
  is stored.
- A lane loop has no branch and calls no library, so that the compiler turns it into vector instructions.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import warp as wp

from diga3d_warp.config import POSE_GROUP
from diga3d_warp.kernels.cells import cells_of


@dataclass(frozen=True)
class GaussianLanes:
    """How gaussians are shared among threads.

    Attributes:
        span: Gaussians of a thread; all of them share one row of the camera's gradient.
        size: Gaussians at a time, one in each lane.
    """

    span: int
    size: int


CPU_LANES = GaussianLanes(POSE_GROUP, 16)
"""16 lanes fill one AVX-512 register."""

ONE_BY_ONE = GaussianLanes(POSE_GROUP, 1)
"""For functions that call a library, as all do in float64: a loop with calls gains nothing from
lanes, and Warp 1.19's compiler made wrong code of one (float64, sigma points with slopes of depth)."""

CUDA_LANES = GaussianLanes(1, 1)


def lanes_for(device: Any, *, calls: bool) -> GaussianLanes:
    """How to share gaussians among the threads of a device, for a kernel that calls a library or does not."""
    if not wp.get_device(device).is_cpu:
        return CUDA_LANES
    return ONE_BY_ONE if calls else CPU_LANES


class Moves(NamedTuple):
    """Warp functions between rows of an array and a matrix of shape (numbers in a row, lanes).

    Attributes:
        load: (array, first, count) -> matrix: `count` rows from `first` on, one a lane.
        store: (array, first, count, matrix): write them; nothing where there is no array.
    """

    load: Any
    store: Any


@cache
def moves_of(dtype: Any, size: int) -> Moves:
    """The functions for rows that are scalars or vectors, `size` at a time."""
    real = getattr(dtype, "_wp_scalar_type_", dtype)
    length = getattr(dtype, "_length_", 1)
    matrix = wp.types.matrix(shape=(length, size), dtype=real)
    cell = "values.data[row]" if real is dtype else "values.data[row][number]"

    # Number by number: a row of two would be one register, which keeps a loop from being vectorised.
    @wp.func_native(f"return {cell};")
    def read(values: wp.array(dtype=dtype), row: int, number: int) -> real: ...

    @wp.func_native(f"{cell} = value;")
    def write(values: wp.array(dtype=dtype), row: int, number: int, value: real): ...

    @wp.func
    def load(values: wp.array(dtype=dtype), first: int, count: int) -> matrix:
        lanes = matrix()
        if count == size:
            for c in range(length):
                for t in range(size):
                    lanes[c, t] = read(values, first + t, c)
        else:
            for c in range(length):
                for t in range(count):
                    lanes[c, t] = read(values, first + t, c)
        return lanes

    @wp.func
    def store(values: wp.array(dtype=dtype), first: int, count: int, lanes: matrix):
        if values:
            if count == size:
                for c in range(length):
                    for t in range(size):
                        write(values, first + t, c, lanes[c, t])
            else:
                for c in range(length):
                    for t in range(count):
                        write(values, first + t, c, lanes[c, t])

    return Moves(load, store)


class Tables(NamedTuple):
    """Warp functions between long rows in one array of numbers and a table: an array of one vector a number.

    Attributes:
        load: (array, stride, first, count, table): rows from `first` on, `stride` numbers apart.
        store: The same, back; nothing where there is no array.
        get: (table, number, lane) -> value.
        put: (table, number, lane, value).
    """

    load: Any
    store: Any
    get: Any
    put: Any


@cache
def tables_of(numbers: int, size: int, real: Any) -> Tables:
    """The functions for rows of `numbers` scalars, `size` at a time.

    A long row is moved in one piece, and squares of numbers and lanes are transposed in registers: moving one
    number of all rows at a time would touch a cache line for each row. Where the last square would leave the
    table, it starts earlier and overlaps the one before.
    """
    vec = wp.types.vector(length=size, dtype=real)
    read, write, *_ = cells_of(real)
    squares = 1 < size <= numbers

    @wp.func_native("return table.data[number].c[lane];")
    def get(table: wp.array(dtype=vec), number: int, lane: int) -> real: ...

    @wp.func_native("table.data[number].c[lane] = value;")
    def put(table: wp.array(dtype=vec), number: int, lane: int, value: real): ...

    @wp.func_native(_squares(numbers, size, real, loads=True) if squares else "")
    def load_squares(values: wp.array(dtype=real), stride: int, first: int, table: wp.array(dtype=vec)): ...

    @wp.func_native(_squares(numbers, size, real, loads=False) if squares else "")
    def store_squares(values: wp.array(dtype=real), stride: int, first: int, table: wp.array(dtype=vec)): ...

    @wp.func
    def load(values: wp.array(dtype=real), stride: int, first: int, count: int, table: wp.array(dtype=vec)):
        if wp.static(squares) and count == size:
            load_squares(values, stride, first, table)
        else:
            for t in range(count):
                for q in range(numbers):
                    put(table, q, t, read(values, stride * (first + t) + q))

    @wp.func
    def store(values: wp.array(dtype=real), stride: int, first: int, count: int, table: wp.array(dtype=vec)):
        if values:
            if wp.static(squares) and count == size:
                store_squares(values, stride, first, table)
            else:
                for t in range(count):
                    for q in range(numbers):
                        write(values, stride * (first + t) + q, get(table, q, t))

    return Tables(load, store, get, put)


def _squares(numbers: int, size: int, real: Any, *, loads: bool) -> str:
    """C++ that moves all squares between rows in memory and a table; `size` is a power of two.

    A square is transposed by swapping its blocks beside the diagonal, half the square first, then ever
    smaller ones: two shuffles for two rows.
    """
    scalar = {wp.float32: "float", wp.float64: "double"}[real]
    begins = [*range(0, numbers - size, size), numbers - size]
    shuffles = []
    half = size // 2
    while half > 0:
        upper = ", ".join(str(size + q - half if q & half else q) for q in range(size))
        lower = ", ".join(str(size + q if q & half else q + half) for q in range(size))
        for row in range(size):
            if not row & half:
                pair = f"rows[{row}], rows[{row + half}]"
                shuffles.append(f"kept = __builtin_shufflevector({pair}, {upper});")
                shuffles.append(f"rows[{row + half}] = __builtin_shufflevector({pair}, {lower});")
                shuffles.append(f"rows[{row}] = kept;")
        half //= 2
    in_array, in_table = "values.data + stride * (first + t) + begin", "table.data + begin + t"
    source, target = (in_array, in_table) if loads else (in_table, in_array)
    # Prefetch the next rows.
    ahead = f"__builtin_prefetch(values.data + stride * (first + t + {size}) + begin);" if loads else ""
    return f"""
typedef {scalar} Row __attribute__((vector_size({size} * sizeof({scalar}))));
const int begins[] = {{{", ".join(map(str, begins))}}};
for (int begin : begins) {{
    Row rows[{size}], kept;
    for (int t = 0; t < {size}; ++t) {{
        __builtin_memcpy(&rows[t], {source}, sizeof(Row));
        {ahead}
    }}
    {" ".join(shuffles)}
    for (int t = 0; t < {size}; ++t) __builtin_memcpy({target}, &rows[t], sizeof(Row));
}}
"""
