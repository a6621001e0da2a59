"""Building blocks of procedural materials: seamless noise, cells, grids, and mixing of colours.

Every texture is square and repeats in both directions; u runs along its columns, v along its rows. Colours
are display values in [0, 1].
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.random import Generator

GAMMA = 2.2
"""Display value = linear light ** (1 / 2.2), the customary stand-in for the sRGB curve."""


def noise(rng: Generator, side: int, slope: float = 1.5, along: tuple[float, float] = (1, 1)) -> np.ndarray:
    """Seamless fractal noise of mean 0 and deviation 1, shape (side, side).

    Args:
        rng: Random generator.
        side: Edge [texels].
        slope: Amplitude falls as frequency ** -slope: 1 is rough, 2 is cloudy.
        along: Stretch of the features along u and v.
    """
    across = np.fft.rfftfreq(side, 1 / side) * along[0]
    down = np.fft.fftfreq(side, 1 / side)[:, None] * along[1]
    frequency = np.hypot(across, down)
    frequency[0, 0] = np.inf
    spectrum = np.fft.rfft2(rng.standard_normal((side, side))) * frequency**-slope
    field = np.fft.irfft2(spectrum, s=(side, side))
    return field / field.std()


def band(rng: Generator, side: int, cycles: float, along: tuple[float, float] = (1, 1)) -> np.ndarray:
    """Seamless noise of one size only, mean 0 and deviation 1, shape (side, side).

    Args:
        rng: Random generator.
        side: Edge [texels].
        cycles: Features per repeat: the noise keeps frequencies around this one.
        along: Stretch of the features along u and v.
    """
    across = np.fft.rfftfreq(side, 1 / side) * along[0]
    down = np.fft.fftfreq(side, 1 / side)[:, None] * along[1]
    octaves = np.log2(np.maximum(np.hypot(across, down), 1e-6) / cycles)
    spectrum = np.fft.rfft2(rng.standard_normal((side, side))) * np.exp(-2.0 * octaves**2)
    field = np.fft.irfft2(spectrum, s=(side, side))
    return field / field.std()


def grid(side: int) -> tuple[np.ndarray, np.ndarray]:
    """Texel centres (u, v) in [0, 1], each of shape (side, side)."""
    centers = (np.arange(side) + 0.5) / side
    u, v = np.meshgrid(centers, centers)
    return u, v


def color(code: str) -> np.ndarray:
    """Colour of a code such as "#8a5a2b", shape (3,)."""
    return np.array([int(code[k : k + 2], 16) for k in (1, 3, 5)]) / 255


def mix(a: np.ndarray | str, b: np.ndarray | str, share: np.ndarray) -> np.ndarray:
    """From colour `a` to colour `b` as `share` (any shape) goes from 0 to 1."""
    a, b = (color(c) if isinstance(c, str) else c for c in (a, b))
    return a + (b - a) * np.clip(share, 0, 1)[..., None]


def ramp(codes: tuple[str, ...], share: np.ndarray) -> np.ndarray:
    """Through several colours, evenly spaced, as `share` (any shape) goes from 0 to 1."""
    stops = np.stack([color(code) for code in codes])
    places = np.linspace(0, 1, len(codes))
    return np.stack([np.interp(share, places, stops[:, k]) for k in range(3)], -1)


def edge(distance: np.ndarray, width: float) -> np.ndarray:
    """1 inside (positive distance), 0 outside, over a soft edge of `width`."""
    return np.clip(distance / width + 0.5, 0, 1)


def relief(height: np.ndarray, strength: float) -> np.ndarray:
    """Light and shade of a seamless relief lit from above left, around 1, shape (side, side).

    Args:
        height: Height [repeats], shape (side, side).
        strength: Change of brightness per unit of slope.
    """
    side = len(height)
    slope_u = (np.roll(height, -1, 1) - np.roll(height, 1, 1)) * side / 2
    slope_v = (np.roll(height, -1, 0) - np.roll(height, 1, 0)) * side / 2
    return np.clip(1 + strength * (0.6 * slope_u + 0.8 * slope_v), 0.25, 1.9)


class Cells(NamedTuple):
    """A seamless mosaic of cells around points.

    Attributes:
        number: Which cell a texel lies in, shape (side, side).
        center: Distance to the cell's point [repeats], shape (side, side).
        border: Distance to the next cell [repeats], approximately, shape (side, side).
    """

    number: np.ndarray
    center: np.ndarray
    border: np.ndarray


def cells(points: np.ndarray, side: int, warp: np.ndarray | None = None) -> Cells:
    """Cells around points of a texture that repeats.

    Args:
        points: In [0, 1), shape (P, 2), at least two.
        side: Edge [texels].
        warp: Shift of each texel [repeats], shape (side, side, 2): bends the straight borders.
    """
    from scipy.spatial import cKDTree

    places = np.stack(grid(side), -1)
    if warp is not None:
        places = places + warp
    distance, index = cKDTree(points % 1, boxsize=1).query(places % 1, k=2)
    return Cells(index[..., 0], distance[..., 0], 0.5 * (distance[..., 1] - distance[..., 0]))


def scattered(rng: Generator, rows: int, columns: int, disorder: float = 0.9) -> np.ndarray:
    """One point in each field of a grid, moved at random by `disorder` fields, shape (rows columns, 2)."""
    u, v = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    places = np.stack([u, v], -1).reshape(-1, 2)
    places += disorder * (rng.random(places.shape) - 0.5)
    return places / (columns, rows) % 1
