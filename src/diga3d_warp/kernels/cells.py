"""Cells of contiguous arrays, reached without stride and sign checks.

Warp's own indexing multiplies by a variable stride and wraps negative cells; both defeat the loop vectoriser.
Each function compiles to one move.
"""

import warp as wp


@wp.func_native("return values.data[cell];")
def read(values: wp.array(dtype=float), cell: int) -> float: ...


@wp.func_native("values.data[cell] = value;")
def write(values: wp.array(dtype=float), cell: int, value: float): ...
