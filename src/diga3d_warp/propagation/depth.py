"""Depth behind a filled region: the smooth surface that its surroundings continue into."""

from __future__ import annotations

import numpy as np

from diga3d_warp.errors import InputError

SMOOTHING = 5
"""Side of the median that cleans depth before it is continued [px]: single gaussians stick out of a fitted
surface, and the rim hands them on to the whole region."""


def complete_depth(depth: np.ndarray, hole: np.ndarray) -> np.ndarray:
    """Fill the holes of a depth map by harmonic interpolation of inverse depth.

    The inverse depth of a plane is an affine function of the pixel, which is harmonic: behind an object on a
    floor the floor goes on exactly. Elsewhere it gives the smoothest surface between the rims.

    Args:
        depth: z along the camera axis [scene units], shape (H, W); not positive or not finite is unknown.
        hole: True where depth is wanted whatever it was, shape (H, W), bool.

    Returns:
        Depth that is positive and finite everywhere, shape (H, W), float32. Known depth outside the hole is
        unchanged.

    Raises:
        InputError: no depth is known outside the hole.
    """
    import cv2
    from scipy.sparse import coo_matrix
    from scipy.sparse.linalg import spsolve

    known = np.isfinite(depth) & (depth > 0.0)
    unknown = hole | ~known
    if unknown.all():
        raise InputError("no depth is known outside the masks: the masks cover all that was fitted")
    inverse = np.zeros(depth.shape, np.float32)
    inverse[~unknown] = 1.0 / depth[~unknown]
    if not unknown.any():
        return depth.astype(np.float32)
    rim = cv2.medianBlur(inverse, SMOOTHING)
    height, width = depth.shape
    index = np.full(depth.shape, -1, np.int64)
    index[unknown] = np.arange(unknown.sum())
    rows, columns = np.nonzero(unknown)
    degree = np.zeros(len(rows))
    known_sum = np.zeros(len(rows))
    entries: list[tuple[np.ndarray, np.ndarray]] = []
    for dy, dx in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        y, x = rows + dy, columns + dx
        inside = (y >= 0) & (y < height) & (x >= 0) & (x < width)
        y, x = np.where(inside, y, 0), np.where(inside, x, 0)
        degree += inside
        neighbour = index[y, x]
        at_rim = inside & (neighbour < 0)
        # The median over a thin rim takes in unknown zeros; there the plain value is the better one.
        value = np.where(rim[y, x] > 0.0, rim[y, x], inverse[y, x])
        known_sum += np.where(at_rim, value, 0.0)
        joined = inside & (neighbour >= 0)
        entries.append((np.flatnonzero(joined), neighbour[joined]))
    i = np.concatenate([pair[0] for pair in entries])
    j = np.concatenate([pair[1] for pair in entries])
    diagonal = np.arange(len(rows))
    matrix = coo_matrix(
        (
            np.concatenate([degree, -np.ones(len(i))]),
            (np.concatenate([diagonal, i]), np.concatenate([diagonal, j])),
        ),
        shape=(len(rows), len(rows)),
    ).tocsc()
    solution = spsolve(matrix, known_sum)
    nearest, farthest = float(inverse[~unknown].max()), float(inverse[~unknown].min())
    completed = depth.astype(np.float32).copy()
    completed[unknown] = 1.0 / np.clip(solution, farthest, nearest)
    return completed
