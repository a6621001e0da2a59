"""Metals as textures: their colour, dents, brushing and corrosion; what they mirror is added on an object."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from diga3d_warp.materials.painting import band, cells, mix, noise, ramp, relief, scattered


def gold(rng: Generator, side: int) -> np.ndarray:
    """Gold with cloudy tarnish, without relief."""
    hammered = 0.5 + 0.25 * noise(rng, side, 1.2)
    return mix("#a8741a", "#f0c75a", hammered)


def hammered(rng: Generator, side: int, shades: tuple[str, ...]) -> np.ndarray:
    """Sheet metal with wide, very shallow dents, its shades from dark to bright.

    Dents that stand out one by one look like scales or fruit peel from afar.
    """
    dents = cells(scattered(rng, 9, 9, 0.9), side)
    bowl = -np.exp(-((dents.center / 0.045) ** 2))
    lit = relief(0.0045 * bowl + 0.0003 * noise(rng, side, 1.6), 0.62)
    tone = 0.5 + 0.62 * (lit - 1) + 0.06 * noise(rng, side, 1.8)
    return ramp(shades, tone)


def hammered_gold(rng: Generator, side: int) -> np.ndarray:
    return hammered(rng, side, ("#5c3606", "#b07a18", "#e6b53c", "#ffe48a", "#fff7cf"))


def silver(rng: Generator, side: int) -> np.ndarray:
    return hammered(rng, side, ("#4b4f55", "#8e9399", "#c3c7ca", "#eef0f1", "#ffffff"))


def copper(rng: Generator, side: int) -> np.ndarray:
    return hammered(rng, side, ("#4a1d0d", "#94472a", "#c9744e", "#f0ae8b", "#ffe0cb"))


def bronze(rng: Generator, side: int) -> np.ndarray:
    """Cast bronze with green patina in its hollows."""
    cast = noise(rng, side, 1.5)
    metal = ramp(("#2a1a0c", "#54391c", "#86602f", "#b58b4e"), 0.5 + 0.2 * cast)
    patina = np.clip(0.75 * noise(rng, side, 1.3) - 0.5 * cast - 0.35, 0, 1)
    fine = noise(rng, side, 0.9)
    return (
        mix(metal, mix("#3f7f70", "#7fb5a2", 0.5 + 0.2 * fine), 0.85 * patina)
        * (relief(0.004 * cast + 0.001 * fine, 0.6)[..., None])
    )


def steel(rng: Generator, side: int) -> np.ndarray:
    """Steel brushed along u."""
    strokes = noise(rng, side, 0.7, (60, 1))
    sheen = noise(rng, side, 1.8, (6, 1))
    return ramp(("#5d6369", "#8d949a", "#b9bfc4", "#e3e7ea"), 0.5 + 0.13 * strokes + 0.09 * sheen)


def rust(rng: Generator, side: int) -> np.ndarray:
    """Corroded iron: flakes of old paint left between."""
    depth = 0.9 * noise(rng, side, 1.5) + 0.35 * noise(rng, side, 0.8)
    crust = ramp(
        ("#3a160a", "#6e2c10", "#a64d1c", "#cf7d34"), 0.48 + 0.2 * depth + 0.06 * band(rng, side, 60)
    )
    left = np.clip((noise(rng, side, 1.6) - 0.85) * 6, 0, 1)
    paint = mix("#53626a", "#71828a", 0.5 + 0.2 * noise(rng, side, 1.2))
    return mix(crust, paint, left) * relief(0.004 * left + 0.0025 * depth, 0.7)[..., None]
