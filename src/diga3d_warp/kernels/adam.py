"""One step of Adam (Kingma and Ba 2015) on the rows of a parameter that are visible in an image.

Rows of culled gaussians keep value and moments, as in Taming 3DGS (Mallick et al. 2024): their gradient is
zero, so old moments alone would move them, at the same memory traffic as visible ones. Regularisers do not
reach them either; density control moves gaussians that are never visible.

Invariants
- A parameter is flat: row `r` holds the cells from `r * width` on. The loop over the cells of a row is one of
  vector instructions where rows are wide, as those of harmonics are: three quarters of all cells.
- An index writes its own row alone, so results do not depend on the number of threads.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import warp as wp

from diga3d_warp.kernels.cells import cells_of
from diga3d_warp.kernels.launch import OPTIONS, launch

read, write, *_ = cells_of(wp.float32)


@dataclass(frozen=True)
class Decay:
    """Adam's constants, those of 3DGS.

    Attributes:
        first, second: Share of the old moment that a step keeps.
        floor: Added to the root of the second moment. 3DGS: 1e-15, as its gradients are tiny.
    """

    first: float = 0.9
    second: float = 0.999
    floor: float = 1e-15


DECAY = Decay()


@cache
def step_kernel(width: int) -> wp.Kernel:
    """The kernel for rows of `width` cells."""

    @wp.kernel(module="unique", module_options=OPTIONS)
    def adam(
        offset: int,
        moving: wp.array(dtype=int),
        gradient: wp.array(dtype=float),
        rates: wp.array(dtype=float),
        root_bias: float,
        # outputs
        values: wp.array(dtype=float),
        first: wp.array(dtype=float),
        second: wp.array(dtype=float),
    ):
        row = wp.tid() + offset
        if moving[row] == 0:
            return
        start = row * wp.static(width)
        k = int(0)
        while k < wp.static(width):
            cell = start + k
            g = read(gradient, cell)
            m = read(first, cell)
            v = read(second, cell)
            m = m + wp.static(1.0 - DECAY.first) * (g - m)
            v = wp.static(DECAY.second) * v + wp.static(1.0 - DECAY.second) * (g * g)
            step = read(rates, k) * m / (wp.sqrt(v) * root_bias + wp.static(DECAY.floor))
            write(first, cell, m)
            write(second, cell, v)
            write(values, cell, read(values, cell) - step)
            k += 1

    return adam


def step(
    count: int, width: int, moving: wp.array, gradient: wp.array, rates: Sequence[float], steps: int,
    outputs: list,
) -> None:  # fmt: skip
    """Move the rows that are visible, and their moments.

    Arrays are contiguous.

    Args:
        count: Number of rows N.
        width: Cells of a row.
        moving: 1 where a row shall move, else 0, shape (N,), int32.
        gradient: Of the parameter, shape (N * width,), float32.
        rates: Learning rate of each cell of a row [units of the parameter], `width` numbers.
        steps: Steps of Adam with this one, from which the bias of young moments is corrected.
        outputs: Parameter, first and second moment, each (N * width,), float32.
    """
    device = gradient.device
    unbiased = [rate / (1.0 - DECAY.first**steps) for rate in rates]
    root_bias = (1.0 - DECAY.second**steps) ** -0.5
    launch(
        step_kernel(width), count,
        [moving, gradient, wp.array(unbiased, dtype=float, device=device), root_bias], outputs,
        device=device, work=width,
    )  # fmt: skip
