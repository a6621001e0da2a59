"""A seamless texture wrapped around an object: projected along three axes and blended by the normal."""

from __future__ import annotations

import numpy as np

from diga3d_warp.objects.frame import Frame

SHARPNESS = 5.0
"""Power of the normal in the blend. Higher narrows the zone where two projections overlap, and shows its
edge."""

SHIFTS = ((0.0, 0.0), (0.37, 0.61), (0.71, 0.23))
"""Offsets of the three projections [repeats], different so that no mirror images meet at an edge."""


def wrap(
    texture: np.ndarray, points: np.ndarray, normals: np.ndarray, frame: Frame, period: float
) -> np.ndarray:
    """Colour of points on a surface, shape (P, 3).

    Blended colours keep the texture's contrast: their deviations from the mean colour are divided by the
    length of the weights (Heitz and Neyret 2018), where a plain mean would be paler.

    Args:
        texture: Seamless, shape (S, S, 3); v runs downwards on upright surfaces.
        points, normals: World space, shape (P, 3).
        frame: The object's.
        period: Edge of one repeat [scene units].
    """
    place = frame.inward(points) / period
    normal = frame.turned(normals)
    weight = np.abs(normal) ** SHARPNESS
    weight /= np.maximum(weight.sum(axis=1, keepdims=True), 1e-12)
    x, y, z = place.T
    mean = texture.mean(axis=(0, 1))
    # u runs to the right as seen from outside.
    planes = ((np.sign(normal[:, 0]) * y, -z), (-np.sign(normal[:, 1]) * x, -z), (x, -y))
    deviation = np.zeros((len(points), 3))
    for k, (u, v) in enumerate(planes):
        seen = sampled(texture, u + SHIFTS[k][0], v + SHIFTS[k][1])
        deviation += weight[:, k : k + 1] * (seen - mean)
    return np.clip(mean + deviation / np.linalg.norm(weight, axis=1, keepdims=True), 0.0, 1.0)


def sampled(texture: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Bilinear colours of a repeating texture (H, W, 3) at u, v in repeats (P,), shape (P, 3)."""
    height, width = texture.shape[:2]
    column, row = u * width - 0.5, v * height - 0.5
    left, top = np.floor(column).astype(int), np.floor(row).astype(int)
    across, down = (column - left)[:, None], (row - top)[:, None]

    def at(r: np.ndarray, c: np.ndarray) -> np.ndarray:
        return texture[r % height, c % width]

    upper = at(top, left) * (1 - across) + at(top, left + 1) * across
    lower = at(top + 1, left) * (1 - across) + at(top + 1, left + 1) * across
    return upper * (1 - down) + lower * down
