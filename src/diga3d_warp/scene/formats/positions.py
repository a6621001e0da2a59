"""Whether float32 holds the positions of gaussians."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class PositionSettings:
    """When float32 holds positions well enough.

    Attributes:
        error: Largest error of rounding that nobody sees [standard deviations of the gaussian].
        share: Part of the gaussians whose error must be smaller. The rest may be needles.
    """

    error: float = 0.05
    share: float = 0.99


POSITIONS = PositionSettings()


def needs_double(means: np.ndarray, log_scales: np.ndarray) -> bool:
    """Whether float32 would move gaussians by a visible part of their size, as with coordinates of UTM.

    Args:
        means: Positions, shape (N, 3), float64.
        log_scales: Logarithms of the standard deviations, shape (N, 3).
    """
    if len(means) == 0:
        return False
    with np.errstate(invalid="ignore", over="ignore"):
        moved = np.abs(means.astype(np.float32) - means).max(axis=1)
        size = np.exp(np.median(log_scales.astype(np.float64), axis=1))
        return bool((moved > POSITIONS.error * size).mean() > 1.0 - POSITIONS.share)
