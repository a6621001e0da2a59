"""Something stands near the edge of a table, with the ground far below behind the edge."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.random import Generator

from diga3d_warp.materials import soft, stone, wood
from diga3d_warp.scene.synthetic.materials import Material
from diga3d_warp.scene.synthetic.orbit import Orbit
from diga3d_warp.scene.synthetic.patterns import ground, walls
from diga3d_warp.scene.synthetic.situations.light import lamplight, sky_dome, sunlight
from diga3d_warp.scene.synthetic.situations.situation import Situation, distance_to_cover
from diga3d_warp.scene.synthetic.situations.surfaces import (
    FENCES,
    FLOORS,
    PAPERS,
    PAVINGS,
    TABLE_CELL,
    garden,
    living_room,
    pick,
    terrain,
)
from diga3d_warp.scene.synthetic.situations.things import SMALL, some_things
from diga3d_warp.scene.synthetic.solids import WHITE, Surface, box, joined, revolved, sheet

HEIGHT = 0.74
"""Of the table [m]."""

THICK = 0.035
"""Of its top [m]."""

TOPS: Sequence[tuple[str, Material]] = (
    ("planked", Material("table planks", 1.5, 512, walls.boards(12, "#8a5f34", "#c99a62", 0.03))),
    ("oak", Material("oak", 0.6, 512, wood.oak)),
    ("walnut", Material("walnut", 0.6, 512, wood.walnut)),
    ("marble", Material("table marble", 0.8, 512, stone.marble)),
    ("terrazzo", Material("terrazzo", 0.6, 512, stone.terrazzo)),
    ("tartan covered", Material("tartan", 0.35, 256, soft.tartan)),
    ("slatted", Material("slats", 1.1, 512, walls.boards(12, "#7a5230", "#b58654", 0.09))),
)
"""Table tops by what a caption says of them."""


LAWN = ("a lawn", Material("lawn", 0.95, 512, ground.lawn(0.0, 12)))


def build(rng: Generator) -> Situation:
    things = some_things(rng, SMALL, (0.2, 0.34))
    distance = distance_to_cover(things[0], rng.uniform(0.08, 0.12), 58.0)
    top_words, top = pick(rng, TOPS)
    shape = str(rng.choice(["rectangular", "round"]))
    radius = float(np.hypot(*things[0].size[:2])) / 2
    inset = radius + rng.uniform(0.02, 0.08)  # from the object's axis to the edge
    table = round_table(rng, top, inset) if shape == "round" else long_table(rng, top, inset)
    half = max(2.2, distance + 1.1)
    outdoors = bool(rng.random() < 0.5)
    if outdoors:
        below_words, below = pick(
            rng, [*PAVINGS, ("a lawn", Material("lawn", 2.2, 512, ground.lawn(0.0, 30)))]
        )
        fence_words, fence = pick(rng, FENCES)
        room, behind = garden(rng, half + 1.5, fence), f"{fence_words} behind"
        half += 1.5
    else:
        below_words, below = pick(rng, FLOORS)
        behind, paper = pick(rng, PAPERS)
        room, behind = living_room(rng, half, paper), f"{behind} behind"
    floor = terrain((-half, -half, half, half), below, fine=1.0)
    # The edge lies towards +y: cameras in front look over it, those all around also from beyond.
    surroundings = joined([joined([floor, room]).moved((0.0, 0.0, -HEIGHT)), table])
    around = bool(rng.random() < 0.5)
    orbit = Orbit(
        target=(0.0, 0.0, 0.3 * float(things[0].size[2])),
        distance=distance,
        elevation=(24.0, 44.0),
        middle=rng.uniform(-25, 25),
        half_angle=180.0 if around else rng.uniform(40, 55),
    )
    place = f"the edge of a {shape} {top_words} table over {below_words}, {behind}"
    light = sunlight(rng) if outdoors else lamplight(rng)
    return Situation.of(
        things, surroundings, place, orbit, light, sky_dome() if outdoors else None, stands="at"
    )


def long_table(rng: Generator, top: Material, inset: float) -> Surface:
    """A table whose long edge runs along x, `inset` metres behind the origin; its top at z = 0."""
    length, depth = rng.uniform(1.2, 1.8), rng.uniform(0.75, 1.0)
    left = -length * rng.uniform(0.25, 0.75)
    low, high = (left, inset - depth), (left + length, inset)
    board = terrain((*low, *high), top, fine=0.4, cell=TABLE_CELL)
    parts = [board, box((*low, -THICK), (*high, -0.001), top)]
    leg = 0.035
    for x in (low[0] + 0.08, high[0] - 0.08):
        for y in (low[1] + 0.08, high[1] - 0.08):
            parts.append(box((x - leg, y - leg, -HEIGHT), (x + leg, y + leg, -THICK), "walnut"))
    inside = (low[0] + 0.08, low[1] + 0.08), (high[0] - 0.08, high[1] - 0.08)
    frame = box((*inside[0], -THICK - 0.08), (*inside[1], -THICK), "walnut")
    return joined([*parts, frame]).turned(rng.uniform(-12, 12))


def round_table(rng: Generator, top: Material, inset: float) -> Surface:
    """A round table on one leg; its edge is `inset` metres behind the origin."""
    radius = rng.uniform(0.5, 0.75)
    around = float(max(1, round(2 * np.pi * radius / top.period)))
    edge = [(radius, -THICK), (1.01 * radius, -0.5 * THICK), (radius, 0.0)]
    rim = revolved(edge, top, repeats=(around, 0.1), segments=96)
    below = revolved([(0.0, -THICK), (radius, -THICK)], top, segments=64)
    leg = [(0.28, -HEIGHT), (0.28, 0.03 - HEIGHT), (0.28, 0.03 - HEIGHT)]
    leg += [(0.05, 0.1 - HEIGHT), (0.05, -THICK)]
    foot = revolved(leg, "walnut", repeats=(1.0, 1.0), segments=24)
    plate = disc(radius, top)
    return joined([plate, rim, below, foot]).moved((0.0, inset - radius, 0.0)).turned(rng.uniform(-12, 12))


def disc(radius: float, material: Material) -> Surface:
    """A flat disc about the origin that faces upwards: a square grid, bent into a circle."""
    places = np.linspace(-1.0, 1.0, int(np.ceil(2 * radius / TABLE_CELL)) + 1)
    u, v = np.meshgrid(places, places)
    x, y = radius * u * np.sqrt(1 - v**2 / 2), radius * v * np.sqrt(1 - u**2 / 2)
    flat, up = np.zeros_like(x), np.ones_like(x)
    vertices, normals = np.stack([x, y, flat], -1), np.stack([flat, flat, up], -1)
    return sheet(vertices, normals, vertices[..., :2] / material.period, material, WHITE)
