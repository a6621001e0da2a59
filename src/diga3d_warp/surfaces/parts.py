"""Parts of what is wanted of a chart, each with its own surroundings."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np


def parts_of(wanted: np.ndarray, apart: int) -> Iterator[np.ndarray]:
    """What is wanted (H, W) in parts that lie apart, one mask each.

    Args:
        wanted: shape (H, W), bool.
        apart: Parts that are closer than this belong together [texels].
    """
    import cv2

    box = np.ones((apart, apart), np.uint8)
    count, label = cv2.connectedComponents(cv2.dilate(wanted.astype(np.uint8), box))
    for k in range(1, count):
        yield wanted & (label == k)


def surroundings_of(part: np.ndarray, margin: float, least: int) -> tuple[slice, slice]:
    """The box around a part.

    Args:
        part: shape (H, W), bool, not empty.
        margin: Surroundings [sizes of the part].
        least: Least surroundings [texels].
    """
    rows, columns = np.flatnonzero(part.any(axis=1)), np.flatnonzero(part.any(axis=0))
    pad = max(int(margin * (max(rows[-1] - rows[0], columns[-1] - columns[0]) + 1)), least)
    return (
        slice(max(int(rows[0]) - pad, 0), int(rows[-1]) + pad + 1),
        slice(max(int(columns[0]) - pad, 0), int(columns[-1]) + pad + 1),
    )


def border_labels(label: np.ndarray) -> np.ndarray:
    """Numbers of the parts (H, W) that reach the border, and 0, that of none of them."""
    return np.unique(np.concatenate([[0], label[[0, -1]].ravel(), label[:, [0, -1]].ravel()]))


def rimmed(spots: np.ndarray, told: np.ndarray, wanted: np.ndarray) -> bool:
    """Whether spots (H, W) are most of what is told beside the wanted: then they are no exception."""
    import cv2

    beside = cv2.dilate(wanted.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    beside &= told & ~wanted
    return bool(2 * (spots & beside).sum() > beside.sum())
