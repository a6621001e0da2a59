"""A kernel whose result is known and whose work is arithmetic: does a device compute, and how fast?

Invariants
- Index i writes cell i alone.
- Cell i ends at the square root of i + 1: Newton's iteration, of any number of steps above about ten.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from diga3d_warp.kernels.launch import OPTIONS, launch

wp.set_module_options(OPTIONS)


@wp.kernel
def newton_roots(
    offset: int,
    steps: int,
    # outputs
    roots: wp.array[float],
):
    i = wp.tid() + offset
    value = float(i + 1)
    root = 0.5 * (value + 1.0)
    for _ in range(steps):
        root = 0.5 * (root + value / root)
    roots[i] = root


def roots_of(count: int, steps: int, device: Any) -> wp.array:
    """Square roots of 1 to `count`, shape (count,), computed in `steps` steps each.

    Args:
        count: Number of roots.
        steps: Newton steps of each; the work grows with it.
        device: Warp device or its name.
    """
    roots = wp.empty(count, dtype=float, device=device)
    launch(newton_roots, count, [steps], [roots], device=device, work=steps)
    return roots
