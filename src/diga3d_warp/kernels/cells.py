"""Cells of contiguous arrays, reached without stride and sign checks.

Warp's own indexing multiplies by a variable stride and wraps negative cells; both defeat the loop vectoriser.
Each function compiles to one move.
"""

from functools import cache
from typing import Any, NamedTuple

import warp as wp

PREFETCH = """
#ifndef __CUDA_ARCH__
__builtin_prefetch(&values.data[cell], {write});
if (sizeof(values.data[cell]) > 16)
    __builtin_prefetch((const char*)(&values.data[cell] + 1) - 1, {write});
#endif
"""
"""Prefetches both ends of a larger cell, which may span two cache lines."""


class Cells(NamedTuple):
    """Warp functions for arrays of one type.

    Attributes:
        read: (array, cell) -> value.
        write: (array, cell, value).
        fetch: (array, cell): prefetch the cell for a read; nothing on CUDA.
        claim: (array, cell): prefetch the cell for a write.
    """

    read: Any
    write: Any
    fetch: Any
    claim: Any


@cache
def cells_of(dtype: Any) -> Cells:
    """The functions for arrays of `dtype`."""

    @wp.func_native("return values.data[cell];")
    def read(values: wp.array(dtype=dtype), cell: int) -> dtype: ...

    @wp.func_native("values.data[cell] = value;")
    def write(values: wp.array(dtype=dtype), cell: int, value: dtype): ...

    @wp.func_native(PREFETCH.format(write=0))
    def fetch(values: wp.array(dtype=dtype), cell: int): ...

    @wp.func_native(PREFETCH.format(write=1))
    def claim(values: wp.array(dtype=dtype), cell: int): ...

    return Cells(read, write, fetch, claim)


ALIGN = """
const size_t size = sizeof(values.data[0]);
values.data = (decltype(values.data))(((size_t)values.data + size - 1) / size * size);
return values;
"""


@cache
def aligned_function(dtype: Any) -> Any:
    """Warp function: a local array less one cell, shifted so that no cell crosses a cache line.

    Warp does not align local arrays; a vector as long as a cache line would then span two.
    """

    @wp.func_native(ALIGN)
    def aligned(values: wp.array(dtype=dtype)) -> wp.array(dtype=dtype): ...

    return aligned


@wp.func_native("return values.data[cell]++;")
def take(values: wp.array(dtype=int), cell: int) -> int:
    """Count one more; returns the count before."""
