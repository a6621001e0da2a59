"""Ground, growth and weather: grass, moss, sand, snow, ice, lava, leaves."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from diga3d_warp.materials.painting import band, cells, edge, grid, mix, noise, ramp, relief, scattered


def leaf(rng: Generator, side: int) -> np.ndarray:
    """Green of a leaf with faint veins along u."""
    return mix("#2f5a2a", "#6b9a45", 0.5 + 0.28 * noise(rng, side, 1.1, (3, 1)))


def grass(rng: Generator, side: int) -> np.ndarray:
    """Blades of a lawn, each a short stroke."""
    lawn = ramp(("#15280c", "#27441a", "#3a5a24"), 0.5 + 0.2 * noise(rng, side, 1.4))
    for _ in range(5):
        lean = noise(rng, side, 1.9)
        blades = np.stack([band(rng, side, 40, (1, 6)), band(rng, side, 40, (1.2, 4))])
        blade = np.where(lean > 0, blades[0], np.roll(blades[1], side // 7, 1))
        tone = 0.5 + 0.16 * noise(rng, side, 1.2) + 0.12 * blade
        lawn = mix(lawn, ramp(("#2f5a1d", "#5c8f2f", "#9cc25a", "#d0dc8c"), tone), edge(blade - 0.75, 0.5))
    return lawn


def moss(rng: Generator, side: int) -> np.ndarray:
    """Soft cushions of moss."""
    cushions = cells(scattered(rng, 9, 9, 1.2), side, 0.02 * np.stack([noise(rng, side, 1.4)] * 2, -1))
    dome = np.sqrt(np.clip(cushions.border / 0.05, 0, 1))
    tufts = 0.6 * band(rng, side, 48) + 0.6 * noise(rng, side, 0.9)
    green = ramp(("#172a0c", "#365220", "#5d8030", "#9ab652"), 0.22 + 0.4 * dome + 0.13 * tufts)
    return green * relief(0.012 * dome + 0.002 * tufts, 0.5)[..., None]


def sand(rng: Generator, side: int) -> np.ndarray:
    """Ripples of a beach."""
    _, v = grid(side)
    bend = 0.035 * noise(rng, side, 2.0)
    ripples = np.sin(2 * np.pi * 11 * (v + bend))
    grains = noise(rng, side, 0.3)
    ground = ramp(("#b08c5a", "#d3b280", "#eed7ab"), 0.5 + 0.14 * noise(rng, side, 1.6) + 0.08 * grains)
    return ground * relief(0.006 * ripples + 0.0006 * grains, 0.42)[..., None]


def snow(rng: Generator, side: int) -> np.ndarray:
    """Packed snow with bluish hollows."""
    drifts = noise(rng, side, 2.0)
    grains = noise(rng, side, 0.6)
    ground = ramp(("#b9cbe2", "#e4ecf5", "#fdfeff"), 0.62 + 0.18 * drifts + 0.05 * grains)
    return ground * relief(0.006 * drifts + 0.0008 * grains, 0.6)[..., None]


def ice(rng: Generator, side: int) -> np.ndarray:
    """Clear blue ice with white cracks."""
    body = ramp(("#3f87ae", "#7fbcd8", "#bfe2ef"), 0.5 + 0.22 * noise(rng, side, 1.8))
    shards = cells(rng.random((26, 2)), side, 0.015 * np.stack([noise(rng, side, 1.6)] * 2, -1))
    cracks = np.exp(-shards.border / 0.004) + 0.5 * np.exp(-np.abs(noise(rng, side, 1.6)) * 22)
    tone = (0.9 + 0.2 * rng.random(26))[shards.number]
    frost = np.clip(0.5 * noise(rng, side, 1.2) - 0.4, 0, 1)
    return mix(body * tone[..., None], "#f6fcff", 0.8 * cracks + 0.5 * frost)


def lava(rng: Generator, side: int) -> np.ndarray:
    """Black crust over glowing rock."""
    plates = cells(
        scattered(rng, 7, 7, 1.1), side, 0.03 * np.stack([noise(rng, side, 1.5), noise(rng, side, 1.5)], -1)
    )
    heat = np.exp(-plates.border / 0.011) * (0.75 + 0.25 * noise(rng, side, 1.5))
    rough = noise(rng, side, 1.1)
    crust = ramp(("#0e0b0a", "#241d1a", "#463a34"), 0.4 + 0.2 * rough) * relief(0.005 * rough, 0.7)[..., None]
    glow = ramp(("#3d0a02", "#b92805", "#ff7a12", "#ffd75e"), heat)
    return mix(crust, glow, edge(heat - 0.25, 0.3))
