"""Sums over the SIMD lanes of a vector."""

from functools import cache
from typing import Any

import warp as wp


@cache
def total_function(size: int, real: Any) -> Any:
    """Warp function: the sum over `size` lanes.

    Written as a loop, or as a tree, it is compiled to one addition after the other; as vectors that are
    folded in half, to two instructions a fold.
    """
    vec = wp.types.vector(size, real)
    scalar = {wp.float32: "float", wp.float64: "double"}[real]
    folds = []
    half = size // 2
    while half > 0:
        folded = ", ".join(str((lane + half) % size) for lane in range(size))
        folds.append(f"sums += __builtin_shufflevector(sums, sums, {folded});")
        half //= 2
    snippet = f"""
#ifdef __CUDA_ARCH__
{scalar} sum = lanes[0];
for (int q = 1; q < {size}; ++q) sum += lanes[q];
return sum;
#else
typedef {scalar} Vector __attribute__((vector_size({size} * sizeof({scalar}))));
Vector sums;
__builtin_memcpy(&sums, &lanes, sizeof(sums));
{" ".join(folds)}
return sums[0];
#endif
"""

    @wp.func_native(snippet)
    def total(lanes: vec) -> real: ...

    return total
