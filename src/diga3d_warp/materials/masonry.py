"""Materials of walls and floors: bricks, concrete, plaster, tiles, mosaic, terracotta, cobbles."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from diga3d_warp.materials.painting import cells, color, edge, grid, mix, noise, relief, scattered


def bricks(rng: Generator, side: int) -> np.ndarray:
    """Red bricks in running bond, 4 x 12 a repeat."""
    u, v = grid(side)
    rows, columns, size = 12, 4, 0.96
    row = (v * rows).astype(int)
    along = (u * columns + 0.5 * (row % 2)) % columns
    brick = row * columns + along.astype(int)
    wobble = 0.0016 * noise(rng, side, 1.3)
    distance = np.minimum(
        (0.5 - np.abs(v * rows % 1 - 0.5)) * size / rows, (0.5 - np.abs(along % 1 - 0.5)) * size / columns
    )
    rough = 0.5 + 0.22 * noise(rng, side, 1.0)
    clay = mix("#8a3d2a", "#b8694a", rough) * (0.75 + 0.45 * rng.random(rows * columns)[brick])[..., None]
    mortar = mix("#a79f92", "#c9c2b4", 0.5 + 0.25 * noise(rng, side, 0.7))
    return mix(mortar, clay, edge(distance + wobble - 0.006, 0.004))


def plaster(rng: Generator, side: int) -> np.ndarray:
    """Warm lime plaster, clouded."""
    clouds = 0.5 + 0.22 * noise(rng, side, 1.6) + 0.14 * noise(rng, side, 0.6)
    return mix("#c9a879", "#e6cfa6", clouds)


def terracotta(rng: Generator, side: int) -> np.ndarray:
    """Fired clay with traces of the wheel along u."""
    return mix("#a5583a", "#c97f5a", 0.5 + 0.25 * noise(rng, side, 1.0, (3, 1)))


def concrete(rng: Generator, side: int) -> np.ndarray:
    """Grey cast concrete with stains and air bubbles."""
    stains = 0.5 + 0.22 * noise(rng, side, 1.7) + 0.10 * noise(rng, side, 0.8)
    wall = mix("#7f7f7c", "#b5b4ae", stains)
    bubbles = cells(rng.random((260, 2)), side)
    size = (0.0015 + 0.005 * rng.random(260) ** 3)[bubbles.number]
    return wall * (1 - 0.6 * edge(size - bubbles.center, 0.002))[..., None]


def tiles(rng: Generator, side: int) -> np.ndarray:
    """Glazed blue and white tiles with a painted star, 4 x 4 a repeat."""
    u, v = grid(side)
    count = 4
    x, y = u * count % 1 - 0.5, v * count % 1 - 0.5
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    glaze = mix("#e4e6e2", "#f4f4ee", 0.5 + 0.3 * noise(rng, side, 1.5))
    glaze = mix(glaze, "#1f4f96", edge(0.25 + 0.09 * np.cos(8 * angle) - radius, 0.03))
    glaze = mix(glaze, "#f1efe4", edge(0.15 + 0.035 * np.cos(8 * angle + np.pi) - radius, 0.025))
    glaze = mix(glaze, "#d9982f", edge(0.065 - radius, 0.02))
    corner = np.hypot(0.5 - np.abs(x), 0.5 - np.abs(y))
    glaze = mix(glaze, "#2f6bb0", edge(0.17 - corner, 0.02) - edge(0.12 - corner, 0.02))
    joint = 0.5 - np.maximum(np.abs(x), np.abs(y))
    return mix("#9c988f", glaze, edge(joint - 0.018, 0.012))


def mosaic(rng: Generator, side: int) -> np.ndarray:
    """Small glass stones in turquoise, laid by hand."""
    points = scattered(rng, 22, 22, 0.35)
    stones = cells(points, side)
    codes = ("#0f6f7c", "#1f97a0", "#59bfbf", "#a7dcd4", "#0b4a63", "#d9c58a")
    kinds = np.stack([color(c) for c in codes])
    kind = rng.choice(6, len(points), p=[0.24, 0.26, 0.2, 0.12, 0.13, 0.05])
    tone = (0.85 + 0.3 * rng.random(len(points)))[stones.number]
    return mix("#cfc8ba", kinds[kind][stones.number] * tone[..., None], edge(stones.border - 0.003, 0.0035))


def cobbles(rng: Generator, side: int) -> np.ndarray:
    """Worn square stones of a street."""
    points = scattered(rng, 9, 9, 0.45)
    points[:, 0] += np.repeat(np.arange(9) % 2, 9) / 18
    stones = cells(points, side, 0.004 * np.stack([noise(rng, side, 1.3), noise(rng, side, 1.3)], -1))
    dome = np.clip(stones.border / 0.03, 0, 1) ** 0.6
    rough = noise(rng, side, 1.0)
    tone = (0.8 + 0.4 * rng.random(len(points)))[stones.number] * (1 + 0.08 * rough)
    stone = color("#84807a") * tone[..., None] * relief(0.025 * dome + 0.001 * rough, 0.45)[..., None]
    return mix("#2e2a25", stone, edge(stones.border - 0.006, 0.008))
