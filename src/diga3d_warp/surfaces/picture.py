"""A picture of charts, before and after they are filled."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from diga3d_warp.surfaces.chart import Chart

WANTED, THROUGH, UNKNOWN, NOTHING = (1.0, 0.0, 1.0), (0.2, 0.4, 1.0), (0.5, 0.5, 0.5), (0.0, 0.0, 0.0)
"""Colours of what is to be filled, seen through, of no interest, and of no surface."""

GAP = 4
"""Between pictures [px]."""


def charts_picture(before: Sequence[Chart], after: Sequence[Chart]) -> np.ndarray:
    """Each chart, and the same filled, one below the other, RGB in [0, 1], shape (H, W, 3), float32."""
    rows = []
    for empty, full in zip(before, after, strict=True):
        first = np.where(empty.known[..., None], empty.image, UNKNOWN)
        first[empty.through] = THROUGH
        first[empty.wanted] = WANTED
        second = np.where((full.alpha > 0.0)[..., None], full.image, NOTHING)
        gap = np.ones((first.shape[0], GAP, 3))
        rows.append(np.concatenate([first, gap, second], axis=1))
    width = max(row.shape[1] for row in rows)
    padded = [np.pad(row, ((0, GAP), (0, width - row.shape[1]), (0, 0)), constant_values=1.0) for row in rows]
    return np.concatenate(padded).astype(np.float32)
