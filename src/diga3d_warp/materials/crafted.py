"""Made things: porcelain, paper, chocolate, camouflage, checkerboard, polka dots."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from diga3d_warp.materials.painting import cells, color, edge, grid, mix, noise, relief, scattered


def porcelain(rng: Generator, side: int) -> np.ndarray:
    """White glaze with painted blue blossoms."""
    u, v = grid(side)
    glaze = mix("#e9e8e2", "#f8f7f2", 0.5 + 0.3 * noise(rng, side, 1.6))
    for shift, scale, code in ((0.0, 1.0, "#23498f"), (0.5, 0.7, "#3c6bb5")):
        x, y = (2 * u + shift) % 1 - 0.5, (2 * v + shift) % 1 - 0.5
        radius, angle = np.hypot(x, y) / scale, np.arctan2(y, x)
        petals = 0.19 + 0.09 * np.cos(6 * angle)
        glaze = mix(glaze, code, edge(petals - radius, 0.03))
        glaze = mix(glaze, "#dfe6f2", edge(0.75 * petals - radius, 0.03) * 0.75)
        glaze = mix(glaze, code, edge(0.06 - radius, 0.02))
    vine = np.abs((v + 0.04 * np.sin(4 * np.pi * u)) * 2 % 1 - 0.25)
    return mix(glaze, "#5f86c4", edge(0.012 - vine, 0.012))


def paper(rng: Generator, side: int) -> np.ndarray:
    """Crumpled white paper."""
    facets = cells(scattered(rng, 7, 7, 1.2), side, 0.01 * np.stack([noise(rng, side, 1.5)] * 2, -1))
    slopes = rng.normal(size=49)[facets.number]
    folds = np.exp(-facets.border / 0.004)
    lit = 0.90 + 0.05 * slopes - 0.10 * folds + 0.03 * noise(rng, side, 1.5)
    return color("#f6f3ea") * np.clip(lit, 0.55, 1.02)[..., None]


def chocolate(rng: Generator, side: int) -> np.ndarray:
    """A bar of milk chocolate, 5 x 5 pieces a repeat."""
    u, v = grid(side)
    count = 5
    x, y = np.abs(u * count % 1 - 0.5), np.abs(v * count % 1 - 0.5)
    inward = (0.5 - np.maximum(x, y)) / count
    height = 0.5 * np.clip(inward, 0, 0.022) + 0.0007 * noise(rng, side, 1.5)
    bar = mix("#4b2412", "#6e3a1d", 0.5 + 0.2 * noise(rng, side, 1.6))
    return bar * relief(height, 0.7)[..., None]


def camouflage(rng: Generator, side: int) -> np.ndarray:
    """Woodland blotches of green, brown and black."""
    cloth = np.broadcast_to(color("#7d7a4c"), (side, side, 3))
    for code, above in (("#47542f", 0.1), ("#57402a", 0.6), ("#1f211b", 1.0)):
        blotch = noise(rng, side, 2.2, (1, 1.4)) + 0.12 * noise(rng, side, 1.0)
        cloth = mix(cloth, code, edge(blotch - above, 0.06))
    return cloth * (1 + 0.05 * noise(rng, side, 0.5))[..., None]


def checkerboard(rng: Generator, side: int) -> np.ndarray:
    """Black and white squares, 8 x 8 a repeat."""
    u, v = grid(side)
    square = np.sin(8 * np.pi * u) * np.sin(8 * np.pi * v)
    return mix("#1c1c1e", "#f1f0ea", edge(square, 0.06)) * (1 + 0.02 * noise(rng, side, 0.8))[..., None]


def polka_dots(rng: Generator, side: int) -> np.ndarray:
    """White dots on red enamel."""
    u, v = grid(side)
    x, y = u * 6 % 1 - 0.5, v * 6 % 1 - 0.5
    far = np.hypot(0.5 - np.abs(x), 0.5 - np.abs(y))
    dots = edge(0.21 - np.minimum(np.hypot(x, y), far), 0.03)
    return mix("#c4262e", "#f7f3ea", dots) * (1 + 0.02 * noise(rng, side, 1.0))[..., None]
