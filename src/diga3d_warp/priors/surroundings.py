"""Holes of an image one by one, each with its surroundings."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np


def separate(holes: np.ndarray, apart: int) -> Iterator[np.ndarray]:
    """Holes that are far from each other, one mask each, smallest first: it leaves the next more to copy."""
    import cv2

    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (apart + 1, apart + 1))
    count, label = cv2.connectedComponents(cv2.dilate(holes.astype(np.uint8), disc))
    parts = [holes & (label == k) for k in range(1, count)]
    yield from sorted(parts, key=lambda part: int(part.sum()))


def stretch(start: int, stop: int, least: int, size: int) -> slice:
    """The range cut off at [0, size), at least `least` long if `size` is."""
    start, stop = max(start, 0), min(stop, size)
    short = max(least - (stop - start), 0)
    start = max(min(start - short // 2, size - least), 0)
    return slice(start, min(max(stop, start + least), size))
