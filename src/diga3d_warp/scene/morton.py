"""Morton order: neighbours in space become neighbours in a sequence."""

from __future__ import annotations

import numpy as np

BITS = 21
"""Bits of each coordinate: three of them fill 63 of the 64 bits of a key."""


def morton_keys(positions: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Keys along the Morton curve through a box, shape (N,), uint64.

    Two positions share the first 3 L of 63 bits if they lie in the same cell of a grid of 2^L cells a side.

    Args:
        positions: Finite, shape (N, 3); those outside the box count as on its border.
        low, high: Corners of the box, shape (3,).
    """
    share = (positions - low) / np.maximum(high - low, np.finfo(np.float64).tiny)
    cells = (share.clip(0.0, 1.0) * ((1 << BITS) - 1)).astype(np.uint64)
    keys = np.zeros(len(positions), np.uint64)
    for axis in range(3):
        keys |= _spread(cells[:, axis]) << np.uint64(axis)
    return keys


def morton_order(positions: np.ndarray) -> np.ndarray:
    """Rows sorted along the Morton curve through the box of their positions, shape (N,).

    Args:
        positions: Finite, shape (N, 3), N at least 1.
    """
    keys = morton_keys(positions, positions.min(axis=0), positions.max(axis=0))
    return np.argsort(keys, kind="stable")


def _spread(values: np.ndarray) -> np.ndarray:
    """Two zero bits between each two bits of numbers of 21 bits."""
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        values = (values | (values << np.uint64(shift))) & np.uint64(mask)
    return values
