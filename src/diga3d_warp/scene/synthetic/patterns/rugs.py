"""Rugs: a field of one motif, and borders around it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.random import Generator

from diga3d_warp.materials.painting import color, edge, mix, noise

Motif = Callable[[Generator, np.ndarray, np.ndarray, Sequence[str]], np.ndarray]
"""A random generator, x and y from the rug's middle [m] and four colours to the field, shape (S, S, 3)."""


def diamonds(rng: Generator, x: np.ndarray, y: np.ndarray, colors: Sequence[str]) -> np.ndarray:
    """A lattice of nested diamonds."""
    size = rng.uniform(0.15, 0.24)
    distance = np.abs((x / size + 0.5) % 1 - 0.5) + np.abs((y / size + 0.5) % 1 - 0.5)
    field = np.broadcast_to(color(colors[0]), (*x.shape, 3))
    for reach, shade in ((0.40, colors[1]), (0.28, colors[2]), (0.12, colors[3])):
        field = mix(field, shade, edge(reach - distance, 0.04))
    return field


def stripes(rng: Generator, x: np.ndarray, y: np.ndarray, colors: Sequence[str]) -> np.ndarray:
    """Bands across the rug, some of them with a zigzag."""
    band = rng.uniform(0.09, 0.14)
    row = np.floor(y / band).astype(int)
    order = rng.integers(0, len(colors), 64)
    field = np.stack([color(code) for code in colors])[order[row % 64]]
    zigzag = np.abs((x / band) % 1 - 0.5) - np.abs((y / band) % 1 - 0.5)
    drawn = edge(0.12 - np.abs(zigzag - 0.05), 0.06) * (row % 3 == 0)
    return mix(field, colors[3], drawn)


def medallion(rng: Generator, x: np.ndarray, y: np.ndarray, colors: Sequence[str]) -> np.ndarray:
    """A star in the middle, its quarters in the corners, small blossoms between."""
    half_x, half_y = np.abs(x).max(), np.abs(y).max()
    petals = rng.integers(6, 11)
    cell = rng.uniform(0.10, 0.14)
    blossom = np.hypot((x / cell) % 1 - 0.5, (y / cell + 0.5 * (np.floor(x / cell) % 2)) % 1 - 0.5)
    field = np.broadcast_to(color(colors[0]), (*x.shape, 3))
    field = mix(field, colors[1], edge(0.26 - blossom, 0.08))
    field = mix(field, colors[3], edge(0.11 - blossom, 0.06))
    stars = ((x, y), (half_x - np.abs(x), half_y - np.abs(y)))
    for across, along in stars:
        radius, angle = np.hypot(across / half_x, along / half_y), np.arctan2(along, across)
        reach = 0.5 + 0.05 * np.cos(petals * angle)
        for share, shade in ((1.0, colors[3]), (0.93, colors[2]), (0.6, colors[1]), (0.35, colors[0])):
            field = mix(field, shade, edge(share * reach - radius, 0.02))
    return field


def checks(rng: Generator, x: np.ndarray, y: np.ndarray, colors: Sequence[str]) -> np.ndarray:
    """Squares in two colours with a smaller square in each."""
    size = rng.uniform(0.14, 0.22)
    odd = (np.floor(x / size) + np.floor(y / size)) % 2
    inside = np.maximum(np.abs(x / size % 1 - 0.5), np.abs(y / size % 1 - 0.5))
    field = mix(colors[0], colors[3], odd)
    return mix(field, mix(colors[1], colors[2], odd), edge(0.26 - inside, 0.05))


MOTIFS: dict[str, Motif] = {
    "diamonds": diamonds,
    "stripes": stripes,
    "a medallion": medallion,
    "checks": checks,
}
"""Motifs by what a caption says after "with"."""

COLORS: dict[str, tuple[str, str, str, str]] = {
    "red": ("#8c2f2b", "#d8b56a", "#27415f", "#e8dcc0"),
    "blue": ("#2b4a72", "#c9b27a", "#7d2f2f", "#e6e0cf"),
    "green": ("#3f5f47", "#d3bd84", "#8a4a32", "#ece4cc"),
    "ochre": ("#b98a3c", "#5c3a26", "#2f5254", "#efe3c4"),
    "grey": ("#7c7d80", "#3d4148", "#b9a68a", "#e7e5df"),
}
"""Ground, two accents and a light colour, by the word for the whole."""


def rug(width: float, depth: float, motif: str, colors: str) -> Callable[[Generator, int], np.ndarray]:
    """A painter of a rug; its texture is shown once over all of it.

    Args:
        width, depth: Of the rug along u and v [m].
        motif: A key of `MOTIFS`.
        colors: A key of `COLORS`.
    """
    codes = COLORS[colors]

    def painter(rng: Generator, side: int) -> np.ndarray:
        centers = (np.arange(side) + 0.5) / side - 0.5
        x, y = np.meshgrid(centers * width, centers * depth)
        inward = np.minimum(width / 2 - np.abs(x), depth / 2 - np.abs(y))
        border = rng.uniform(0.14, 0.22)
        woven = MOTIFS[motif](rng, x, y, codes)
        woven = mix(codes[2], woven, edge(inward - border, 0.012))
        pitch = rng.uniform(0.08, 0.12)
        zigzag = np.abs((x + y) / pitch % 1 - 0.5) * 0.5 * border
        woven = mix(woven, codes[1], edge(0.013 - np.abs(inward - 0.42 * border - zigzag), 0.008))
        woven = mix(woven, codes[3], edge(0.012 - np.abs(inward - border), 0.008))
        woven = mix(codes[3], woven, edge(inward - 0.035, 0.01))
        wool = 1 + 0.07 * noise(rng, side, 0.7) + 0.06 * noise(rng, side, 1.5)
        return woven * wool[..., None]

    return painter
