"""Scalar, vector and matrix types of one floating-point precision.

A kernel factory takes a precision and writes its kernel over these, so that the same source runs in float32
for work and in float64 for gradient checks and for the exact renderer. A constant is made by `real(...)`
outside the kernel and captured: a literal would be a float32.
"""

from functools import cache
from typing import Any, NamedTuple

import warp as wp

REALS = {"float32": wp.float32, "float64": wp.float64}
"""Scalar type of each precision that `config.Accuracy` names."""


def precision_of(array: wp.array) -> str:
    """Name of the precision of an array of scalars, vectors or matrices."""
    real = getattr(array.dtype, "_wp_scalar_type_", array.dtype)
    return next(name for name, known in REALS.items() if known is real)


class Types(NamedTuple):
    """Vectors and matrices of one scalar type, named as in Warp."""

    vec2: Any
    vec3: Any
    vec4: Any
    mat22: Any
    mat33: Any
    mat44: Any


@cache
def types_of(real: Any) -> Types:
    """The types over `wp.float32` or `wp.float64`."""
    vectors = (wp.types.vector(length=n, dtype=real) for n in (2, 3, 4))
    matrices = (wp.types.matrix(shape=(n, n), dtype=real) for n in (2, 3, 4))
    return Types(*vectors, *matrices)
