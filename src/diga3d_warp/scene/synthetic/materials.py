"""Procedural materials: seamless square textures of matte surfaces, painted with seeded noise.

Colours here are display values in [0, 1]. A texture repeats in both directions; u runs along its columns, v
along its rows. Detail at every size gives a fitting something to hold on to.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from diga3d_warp.materials import masonry, metal, nature, stone, wood
from diga3d_warp.materials.painting import color, edge, grid, mix, noise


@dataclass(frozen=True)
class Material:
    """What a surface is made of.

    Attributes:
        name: As a prompt may name it; seeds the texture.
        period: Edge of one repeat on a surface [m].
        side: Edge of the texture [texels], a power of two; 2 to 3 mm a texel, finer than a pixel of the
            cameras at 640 px width.
        painter: Paints the texture, given a random generator and the side: shape (side, side, 3).
    """

    name: str
    period: float
    side: int
    painter: Callable[[Generator, int], np.ndarray]

    def texture(self, seed: int) -> np.ndarray:
        """The texture in display values, shape (S, S, 3), float64 in [0, 1]; same seed, same texture."""
        rng = np.random.default_rng([seed, *self.name.encode()])
        return np.clip(self.painter(rng, self.side), 0.0, 1.0)


def _wallpaper(rng: Generator, side: int) -> np.ndarray:
    u, v = grid(side)
    paper = mix("#93ab9c", "#a6bbab", 0.5 + 0.3 * np.sign(np.sin(8 * np.pi * u)))
    for shift, scale in ((0.0, 1.0), (0.5, 0.8)):
        x = (2 * u + shift) % 1 - 0.5
        y = (2 * v + shift) % 1 - 0.5
        radius, angle = np.hypot(x, y) / scale, np.arctan2(y, x)
        petals = 0.17 + 0.09 * np.cos(6 * angle)
        paper = mix(paper, "#e9e3cc", edge(petals - radius, 0.03))
        paper = mix(paper, "#b5654f", edge(0.06 - radius, 0.03))
    return paper + 0.018 * noise(rng, side, 0.5)[..., None]


def _painted(rng: Generator, side: int) -> np.ndarray:
    return color("#e8e4da") + 0.02 * noise(rng, side, 0.9, (12, 1))[..., None]


def _cloth(rng: Generator, side: int) -> np.ndarray:
    u, v = grid(side)
    threads = 0.04 * np.sin(2 * np.pi * 64 * u) * np.sin(2 * np.pi * 64 * v)
    return color("#e0e0e0") + (threads + 0.04 * noise(rng, side, 0.8))[..., None]


def _rug(rng: Generator, side: int) -> np.ndarray:
    u, v = grid(side)
    x, y = (u - 0.5) * 1.9, (v - 0.5) * 1.5  # [m] from the middle
    inward = np.minimum(0.95 - np.abs(x), 0.75 - np.abs(y))
    rug = np.broadcast_to(color("#8c2f2b"), (side, side, 3))
    cell_x, cell_y = (x / 0.19 + 0.5) % 1 - 0.5, (y / 0.19 + 0.5) % 1 - 0.5
    diamond = np.abs(cell_x) + np.abs(cell_y)
    rug = mix(rug, "#d8b56a", edge(0.40 - diamond, 0.04))
    rug = mix(rug, "#27415f", edge(0.28 - diamond, 0.04))
    rug = mix(rug, "#e8dcc0", edge(0.12 - diamond, 0.04))
    rug = mix("#27415f", rug, edge(inward - 0.20, 0.01))
    zigzag = np.abs((x + y) / 0.1 % 1 - 0.5) * 0.06
    rug = mix(rug, "#d8b56a", edge(0.012 - np.abs(inward - 0.105 - zigzag), 0.006))
    rug = mix(rug, "#e8dcc0", edge(0.012 - np.abs(inward - 0.19), 0.006))
    rug = mix("#d9cfb4", rug, edge(inward - 0.04, 0.01))
    wool = 1 + 0.09 * noise(rng, side, 0.5) + 0.06 * noise(rng, side, 1.5)
    return rug * wool[..., None]


def _picture(rng: Generator, side: int) -> np.ndarray:
    u, v = grid(side)
    picture = mix("#4f83b5", "#f2d7a6", v / 0.6)
    picture = mix(picture, "#fff3c9", edge(0.07 - np.hypot(u - 0.68, v - 0.30), 0.02))
    for horizon, height, shade in ((0.50, 0.16, "#7487a0"), (0.66, 0.12, "#55794f"), (0.82, 0.07, "#35542f")):
        ridge = height * noise(rng, side, 2.0)[0] * 0.5
        picture = mix(picture, shade, edge(v - horizon - ridge, 0.01))
    return picture + 0.03 * noise(rng, side, 0.8, (4, 1))[..., None]


def _porcelain(rng: Generator, side: int) -> np.ndarray:
    """Cream glaze with painted bands; a repeat is an eighth of a vase around, and all of it along."""
    u, v = grid(side)
    glaze = mix("#e6e0d0", "#f3eee2", 0.5 + 0.3 * noise(rng, side, 1.5))
    blue = "#27508f"
    x = np.abs(u - 0.5)
    for middle, half in ((0.13, 0.016), (0.30, 0.010), (0.68, 0.010), (0.92, 0.030)):
        glaze = mix(glaze, blue, edge(half - np.abs(v - middle), 0.008))
    petal = 0.34 * np.sqrt(np.clip(1 - ((v - 0.49) / 0.165) ** 2, 0, 1))
    glaze = mix(glaze, blue, edge(petal - x - 0.02, 0.04))
    glaze = mix(glaze, "#c9562e", edge(petal * 0.55 - x - 0.02, 0.04))
    leaf = 0.5 * np.clip((0.90 - v) / 0.18, 0, 1) * (v > 0.70)
    glaze = mix(glaze, "#3f7a4f", edge(leaf - x - 0.02, 0.04))
    drops = np.hypot((u * 2 % 1 - 0.5) / 2 * 0.5, v - 0.22)
    glaze = mix(glaze, "#c9562e", edge(0.045 - drops, 0.01))
    return glaze + 0.02 * noise(rng, side, 0.6)[..., None]


def _beach_ball(rng: Generator, side: int) -> np.ndarray:
    u, v = grid(side)
    colors = np.stack([color(c) for c in ("#d94436", "#f1ece0", "#2d6fb0", "#f1ece0", "#e8b93a", "#f1ece0")])
    ball = colors[(u * 6).astype(int) % 6]
    ball = mix(ball, "#f1ece0", edge(np.abs(v - 0.5) - 0.44, 0.01))
    return ball + 0.02 * noise(rng, side, 0.8)[..., None]


MATERIALS: dict[str, Material] = {
    material.name: material
    for material in (
        Material("planks", 2.56, 1024, wood.planks),
        Material("bricks", 0.96, 512, masonry.bricks),
        Material("wallpaper", 0.64, 256, _wallpaper),
        Material("plaster", 1.28, 512, masonry.plaster),
        Material("painted wood", 0.64, 256, _painted),
        Material("oak", 0.8, 256, wood.oak),
        Material("walnut", 0.8, 256, wood.walnut),
        Material("cloth", 0.32, 128, _cloth),
        Material("rug", 1.7, 512, _rug),
        Material("picture", 0.8, 256, _picture),
        Material("porcelain", 0.4, 256, _porcelain),
        Material("marble", 0.6, 256, stone.marble),
        Material("gold", 0.5, 256, metal.gold),
        Material("leaf", 0.2, 128, nature.leaf),
        Material("terracotta", 0.5, 256, masonry.terracotta),
        Material("beach ball", 0.6, 256, _beach_ball),
    )
}
"""Materials of the room, by name."""
