"""The room: three walls, furniture, and what may stand in the middle of the rug.

The origin is the middle of the rug on the floor. The side towards the viewer and the top are open; cameras
stand inside and never see either.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.random import Generator

from diga3d_warp.scene.synthetic.scenery import Scenery
from diga3d_warp.scene.synthetic.solids import Surface, ball, box, joined, panel, revolved, smooth_profile

LEFT, RIGHT, FRONT, BACK, HEIGHT = -2.3, 2.3, -3.0, 1.7, 2.8
"""Walls and their height [m]: every camera of the arc stands inside and looks at wall or floor only."""

FLOOR_CELL = 0.04
"""Edge of a floor cell [m]: penumbras of the object are some cells wide; 0.08 m would show as facets."""


def room_scenery(seed: int) -> Scenery:
    """The room with a porcelain vase, a golden ball and a marble vase."""
    return Scenery(furnished_room(seed), vase(), golden_ball(), vase("marble"))


def furnished_room(seed: int) -> Surface:
    """The room with everything that stays. The seed moves and colours its small things."""
    rng = np.random.default_rng([seed, 1])
    shelf = bookshelf(rng).turned(90).moved((LEFT + 0.02, 0.55, 0.0))
    board = sideboard().moved((0.45, BACK - 0.02, 0.0))
    plant = potted_plant(rng).moved((-0.95 + 0.06 * rng.uniform(-1, 1), BACK - 0.45, 0.0))
    toy = ball(0.16, "beach ball").turned(50, "x").turned(rng.uniform(0, 360))
    return joined(
        [
            walls(),
            rug(),
            shelf,
            board,
            plant,
            side_table().moved((1.62, 0.35, 0.0)),
            toy.moved((1.05 + 0.08 * rng.uniform(-1, 1), 0.62, 0.16)),
            picture(0.95, 0.7).moved((0.45, BACK, 1.47)),
            picture(0.5, 0.62).turned(-90).moved((RIGHT, 0.45, 1.35)),
        ]
    )


def walls() -> Surface:
    """Floor, walls and skirting boards."""
    width, depth = RIGHT - LEFT, BACK - FRONT
    up = (0.0, 0.0, HEIGHT)
    skirting = 0.11
    return joined(
        [
            panel((LEFT, FRONT, 0), (width, 0, 0), (0, depth, 0), "planks", cell=FLOOR_CELL),
            panel((LEFT, BACK, 0), (width, 0, 0), up, "wallpaper"),
            panel((LEFT, FRONT, 0), (0, depth, 0), up, "bricks"),
            panel((RIGHT, BACK, 0), (0, -depth, 0), up, "plaster"),
            box((LEFT, BACK - 0.018, 0), (RIGHT, BACK, skirting), "painted wood"),
            box((LEFT, FRONT, 0), (LEFT + 0.018, BACK, skirting), "painted wood"),
            box((RIGHT - 0.018, FRONT, 0), (RIGHT, BACK, skirting), "painted wood"),
        ]
    )


def rug() -> Surface:
    """The rug under the object, 1.9 x 1.5 m."""
    top = panel((-0.95, -0.75, 0.012), (1.9, 0, 0), (0, 1.5, 0), "rug", cell=FLOOR_CELL, whole=True)
    edge = box((-0.95, -0.75, 0.0), (0.95, 0.75, 0.0118), "cloth", tint=(0.6, 0.5, 0.35), cell=0.1)
    return joined([edge, top])


def bookshelf(rng: Generator) -> Surface:
    """A shelf with books, its back at y = 0, facing -y, 1.4 m wide and 1.5 m high."""
    width, depth, thick = 1.4, 0.3, 0.03
    levels = (0.06, 0.42, 0.78, 1.14, 1.47)
    parts = [box((-width / 2, -0.02, 0.0), (width / 2, 0.0, 1.5), "oak")]
    for x in (-width / 2, -thick / 2, width / 2 - thick):
        parts.append(box((x, -depth, 0.0), (x + thick, -0.02, 1.5), "oak"))
    parts += [box((-width / 2, -depth, z), (width / 2, -0.02, z + thick), "oak") for z in levels]
    for level in levels[:-1]:
        for start, end in ((-width / 2 + thick, -thick / 2), (thick / 2, width / 2 - thick)):
            parts += books(rng, start, end - 0.18 * rng.random(), level + thick, depth)
    return joined(parts)


def books(rng: Generator, start: float, end: float, base: float, depth: float) -> list[Surface]:
    """A row of books between two x positions [m]."""
    row = []
    while start < end - 0.03:
        thickness, height = rng.uniform(0.025, 0.055), rng.uniform(0.19, 0.28)
        back = -depth + rng.uniform(0.02, 0.06)
        tint = SPINES[rng.integers(len(SPINES))] * rng.uniform(0.7, 1.2)
        row.append(
            box((start, back, base), (min(start + thickness, end), -0.05, base + height), "cloth", tint=tint)
        )
        start += thickness + 0.002
    return row


SPINES = np.array(
    [(0.55, 0.10, 0.08), (0.08, 0.16, 0.38), (0.10, 0.28, 0.16), (0.75, 0.55, 0.22), (0.70, 0.66, 0.56)]
    + [(0.30, 0.12, 0.25), (0.62, 0.30, 0.12), (0.12, 0.30, 0.35)]
)
"""Linear RGB of book spines."""


def sideboard() -> Surface:
    """A low cabinet with its back at y = 0 that faces -y, 1.5 m wide, with things on it."""
    parts = [
        box((-0.75, -0.42, 0.14), (0.75, 0.0, 0.66), "walnut"),
        box((-0.78, -0.45, 0.66), (0.78, 0.0, 0.69), "oak"),
    ]
    for x in (-0.70, 0.64):
        parts += [box((x, y, 0.0), (x + 0.06, y + 0.06, 0.14), "walnut") for y in (-0.40, -0.08)]
    for x in (-0.73, -0.235, 0.26):
        parts.append(box((x, -0.435, 0.17), (x + 0.47, -0.42, 0.63), "oak", tint=(0.75, 0.62, 0.5)))
        knob = ball(0.018, "painted wood", segments=12)
        parts.append(knob.moved((x + 0.235, -0.45, 0.52)))
    jug = [(0.0, 0.0), (0.07, 0.0), (0.07, 0.0), (0.10, 0.08), (0.09, 0.16), (0.05, 0.22), (0.065, 0.28)]
    parts.append(revolved(jug, "painted wood", tint=(0.25, 0.5, 0.55), segments=24).moved((-0.5, -0.2, 0.69)))
    bowl = [(0.0, 0.0), (0.05, 0.0), (0.12, 0.05), (0.16, 0.11), (0.15, 0.11), (0.11, 0.06), (0.0, 0.03)]
    parts.append(revolved(bowl, "terracotta", repeats=(2, 1), segments=24).moved((0.42, -0.22, 0.69)))
    return joined(parts)


def potted_plant(rng: Generator) -> Surface:
    """A pot with long leaves that bend outwards, about 1.1 m high."""
    pot = [(0.0, 0.0), (0.13, 0.0), (0.13, 0.0), (0.19, 0.30), (0.19, 0.30), (0.215, 0.30), (0.215, 0.30)]
    pot += [(0.215, 0.36), (0.215, 0.36), (0.185, 0.36), (0.185, 0.36), (0.18, 0.31), (0.0, 0.31)]
    parts = [revolved(pot, "terracotta", repeats=(3, 1))]
    for number in range(26):
        leaf = ball(1.0, "leaf", repeats=(1, 2), segments=10)
        length, width = rng.uniform(0.22, 0.36), rng.uniform(0.05, 0.075)
        flat = leaf.stretched((width, 0.006, length)).moved((0.0, 0.0, length * 0.9))
        tilt = 8 + 68 * ((number + 0.5) / 26) ** 0.8
        height = 0.30 + 0.30 * (1 - tilt / 90)
        parts.append(flat.turned(tilt, "x").turned(number * 137.5).moved((0.0, 0.0, height)))
    stem = [(0.012, 0.30), (0.010, 0.75)]
    return joined([*parts, revolved(stem, "leaf", tint=(0.7, 0.6, 0.5), segments=8)])


def side_table() -> Surface:
    """A round table with a lamp on it."""
    top = [(0.0, 0.50), (0.27, 0.50), (0.27, 0.50), (0.28, 0.515), (0.27, 0.53), (0.27, 0.53), (0.0, 0.53)]
    leg = [(0.20, 0.0), (0.20, 0.02), (0.20, 0.02), (0.035, 0.05), (0.03, 0.28), (0.035, 0.50)]
    foot = [(0.0, 0.53), (0.09, 0.53), (0.09, 0.53), (0.10, 0.60), (0.03, 0.66), (0.025, 0.78)]
    shade = [(0.19, 0.74), (0.115, 1.02), (0.115, 1.02), (0.0, 1.02)]
    return joined(
        [
            revolved(top, "walnut", repeats=(2, 1)),
            revolved(leg, "walnut", repeats=(1, 1), segments=24),
            revolved(foot, "porcelain", repeats=(4, 0.3), segments=24),
            revolved(shade, "cloth", tint=(1.0, 0.86, 0.6), repeats=(4, 1)),
        ]
    )


def picture(width: float, height: float) -> Surface:
    """A framed landscape with its back at y = 0 that faces -y, centred at the origin."""
    x, z, frame = width / 2, height / 2, 0.05
    top_left = (-x + frame, -0.012, z - frame)
    down, right = (0.0, 0.0, 2 * frame - height), (width - 2 * frame, 0.0, 0.0)
    canvas = panel(top_left, down, right, "picture", whole=True)
    canvas = replace(canvas, uvs=canvas.uvs[:, ::-1])
    bars = [
        box((-x, -0.03, z - frame), (x, 0.0, z), "walnut"),
        box((-x, -0.03, -z), (x, 0.0, -z + frame), "walnut"),
        box((-x, -0.03, -z + frame), (-x + frame, 0.0, z - frame), "walnut"),
        box((x - frame, -0.03, -z + frame), (x, 0.0, z - frame), "walnut"),
    ]
    return joined([canvas, *bars])


RUG_TOP = 0.012
"""Height at which the object stands [m]."""


def vase(material: str = "porcelain") -> Surface:
    """The object: a floor vase with two handles, 0.74 m high."""
    outer = smooth_profile(
        [(0.12, 0.0), (0.135, 0.02), (0.215, 0.22), (0.235, 0.36), (0.16, 0.53), (0.09, 0.61), (0.12, 0.73)],
        40,
    )
    lip = [(0.12, 0.73), (0.125, 0.74), (0.115, 0.735), (0.08, 0.61), (0.0, 0.55)]
    around = 8.0 if material == "porcelain" else 2.0
    body = revolved(outer + lip, material, repeats=(around, 1.0))
    angle = np.linspace(0, 2 * np.pi, 13)
    ring = [(0.085 + 0.02 * float(np.cos(a)), 0.02 * float(np.sin(a))) for a in angle]
    tint = (0.16, 0.28, 0.6) if material == "porcelain" else (1.0, 1.0, 1.0)
    handle = revolved(ring, material, tint=tint, repeats=(4.0, 0.1), segments=28).turned(90, "x")
    handles = [handle.moved((side * 0.15, 0.0, 0.575)) for side in (-1, 1)]
    return joined([body, *handles]).turned(20).stretched((1.2, 1.2, 1.2)).moved((0.0, 0.0, RUG_TOP))


def golden_ball() -> Surface:
    """The other object: a sphere of 0.6 m, its poles turned out of the cameras' sight."""
    return ball(0.30, "gold", repeats=(3.0, 1.5)).turned(-35, "x").moved((0.0, 0.0, 0.30 + RUG_TOP))
