"""Wood and what grows: grain, boards, bark, cork, bamboo, wicker."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from diga3d_warp.materials.painting import band, cells, edge, grid, mix, noise, ramp, relief, scattered


def grain(rng: Generator, side: int, dark: str, light: str) -> np.ndarray:
    """Wood with its fibres along u."""
    rings = noise(rng, side, 1.8, (9, 1))
    fibre = noise(rng, side, 0.9, (24, 1))
    pores = np.clip(noise(rng, side, 0.6, (16, 1)) - 1.6, 0, 1)
    share = 0.5 + 0.22 * np.sin(7 * rings) + 0.16 * fibre
    return mix(dark, light, share) * (1 - 0.35 * pores)[..., None]


def oak(rng: Generator, side: int) -> np.ndarray:
    return grain(rng, side, "#8a5f34", "#c99a62")


def walnut(rng: Generator, side: int) -> np.ndarray:
    return grain(rng, side, "#3d2415", "#7a4f30")


def planks(rng: Generator, side: int) -> np.ndarray:
    """Boards along u, 16 side by side."""
    u, v = grid(side)
    rows, joints = 16, 2
    row = (v * rows).astype(int)
    along = (u * joints + rng.random(rows)[row]) % joints
    plank = row * joints + along.astype(int)
    wood = grain(rng, side, "#7d4d26", "#c08a50")
    shift = rng.integers(0, side, rows * joints)[plank]
    texel_u = ((u * side).astype(int) + shift) % side
    wood = wood[(v * side).astype(int), texel_u]
    wood = wood * (0.78 + 0.4 * rng.random(rows * joints)[plank])[..., None]
    across = np.abs(v * rows % 1 - 0.5) * 0.16  # [m] from the middle of a plank
    lengthwise = np.abs(along % 1 - 0.5) * 1.28
    gap = np.minimum(0.08 - across, 0.64 - lengthwise)
    return wood * (0.35 + 0.65 * edge(gap - 0.003, 0.004))[..., None]


def bamboo(rng: Generator, side: int) -> np.ndarray:
    """Canes along v with a knot each."""
    u, v = grid(side)
    canes = 8
    cane = (u * canes).astype(int)
    across = u * canes % 1 - 0.5
    from_knot = np.abs((v + rng.random(canes)[cane] + 0.5) % 1 - 0.5)
    fibre = noise(rng, side, 0.9, (1, 24))
    tint = rng.random(canes)[cane]
    wood = ramp(("#a8863f", "#cdb266", "#dfcb8b"), 0.35 + 0.3 * tint + 0.12 * fibre)
    wood = mix(wood, "#7c6228", 0.8 * np.exp(-((from_knot / 0.008) ** 2)))
    wood = mix(wood, "#ece0b0", 0.7 * np.exp(-(((from_knot - 0.022) / 0.01) ** 2)))
    round_shade = np.sqrt(np.clip(1 - (2.02 * across) ** 2, 0.02, 1))
    return wood * (0.25 + 0.75 * round_shade)[..., None]


def bark(rng: Generator, side: int) -> np.ndarray:
    """Plates of bark with deep furrows along v."""
    points = scattered(rng, 6, 11)
    warp = np.stack([0.02 * noise(rng, side, 1.3, (1, 2)), 0.03 * noise(rng, side, 1.3)], -1)
    plates = cells(points, side, warp)
    plate = edge(plates.border - 0.012, 0.022)
    rough = noise(rng, side, 1.0, (1, 4))
    height = 0.02 * plate + 0.005 * rough
    tone = 0.45 + 0.18 * rough + 0.25 * (rng.random(len(points))[plates.number] - 0.5)
    wood = mix("#2a1c12", ramp(("#4b3524", "#7a5c41", "#a98b6b"), tone), plate)
    return wood * relief(height, 0.55)[..., None]


def cork(rng: Generator, side: int) -> np.ndarray:
    """Pressed grains of cork with dark pores."""
    points = scattered(rng, 34, 34, 1.2)
    grains = cells(points, side)
    tone = 0.5 + 0.5 * (rng.random(len(points))[grains.number] - 0.5) + 0.12 * noise(rng, side, 1.2)
    stuff = ramp(("#9a6b3d", "#c1905c", "#dbb384"), tone)
    stuff = mix(stuff, "#6f4826", 0.5 * edge(0.0022 - grains.border, 0.003))
    return mix(stuff, "#4a2d17", edge(band(rng, side, 26, (0.6, 1)) - 2.0, 0.5))


def wicker(rng: Generator, side: int) -> np.ndarray:
    """Willow woven over upright stakes."""
    u, v = grid(side)
    stakes, rows = 10, 28
    row = (v * rows).astype(int)
    over = np.cos(np.pi * (u * stakes + row))
    round_rod = np.sqrt(np.clip(1 - (2 * (v * rows % 1 - 0.5)) ** 2, 0.01, 1))
    light = (0.30 + 0.70 * round_rod) * (0.66 + 0.34 * over)
    fibre = noise(rng, side, 1.0, (10, 1))
    tint = rng.random(rows)[row]
    rod = ramp(("#8a5f30", "#b98a4e", "#dbb67c"), 0.45 + 0.35 * (tint - 0.5) + 0.12 * fibre)
    return rod * np.clip(light, 0.12, 1)[..., None]
