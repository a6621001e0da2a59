"""Depth behind a filled region: the smooth surface that its surroundings continue into."""

from __future__ import annotations

import numpy as np

from diga3d_warp.errors import InputError
from diga3d_warp.surfaces.membrane import membrane

WINDOW = 5
"""Side of the neighbourhood that a depth at the rim must agree with [px]. Single gaussians stick out of a
fitted surface by a few pixels, and the rim would spread them over the whole region."""

OUTLIER = 3.0
"""From how many median deviations on a depth at the rim is replaced by the median of its neighbourhood [1].
On a slope the rim lies up to two from the median of its known side: those must stay, or every plane would
bend towards the camera or away from it."""


def complete_depth(depth: np.ndarray, hole: np.ndarray) -> np.ndarray:
    """Fill the holes of a depth map by harmonic interpolation of inverse depth.

    The inverse depth of a plane is an affine function of the pixel, which is harmonic: behind an object on a
    floor the floor continues exactly. Elsewhere it gives the smoothest surface between the rims.

    Args:
        depth: z along the camera axis [scene units], shape (H, W); not positive or not finite is unknown.
        hole: True where depth is replaced, shape (H, W), bool.

    Returns:
        Depth that is positive and finite everywhere, shape (H, W), float32. Known depth outside the hole is
        unchanged.

    Raises:
        InputError: no depth is known outside the hole.
    """
    known = np.isfinite(depth) & (depth > 0.0)
    unknown = hole | ~known
    if unknown.all():
        raise InputError("no depth is known outside the masks: the masks cover all that was fitted")
    if not unknown.any():
        return depth.astype(np.float32)
    inverse = np.full(depth.shape, np.nan)
    inverse[~unknown] = 1.0 / depth[~unknown]
    rim = _without_outliers(inverse)
    solution = membrane(rim[..., None], ~unknown, unknown)[:, 0]
    nearest, farthest = float(inverse[~unknown].max()), float(inverse[~unknown].min())
    completed = depth.astype(np.float32).copy()
    completed[unknown] = 1.0 / np.clip(solution, farthest, nearest)
    return completed


def _without_outliers(inverse: np.ndarray) -> np.ndarray:
    """Inverse depth whose pixels at the rim agree with their known neighbourhood; NaN stays unknown."""
    from numpy.lib.stride_tricks import sliding_window_view

    unknown = np.pad(np.isnan(inverse), 1)
    beside = unknown[:-2, 1:-1] | unknown[2:, 1:-1] | unknown[1:-1, :-2] | unknown[1:-1, 2:]
    rows, columns = np.nonzero(beside & ~np.isnan(inverse))
    padded = np.pad(inverse, WINDOW // 2, constant_values=np.nan)
    around = sliding_window_view(padded, (WINDOW, WINDOW))[rows, columns].reshape(-1, WINDOW**2)
    middle = np.nanmedian(around, axis=1)
    deviation = np.nanmedian(np.abs(around - middle[:, None]), axis=1)
    own = inverse[rows, columns]
    clean = inverse.copy()
    clean[rows, columns] = np.where(np.abs(own - middle) > OUTLIER * deviation, middle, own)
    return clean
