"""Stone: marbles, granite, slate, sandstone, terrazzo, jade, malachite, lapis lazuli, pebbles."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from diga3d_warp.materials.painting import band, cells, color, edge, grid, mix, noise, ramp, relief, scattered


def marble(rng: Generator, side: int) -> np.ndarray:
    """White marble with grey veins."""
    veins = np.exp(-np.abs(noise(rng, side, 1.7)) * 9)
    fine = np.exp(-np.abs(noise(rng, side, 1.5)) * 14)
    stone = mix("#cfccc6", "#efede8", 0.5 + 0.3 * noise(rng, side, 1.4))
    return mix(stone, "#4d5257", 0.85 * veins + 0.4 * fine)


def black_marble(rng: Generator, side: int) -> np.ndarray:
    """Black marble with thin white and ochre veins."""
    presence = np.clip(0.6 + 0.6 * noise(rng, side, 1.8), 0, 1)
    veins = np.exp(-np.abs(noise(rng, side, 1.7)) * 26) * presence
    fine = np.exp(-np.abs(noise(rng, side, 1.5)) * 30) * (1 - presence)
    stone = mix("#111214", "#2b2c30", 0.4 + 0.3 * noise(rng, side, 1.4))
    return mix(mix(stone, "#8a6a3a", 0.6 * fine), "#e9e5dc", veins)


def granite(rng: Generator, side: int) -> np.ndarray:
    """Interlocking grains of feldspar, quartz and mica."""
    points = rng.random((4200, 2))
    warp = 0.003 * np.stack([noise(rng, side, 1.0), noise(rng, side, 1.0)], -1)
    grains = cells(points, side, warp)
    kinds = np.stack([color(c) for c in ("#c9a596", "#d9d4cd", "#8f8c8a", "#2b2a2c", "#b98a7a")])
    kind = rng.choice(5, len(points), p=[0.30, 0.28, 0.20, 0.14, 0.08])
    tone = 0.86 + 0.28 * rng.random(len(points))
    return kinds[kind][grains.number] * (tone[grains.number] + 0.04 * noise(rng, side, 0.7))[..., None]


def slate(rng: Generator, side: int) -> np.ndarray:
    """Dark cleft stone in layers."""
    layers = noise(rng, side, 1.6, (2, 1))
    steps = np.floor(layers * 3.5) / 3.5 + 0.25 * (layers * 3.5 % 1) ** 6
    fine = noise(rng, side, 1.0)
    stone = ramp(("#30363d", "#48515a", "#66707a"), 0.45 + 0.1 * steps + 0.1 * fine)
    return stone * relief(0.012 * steps + 0.0025 * fine, 0.6)[..., None]


def sandstone(rng: Generator, side: int) -> np.ndarray:
    """Warm layers of sand, bent a little."""
    _, v = grid(side)
    bend = 0.05 * noise(rng, side, 2.0)
    layers = np.interp(
        (v + bend) % 1, np.linspace(0, 1, 29), rng.random(28)[np.r_[np.arange(28), 0]], period=1
    )
    grains = noise(rng, side, 0.4)
    stone = ramp(("#a06b3f", "#c8955c", "#dfb987", "#edd6ae"), 0.15 + 0.7 * layers + 0.05 * grains)
    return stone * (1 + 0.05 * grains)[..., None]


def terrazzo(rng: Generator, side: int) -> np.ndarray:
    """Chips of coloured stone in pale cement."""
    points = scattered(rng, 17, 17, 1.1)
    warp = 0.006 * np.stack([noise(rng, side, 1.3), noise(rng, side, 1.3)], -1)
    chips = cells(points, side, warp)
    codes = ("#b5563f", "#3f5a5c", "#d8a24a", "#7d7f83", "#efe9df", "#2f3236")
    colors = np.stack([color(c) for c in codes])[rng.integers(0, 6, len(points))]
    gap = (0.004 + 0.014 * rng.random(len(points)))[chips.number]
    size = (0.012 + 0.018 * rng.random(len(points)))[chips.number]
    chip = np.minimum(edge(chips.border - gap, 0.003), edge(size - chips.center, 0.003))
    cement = color("#dcd6ca") + 0.018 * noise(rng, side, 0.8)[..., None]
    return mix(cement, colors[chips.number] * (1 + 0.05 * noise(rng, side, 1.0))[..., None], chip)


def jade(rng: Generator, side: int) -> np.ndarray:
    """Clouded green stone with pale threads."""
    clouds = 0.5 + 0.26 * noise(rng, side, 1.9)
    threads = np.exp(-np.abs(noise(rng, side, 1.6)) * 12)
    return mix(ramp(("#1f5a3c", "#3f8f63", "#86c69a", "#cfe9cf"), clouds), "#e3f1dc", 0.35 * threads)


def malachite(rng: Generator, side: int) -> np.ndarray:
    """Rings of dark and bright green."""
    height = noise(rng, side, 2.3)
    rings = 0.5 + 0.5 * np.sin(24 * height + 1.5 * np.sin(9 * height))
    return ramp(("#06382b", "#0f6a4c", "#2f9d70", "#8fd3ac"), 0.06 + 0.8 * rings)


def lapis(rng: Generator, side: int) -> np.ndarray:
    """Deep blue stone with clouds of white and specks of gold."""
    stone = ramp(("#0c1a4f", "#1b3a8f", "#2f5dbb"), 0.45 + 0.24 * noise(rng, side, 1.4))
    stone = mix(stone, "#b9c6de", 0.75 * np.clip(0.8 * noise(rng, side, 1.5) - 1.1, 0, 1))
    return mix(stone, "#e2b84c", edge(band(rng, side, 60) + 0.4 * noise(rng, side, 1.8) - 2.5, 0.4))


def pebbles(rng: Generator, side: int) -> np.ndarray:
    """Round stones of a river bed."""
    points = scattered(rng, 11, 11, 0.8)
    stones = cells(points, side, 0.006 * np.stack([noise(rng, side, 1.6), noise(rng, side, 1.6)], -1))
    dome = np.sqrt(np.clip(stones.border / 0.035, 0, 1))
    kinds = np.stack([color(c) for c in ("#8d8a84", "#b7a68e", "#6e6a66", "#c9c3b8", "#94725a", "#5c6266")])
    tone = kinds[rng.integers(0, 6, len(points))][stones.number]
    tone = tone * (1 + 0.07 * noise(rng, side, 0.9))[..., None]
    lit = relief(0.03 * dome, 0.5)
    return mix("#241f1a", tone * lit[..., None], edge(stones.border - 0.006, 0.006))
