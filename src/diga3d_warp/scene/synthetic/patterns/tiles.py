"""Floors and walls of tiles: squares, checks, hexagons, running bond; each tile with a tone of its own."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.random import Generator

from diga3d_warp.materials.painting import cells, color, edge, grid, mix, noise

Painter = Callable[[Generator, int], np.ndarray]

GROUT = {"light": "#cbc6bb", "dark": "#57534d"}
"""Colour of the joints."""


def squares(
    count: int, glaze: str, other: str | None = None, grout: str = "light", joint: float = 0.02
) -> Painter:
    """Square tiles, `count` a repeat; every second one in another glaze, as on a chessboard, if it is given.

    Args:
        count: Tiles along an edge of the texture; even for two glazes.
        glaze, other: Colours.
        grout: A key of `GROUT`.
        joint: Half the width of a joint [tiles].
    """

    def painter(rng: Generator, side: int) -> np.ndarray:
        u, v = grid(side)
        column, row = (u * count).astype(int), (v * count).astype(int)
        floor = mix(glaze, other or glaze, (column + row) % 2)
        inward = 0.5 - np.maximum(np.abs(u * count % 1 - 0.5), np.abs(v * count % 1 - 0.5))
        return _laid(rng, side, floor, row * count + column, inward - joint, 0.02, grout)

    return painter


def bond(rows: int, columns: int, glaze: str, grout: str = "light") -> Painter:
    """Oblong tiles in running bond, `rows` by `columns` a repeat, `rows` even."""

    def painter(rng: Generator, side: int) -> np.ndarray:
        u, v = grid(side)
        row = (v * rows).astype(int)
        along = (u * columns + 0.5 * (row % 2)) % columns
        across = 0.5 - np.abs(v * rows % 1 - 0.5)
        inward = np.minimum(across, (0.5 - np.abs(along % 1 - 0.5)) * rows / columns)
        floor = np.broadcast_to(color(glaze), (side, side, 3))
        return _laid(rng, side, floor, row * columns + along.astype(int), inward - 0.035, 0.03, grout)

    return painter


def hexagons(glaze: str, accent: str, grout: str = "light") -> Painter:
    """Hexagonal tiles, 7 by 8 a repeat; some in the accent's colour."""

    def painter(rng: Generator, side: int) -> np.ndarray:
        columns, rows = 7, 8
        row = np.repeat(np.arange(rows), columns)
        points = np.stack(
            [(np.tile(np.arange(columns), rows) + 0.5 * (row % 2) + 0.25) / columns, (row + 0.5) / rows], -1
        )
        mosaic = cells(points, side)
        accented = rng.random(len(points)) < 0.2
        floor = mix(glaze, accent, accented[mosaic.number])
        return _laid(rng, side, floor, mosaic.number, mosaic.border - 0.0035, 0.004, grout)

    return painter


def _laid(
    rng: Generator,
    side: int,
    floor: np.ndarray,
    number: np.ndarray,
    inward: np.ndarray,
    soft: float,
    grout: str,
) -> np.ndarray:
    """Tiles in their bed: a tone for each number, clouds in the glaze, joints where `inward` is negative."""
    tone = 1 + 0.05 * rng.standard_normal(number.max() + 1)[number] + 0.025 * noise(rng, side, 1.3)
    bed = color(GROUT[grout]) * (1 + 0.06 * noise(rng, side, 0.8))[..., None]
    return mix(bed, floor * tone[..., None], edge(inward, soft))
