"""Something stands on a board of a bookshelf, before books and the shelf's back."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.random import Generator

from diga3d_warp.materials import wood
from diga3d_warp.scene.synthetic.materials import Material
from diga3d_warp.scene.synthetic.orbit import Orbit
from diga3d_warp.scene.synthetic.patterns import walls
from diga3d_warp.scene.synthetic.room import SPINES
from diga3d_warp.scene.synthetic.situations.light import lamplight
from diga3d_warp.scene.synthetic.situations.situation import Situation, distance_to_cover
from diga3d_warp.scene.synthetic.situations.surfaces import FLOORS, PAPERS, TABLE_CELL, pick, terrain, wall
from diga3d_warp.scene.synthetic.situations.things import SMALL, some_things, with_article
from diga3d_warp.scene.synthetic.solids import Surface, box, joined

ROOM = 6.0
"""How far wall and floor reach to either side [m]: beyond the edges of every view."""

THICK = 0.028
"""Of a board [m]."""

WOODS: Sequence[tuple[str, Material]] = (
    ("oak", Material("oak", 0.8, 256, wood.oak)),
    ("walnut", Material("walnut", 0.8, 256, wood.walnut)),
    ("white", Material("white paint", 0.8, 128, walls.painted("#e4e1d8"))),
    ("green", Material("green paint", 0.8, 128, walls.painted("#7f947f"))),
    ("bamboo", Material("bamboo", 0.4, 256, wood.bamboo)),
)
"""What shelves are made of, by what a caption says of them."""


def build(rng: Generator) -> Situation:
    things = some_things(rng, SMALL, (0.17, 0.26))
    x, y, height = (float(value) for value in things[0].size)
    distance = distance_to_cover(things[0], rng.uniform(0.08, 0.12), 58.0)
    words, stuff = pick(rng, WOODS)
    paper_words, paper = pick(rng, PAPERS)
    space = max(0.34, height + rng.uniform(0.06, 0.12))
    depth_of_books = 0.2
    front = -max(y, x) / 2 - rng.uniform(
        0.02, 0.05
    )  # the boards' front edge; the object stands before the books
    back = -front + depth_of_books + 0.03
    width = rng.uniform(0.9, 1.3)
    left = -width * rng.uniform(0.3, 0.7)
    case = bookcase(rng, stuff, (left, left + width), (front, back), space, depth_of_books)
    low = -2 * (space + THICK) - THICK - 0.08  # the floor, under the lowest board
    _, floor = pick(rng, FLOORS)
    parts = [case, wall(2 * ROOM, 3.0, paper).moved((0.0, back + 0.03, low))]
    parts.append(terrain((-ROOM, -ROOM, ROOM, back + 0.03), floor).moved((0.0, 0.0, low)))
    orbit = Orbit(
        target=(0.0, 0.0, 0.5 * height),
        distance=distance,
        elevation=(2.0, 20.0),
        half_angle=rng.uniform(24, 34),
    )
    place = f"{with_article(words)} bookshelf with books, {paper_words} behind"
    light = lamplight(rng, azimuth=(-60.0, 60.0), farthest=2.4)
    return Situation.of(things, joined(parts), place, orbit, light)


def bookcase(
    rng: Generator,
    stuff: Material,
    across: tuple[float, float],
    along: tuple[float, float],
    space: float,
    depth: float,
) -> Surface:
    """Boards with books, three below the object's and two above; the top of the object's board is z = 0.

    Args:
        rng: Picks the books.
        stuff: Material of the boards.
        across: x of the sides [m].
        along: y of the boards' front and back [m].
        space: Clear height between two boards [m].
        depth: Of the books [m], which stand at the back.
    """
    (left, right), (front, back) = across, along
    step = space + THICK
    bottom, top = -2 * step - THICK, 2 * step
    parts = [
        box((left - THICK, front, bottom), (left, back, top), stuff, cell=0.05),
        box((right, front, bottom), (right + THICK, back, top), stuff, cell=0.05),
        box((left, back, bottom), (right, back + 0.02, top), stuff, cell=0.05),
    ]
    for level in range(-2, 3):
        cell = TABLE_CELL if level == 0 else 0.06
        parts.append(box((left, front, level * step - THICK), (right, back, level * step), stuff, cell=cell))
        if level < 2:
            parts.append(row_of_books(rng, (left, right), back, level * step, space, depth))
    return joined(parts)


def row_of_books(
    rng: Generator, across: tuple[float, float], back: float, base: float, space: float, depth: float
) -> Surface:
    """Books side by side with a band on each spine, and gaps where some are missing."""
    row, start = [], across[0] + 0.005
    while start < across[1] - 0.06:
        if rng.random() < 0.06:
            start += rng.uniform(0.05, 0.14)
            continue
        thickness, height = rng.uniform(0.022, 0.055), rng.uniform(0.62, 0.92) * space
        end = min(start + thickness, across[1] - 0.003)
        front = back - depth + rng.uniform(0.0, 0.03)
        tint = SPINES[rng.integers(len(SPINES))] * rng.uniform(0.7, 1.3)
        row.append(
            box((start, front, base), (end, back - 0.01, base + height), "cloth", tint=tint, cell=0.06)
        )
        band = base + rng.uniform(0.55, 0.85) * height
        gilt = np.array((0.95, 0.75, 0.35)) if rng.random() < 0.6 else np.array((0.9, 0.9, 0.85))
        row.append(box((start, front - 0.001, band), (end, front, band + 0.02), "cloth", tint=gilt, cell=0.1))
        start = end + 0.002
    return joined(row)
