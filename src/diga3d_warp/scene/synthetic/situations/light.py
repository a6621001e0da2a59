"""Light of the situations: a lamp in a room, or the sun."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from diga3d_warp.scene.synthetic.lighting import Lighting
from diga3d_warp.scene.synthetic.materials import Material
from diga3d_warp.scene.synthetic.patterns.walls import sky as clouds
from diga3d_warp.scene.synthetic.solids import Surface, revolved

WARM, COOL = np.array([1.08, 1.0, 0.86]), np.array([0.97, 1.0, 1.05])
"""Linear RGB of lamps, with a mean near 1."""

SKY_RADIUS = 14.0
"""Of the dome [m]: behind everything, near enough for a splat to hold."""


def lamplight(
    rng: Generator, *, azimuth: tuple[float, float] = (-180.0, 180.0), farthest: float = 1.3
) -> Lighting:
    """A soft lamp 2.4 to 3 m above the object, to one side of it.

    Args:
        rng: Picks place, size, strength and tint.
        azimuth: Range of its side [degrees]; 0 is -y, 90 is +x.
        farthest: From the object's axis [m]: within the walls, which would shade it.
    """
    turn, aside = np.radians(rng.uniform(*azimuth)), rng.uniform(0.6, 1.0) * farthest
    center = (aside * np.sin(turn), -aside * np.cos(turn), rng.uniform(2.4, 3.0))
    tint = WARM + rng.random() * (COOL - WARM)
    return _lit(
        center, rng.uniform(0.35, 0.9), rng.uniform(0.7, 0.95) * tint, 0.42 * (0.7 * COOL + 0.3 * tint)
    )


def sunlight(rng: Generator, *, azimuth: tuple[float, float] = (-180.0, 180.0)) -> Lighting:
    """Sun through more or less haze, and an open sky.

    Args:
        rng: Picks place, haze and strength.
        azimuth: Range of its side [degrees]; 0 is -y, 90 is +x.
    """
    turn, rise = np.radians(rng.uniform(*azimuth)), np.radians(rng.uniform(32, 60))
    center = 12.0 * np.array([np.sin(turn) * np.cos(rise), -np.cos(turn) * np.cos(rise), np.sin(rise)])
    haze = rng.uniform(0.3, 1.6)
    strength = rng.uniform(0.55, 0.85)
    return _lit(_triple(center), haze, strength * WARM, (0.95 - 0.6 * strength) * np.array([0.62, 0.7, 0.8]))


def sky_dome() -> Surface:
    """A sky around everything, seen from inside."""
    angle = np.linspace(np.pi / 2, -0.3, 12)
    profile = [(SKY_RADIUS * float(np.cos(a)), SKY_RADIUS * float(np.sin(a))) for a in angle]
    return revolved(profile, Material("sky", 2 * np.pi * SKY_RADIUS, 512, clouds), segments=32)


def _lit(center: tuple[float, float, float], edge: float, light: np.ndarray, sky: np.ndarray) -> Lighting:
    """A square lamp that gives a white surface at the origin, turned to it, the light `light`."""
    radiance = light * np.pi * float(np.square(center).sum()) / edge**2
    return Lighting(center, edge, _triple(radiance), _triple(sky))


def _triple(values: np.ndarray) -> tuple[float, float, float]:
    first, second, third = (float(value) for value in values)
    return first, second, third
