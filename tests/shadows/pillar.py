"""A pillar on a patterned plane in the light of a sun and a sky: its shadow is known exactly."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from diga3d_warp.materials.painting import GAMMA
from diga3d_warp.shadows.support import Solid
from diga3d_warp.surfaces.photo import Photo
from diga3d_warp.surfaces.planes import Plane
from tabletop import EYES, Pattern, camera_at, checks, photo

RADIUS, TALL = 0.12, 0.5
"""Of the pillar [m]."""

SUN = np.array([-0.8, 0.5, 0.9])
"""Towards the sun."""

AROUND = [*EYES, (2.2, -1.2, 2.0), (2.0, 1.4, 2.1), (0.2, 2.5, 2.2), (-2.1, 1.0, 2.0), (-2.2, -1.0, 2.1)]
"""Places all around."""


def left_by_pillar(x: np.ndarray, y: np.ndarray, taken: float = 0.6) -> np.ndarray:
    """Share of the light that is left on the plane, where the sun gives a share of it."""
    along = SUN[:2] / np.linalg.norm(SUN[:2])
    length = TALL * np.linalg.norm(SUN[:2]) / SUN[2]
    away = -(x * along[0] + y * along[1])
    aside = np.abs(x * along[1] - y * along[0])
    beside = np.hypot(aside, away - np.clip(away, 0.0, length))
    return 1.0 - taken * (beside < RADIUS)


def shaded(pattern: Pattern = checks, taken: float = 0.6, tint: Sequence[float] = (1.0, 1.0, 1.0)) -> Pattern:
    """The pattern with the shadow on it; `tint` is the relative strength of the shadow in each channel."""

    def found(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        left = 1.0 - (1.0 - left_by_pillar(x, y, taken))[..., None] * np.array(tint)
        return np.clip(pattern(x, y) * left ** (1.0 / GAMMA), 0.0, 1.0)

    return found


def seen(pattern: Pattern, eyes: Sequence[Sequence[float]] = AROUND) -> list[Photo]:
    """A photograph of the plane from each place; nobody saw a disc at the pillar's foot."""
    return [photo(camera_at(eye), pattern, hole=0.18) for eye in eyes]


def pillar(count: int = 2500, seed: int = 0) -> Solid:
    """Gaussians on the pillar."""
    rng = np.random.default_rng(seed)
    turn, height = rng.uniform(0.0, 2.0 * np.pi, count), rng.uniform(0.0, TALL, count)
    side = np.stack([RADIUS * np.cos(turn), RADIUS * np.sin(turn), height], axis=1)
    return Solid(side, np.full(count, 0.01), np.full(count, 0.9))


def ground() -> Plane:
    """The plane, with support all around."""
    places = np.random.default_rng(1).uniform(-1.5, 1.5, (500, 2))
    return Plane(np.array([0.0, 0.0, 1.0]), 0.0, np.concatenate([places, np.zeros((500, 1))], axis=1))
