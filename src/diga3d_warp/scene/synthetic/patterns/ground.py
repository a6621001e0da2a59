"""Ground outdoors: lawns, and paving of irregular stones, slabs and bricks."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.random import Generator

from diga3d_warp.materials.nature import grass
from diga3d_warp.materials.painting import cells, color, edge, grid, mix, noise, ramp, scattered

Painter = Callable[[Generator, int], np.ndarray]

GREEN = color("#57803a")
"""Mean of a lawn seen from some metres."""


def lawn(mown: float, flowers: int) -> Painter:
    """Grass that was mown in lanes.

    Args:
        mown: Contrast of the lanes, 0 for none.
        flowers: Daisies a repeat.
    """

    def painter(rng: Generator, side: int) -> np.ndarray:
        u, _ = grid(side)
        lanes = np.clip(4 * np.sin(2 * np.pi * u), -1, 1)
        green = 0.35 * GREEN + 0.65 * grass(rng, side)  # softer than blades seen from near
        green = green * (1 + 0.09 * noise(rng, side, 1.6) + mown * lanes)[..., None]
        if flowers:
            daisies = cells(rng.random((max(flowers, 2), 2)), side)
            green = mix(green, "#eeeee6", edge(0.006 - daisies.center, 0.003))
            green = mix(green, "#d9b23a", edge(0.0025 - daisies.center, 0.002))
        return green

    return painter


def flagstones(shades: Sequence[str], joint: str, count: int = 6) -> Painter:
    """Irregular flat stones, `count` by `count` a repeat, in colours between the shades."""

    def painter(rng: Generator, side: int) -> np.ndarray:
        bend = 0.008 * np.stack([noise(rng, side, 1.6), noise(rng, side, 1.6)], -1)
        stones = cells(scattered(rng, count, count, 0.95), side, bend)
        tone = rng.random(count * count)[stones.number]
        rough = 0.06 * noise(rng, side, 1.2) + 0.05 * noise(rng, side, 0.7)
        stone = ramp(tuple(shades), tone + 0.8 * rough)
        bed = color(joint) * (1 + 0.12 * noise(rng, side, 0.8))[..., None]
        return mix(bed, stone, edge(stones.border - 0.07 / count, 0.03 / count))

    return painter


def slabs(shades: Sequence[str], joint: str) -> Painter:
    """Rectangular slabs of four sizes, fitted together in a block of 6 by 6 that repeats."""
    block = np.array(
        [
            [0, 0, 1, 1, 1, 2],
            [0, 0, 1, 1, 1, 2],
            [3, 4, 4, 5, 5, 2],
            [3, 4, 4, 5, 5, 6],
            [3, 7, 8, 8, 8, 6],
            [9, 9, 8, 8, 8, 6],
        ]
    )

    def painter(rng: Generator, side: int) -> np.ndarray:
        u, v = grid(side)
        repeats = 2
        x, y = u * repeats * 6 % 6, v * repeats * 6 % 6
        number = block[y.astype(int), x.astype(int)]
        of_block = (v * repeats).astype(int) * repeats + (u * repeats).astype(int)
        inward = np.full((side, side), np.inf)
        for axis, place in ((0, y), (1, x)):
            for step in (-1, 1):
                rim = np.roll(block, -step, axis)[y.astype(int), x.astype(int)] != number
                distance = place % 1 if step < 0 else 1 - place % 1
                inward = np.where(rim, np.minimum(inward, distance), inward)
        tone = rng.random(10 * repeats**2)[of_block * 10 + number]
        stone = ramp(tuple(shades), tone + 0.07 * noise(rng, side, 1.2))
        bed = color(joint) * (1 + 0.12 * noise(rng, side, 0.8))[..., None]
        return mix(bed, stone, edge(inward - 0.05, 0.04))

    return painter


def herringbone(shades: Sequence[str], joint: str) -> Painter:
    """Bricks of 1 by 2 in herringbone, 8 by 8 units a repeat."""
    units = 8

    def painter(rng: Generator, side: int) -> np.ndarray:
        u, v = grid(side)
        column, row = (u * units).astype(int), (v * units).astype(int)
        kind = (
            column - row
        ) % 4  # 0 and 1: left and right end of a lying brick; 3 and 2: upper and lower of a standing
        start_column = np.where(kind == 1, column - 1, column)
        start_row = np.where(kind == 2, row - 1, row)
        lying = kind < 2
        x = u * units - start_column
        y = v * units - start_row
        inward = np.where(
            lying,
            np.minimum(np.minimum(x, 2 - x), np.minimum(y, 1 - y)),
            np.minimum(np.minimum(x, 1 - x), np.minimum(y, 2 - y)),
        )
        number = (start_row % units) * units + start_column % units
        tone = rng.random(units * units)[number]
        brick = ramp(tuple(shades), tone + 0.08 * noise(rng, side, 1.1))
        bed = color(joint) * (1 + 0.1 * noise(rng, side, 0.8))[..., None]
        return mix(bed, brick, edge(inward - 0.05, 0.05))

    return painter
