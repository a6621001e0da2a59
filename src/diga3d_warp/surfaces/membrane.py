"""Harmonic interpolation: the smoothest continuation of what is known at a rim."""

from __future__ import annotations

import numpy as np


def membrane(values: np.ndarray, known: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Solve Laplace's equation on the wanted pixels: each value is the mean of its neighbours.

    Args:
        values: shape (H, W, C), float64; read where `known`.
        known: shape (H, W), bool.
        wanted: shape (H, W), bool; apart from `known`. Each of its connected regions touches a known pixel.

    Returns:
        Values of the wanted pixels in the order of `np.nonzero(wanted)`, shape (M, C).
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.linalg import splu

    height, width = wanted.shape
    index = np.full(wanted.shape, -1, np.int64)
    index[wanted] = np.arange(wanted.sum())
    rows, columns = np.nonzero(wanted)
    degree = np.zeros(len(rows))
    known_sum = np.zeros((len(rows), values.shape[2]))
    entries: list[tuple[np.ndarray, np.ndarray]] = []
    for dy, dx in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        y, x = rows + dy, columns + dx
        inside = (y >= 0) & (y < height) & (x >= 0) & (x < width)
        y, x = np.where(inside, y, 0), np.where(inside, x, 0)
        at_rim = inside & known[y, x]
        joined = inside & wanted[y, x]
        degree += at_rim | joined
        known_sum += np.where(at_rim[:, None], values[y, x], 0.0)
        entries.append((np.flatnonzero(joined), index[y, x][joined]))
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
    return splu(matrix).solve(known_sum)
