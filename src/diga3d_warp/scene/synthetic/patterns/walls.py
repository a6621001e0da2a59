"""Walls, boards and fences: wallpapers, panelling, painted boards, a hedge."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.random import Generator

from diga3d_warp.materials.painting import band, cells, color, edge, grid, mix, noise, ramp, scattered
from diga3d_warp.materials.wood import grain

Painter = Callable[[Generator, int], np.ndarray]


def striped_paper(ground: str, stripe: str, count: int) -> Painter:
    """Wallpaper with `count` upright stripes a repeat and a thin line beside each."""

    def painter(rng: Generator, side: int) -> np.ndarray:
        u, _ = grid(side)
        across = np.abs(u * count % 1 - 0.5)
        paper = mix(ground, stripe, edge(0.22 - across, 0.04))
        paper = mix(paper, stripe, 0.7 * edge(0.02 - np.abs(across - 0.32), 0.02))
        return paper + 0.015 * noise(rng, side, 0.6)[..., None]

    return painter


def flowered_paper(ground: str, petal: str, heart: str) -> Painter:
    """Wallpaper with blossoms in half drop and leaves between."""

    def painter(rng: Generator, side: int) -> np.ndarray:
        u, v = grid(side)
        paper = np.broadcast_to(color(ground), (side, side, 3))
        count = rng.integers(5, 9)
        for shift, scale in ((0.0, 1.0), (0.5, 0.75)):
            x, y = (2 * u + shift) % 1 - 0.5, (2 * v + shift) % 1 - 0.5
            radius, angle = np.hypot(x, y) / scale, np.arctan2(y, x)
            paper = mix(paper, petal, edge(0.19 + 0.08 * np.cos(count * angle) - radius, 0.03))
            paper = mix(paper, heart, edge(0.07 - radius, 0.03))
        x, y = (2 * u + 0.5) % 1 - 0.5, 2 * v % 1 - 0.5
        leaf = 0.05 - np.abs(x + 0.15 * np.sin(2 * np.pi * y)) - 0.05 * np.abs(y)
        paper = mix(paper, heart, 0.6 * edge(leaf, 0.03))
        return paper + 0.015 * noise(rng, side, 0.6)[..., None]

    return painter


def painted(code: str) -> Painter:
    """Paint with traces of the roller."""

    def painter(rng: Generator, side: int) -> np.ndarray:
        return (
            color(code) * (1 + 0.02 * noise(rng, side, 0.9, (1, 8)) + 0.03 * noise(rng, side, 1.7))[..., None]
        )

    return painter


def boards(count: int, dark: str, light: str, gap: float = 0.05) -> Painter:
    """Upright boards, `count` a repeat, with gaps of half width `gap` [boards] between them."""

    def painter(rng: Generator, side: int) -> np.ndarray:
        u, v = grid(side)
        board = (u * count).astype(int)
        wood = grain(rng, side, dark, light).swapaxes(0, 1)
        shift = rng.integers(0, side, count)[board]
        wood = wood[((v * side).astype(int) + shift) % side, (u * side).astype(int)]
        wood = wood * (0.8 + 0.35 * rng.random(count))[board][..., None]
        inward = 0.5 - np.abs(u * count % 1 - 0.5)
        return wood * (0.22 + 0.78 * edge(inward - gap, 0.04))[..., None]

    return painter


def hedge(rng: Generator, side: int) -> np.ndarray:
    """Clipped leaves, light on dark."""
    leaves = cells(scattered(rng, 36, 36, 1.2), side, 0.012 * np.stack([noise(rng, side, 1.3)] * 2, -1))
    tone = (0.5 + 0.5 * (rng.random(36 * 36) - 0.5))[leaves.number]
    shade = 0.5 + 0.18 * noise(rng, side, 1.6) + 0.1 * band(rng, side, 30)
    return (
        ramp(("#16240f", "#2d4a1c", "#4c7330", "#7fa24d"), 0.55 * tone + 0.5 * shade)
        * (0.55 + 0.45 * edge(leaves.border - 0.002, 0.006))[..., None]
    )


def sky(rng: Generator, side: int) -> np.ndarray:
    """Pale blue with soft clouds; shown once around a dome."""
    _, v = grid(side)
    clouds = np.clip(0.45 * noise(rng, side, 1.9, (2, 1)) + 0.1, 0, 1)
    return mix(mix("#8fb4dd", "#dfe8ee", v**0.7), "#f6f7f7", 0.8 * clouds)
