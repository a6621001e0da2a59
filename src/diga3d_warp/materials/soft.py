"""Cloth and skin: denim, linen, knitted wool, tartan, velvet, leather, snakeskin."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from diga3d_warp.materials.painting import cells, color, edge, grid, mix, noise, ramp, relief, scattered


def denim(rng: Generator, side: int) -> np.ndarray:
    """Blue twill, worn."""
    u, v = grid(side)
    twill = np.sin(2 * np.pi * 56 * (u + v))
    threads = noise(rng, side, 0.7, (1, 14))
    worn = noise(rng, side, 1.7)
    share = 0.42 + 0.16 * twill + 0.11 * threads + 0.10 * worn
    return ramp(("#16233f", "#2c4573", "#5777a6", "#a9bcd6"), share)


def linen(rng: Generator, side: int) -> np.ndarray:
    """Undyed plain weave of uneven threads."""
    u, v = grid(side)
    count = 48
    warp, weft = np.sin(2 * np.pi * count * u), np.sin(2 * np.pi * count * v)
    over = np.where(((u * count).astype(int) + (v * count).astype(int)) % 2 == 0, warp, weft)
    slubs = noise(rng, side, 0.9, (1, 20)) + noise(rng, side, 0.9, (20, 1))
    return ramp(("#8f7f62", "#c2b391", "#e2d6ba"), 0.5 + 0.14 * np.abs(over) - 0.07 + 0.11 * slubs)


def knit(rng: Generator, side: int) -> np.ndarray:
    """Knitted wool: columns of V-shaped stitches."""
    u, v = grid(side)
    columns, rows = 16, 20
    x = u * columns % 1 - 0.5
    y = (v * rows + 1.1 * np.abs(x)) % 1 - 0.5
    strand = np.sqrt(np.clip(1 - (y / 0.5) ** 2, 0, 1)) * np.clip(
        1 - (np.abs(np.abs(x) - 0.25) / 0.25) ** 4, 0, 1
    )
    fuzz = noise(rng, side, 0.6)
    wool = ramp(("#541c1f", "#9c2f35", "#c65a58", "#e39a8f"), 0.1 + 0.62 * strand + 0.06 * fuzz)
    return wool * (1 + 0.05 * noise(rng, side, 1.6))[..., None]


def tartan(rng: Generator, side: int) -> np.ndarray:
    """Red checked cloth with green, navy, white and yellow stripes."""
    u, v = grid(side)
    stripes = (
        (0.0, 0.16, "#173a2a"),
        (0.5, 0.10, "#1b2547"),
        (0.25, 0.012, "#f2efe4"),
        (0.75, 0.012, "#e3b63c"),
    )

    def threads(position: np.ndarray) -> np.ndarray:
        sett = np.broadcast_to(color("#b3202a"), (*position.shape, 3))
        for middle, half, code in stripes:
            distance = np.abs((2 * position - middle + 0.5) % 1 - 0.5)
            sett = mix(sett, code, edge(half - distance, 0.006))
        return sett

    diagonal = 0.5 + 0.42 * np.sin(2 * np.pi * 64 * (u + v))
    cloth = mix(threads(u), threads(v), diagonal)
    return cloth * (1 + 0.05 * noise(rng, side, 0.6))[..., None]


def velvet(rng: Generator, side: int) -> np.ndarray:
    """Purple pile with pressed streaks."""
    pile = noise(rng, side, 1.7, (1, 2))
    fine = noise(rng, side, 0.5)
    return ramp(("#22093a", "#4a1a74", "#7c3fae", "#c08be0"), 0.40 + 0.17 * pile + 0.04 * fine)


def leather(rng: Generator, side: int) -> np.ndarray:
    """Brown grained hide."""
    warp = 0.004 * np.stack([noise(rng, side, 1.3), noise(rng, side, 1.3)], -1)
    pores = cells(scattered(rng, 40, 40, 1.1), side, warp)
    dome = np.clip(pores.border / 0.007, 0, 1) ** 0.7
    clouds = noise(rng, side, 1.7)
    hide = ramp(
        ("#3b1d0e", "#6b3a1e", "#94572f", "#b87a4a"), 0.5 + 0.14 * clouds + 0.05 * noise(rng, side, 0.8)
    )
    return hide * (relief(0.004 * dome, 0.6) * (0.6 + 0.4 * dome))[..., None]


def snakeskin(rng: Generator, side: int) -> np.ndarray:
    """Scales in rows with dark blotches."""
    rows, columns = 26, 18
    u, v = np.meshgrid((np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows)
    u = u + 0.5 * (np.arange(rows) % 2)[:, None] / columns
    scales = cells(np.stack([u, v], -1).reshape(-1, 2), side)
    dome = np.clip(scales.border / 0.013, 0, 1) ** 0.6
    blotch = edge(noise(rng, side, 2.0) - 0.35, 0.5)
    tone = (0.9 + 0.2 * rng.random(rows * columns))[scales.number]
    skin = mix("#cdb98a", "#5a3f22", blotch) * tone[..., None]
    return mix("#2a1e12", skin * relief(0.008 * dome, 0.55)[..., None], edge(scales.border - 0.0016, 0.003))
