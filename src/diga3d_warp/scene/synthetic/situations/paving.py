"""Something stands on the paving of a terrace before a house."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.random import Generator

from diga3d_warp.materials import masonry
from diga3d_warp.scene.synthetic.materials import Material
from diga3d_warp.scene.synthetic.orbit import Orbit
from diga3d_warp.scene.synthetic.patterns import walls
from diga3d_warp.scene.synthetic.room import potted_plant
from diga3d_warp.scene.synthetic.situations.light import sky_dome, sunlight
from diga3d_warp.scene.synthetic.situations.situation import Situation, distance_to_cover
from diga3d_warp.scene.synthetic.situations.surfaces import FENCES, PAVINGS, garden, pick, terrain, wall
from diga3d_warp.scene.synthetic.situations.things import LARGE, some_things, with_article
from diga3d_warp.scene.synthetic.solids import Surface, box, joined

HOUSES: Sequence[tuple[str, Material]] = (
    ("brick", Material("bricks", 0.96, 512, masonry.bricks)),
    ("white", Material("render", 1.6, 256, walls.painted("#dedbd0"))),
    ("ochre", Material("ochre render", 1.6, 256, walls.painted("#c79a55"))),
    ("timber", Material("timber", 1.2, 512, walls.boards(6, "#5c4430", "#8a6a4c", 0.04))),
)
"""Walls of the house, by what a caption says of it."""

PAINT = Material("house paint", 0.6, 128, walls.painted("#e6e4dc"))


def build(rng: Generator) -> Situation:
    things = some_things(rng, LARGE, (0.4, 0.75))
    distance = distance_to_cover(things[0], rng.uniform(0.08, 0.12), 58.0)
    half = distance + 2.0
    paving_words, paving = pick(rng, PAVINGS)
    house_words, front = pick(rng, HOUSES)
    _, fence = pick(rng, FENCES)
    near = distance + rng.uniform(0.8, 1.2)  # from the object to the house
    parts = [
        terrain((-half, -half, half, half), paving, turn=rng.uniform(0, 90)),
        garden(rng, half, fence, trees=2),
    ]
    parts.append(house(rng, 2 * half, front).moved((0.0, near, 0.0)))
    for x in rng.uniform(0.5, 0.9, 2) * (-1, 1):
        parts.append(potted_plant(rng).moved((float(x) * half, near - 0.4, 0.0)))
    around = bool(rng.random() < 0.5)
    orbit = Orbit(
        target=(0.0, 0.0, 0.35 * float(things[0].size[2])),
        distance=distance,
        elevation=(18.0, 40.0),
        half_angle=180.0 if around else rng.uniform(35, 50),
    )
    place = f"{paving_words} before {with_article(house_words)} house"
    light = sunlight(rng, azimuth=(-90.0, 90.0))
    return Situation.of(things, joined(parts), place, orbit, light, sky_dome())


def house(rng: Generator, width: float, front: Material) -> Surface:
    """The front of a house at y = 0 that faces -y, with a door and a window."""
    door, window = rng.permutation([-0.9, 0.7]) + rng.uniform(-0.2, 0.2, 2)
    tint = rng.uniform(0.1, 0.7, 3)
    return joined(
        [
            wall(width, 2.9, front, skirting=0.0),
            box((door - 0.5, -0.05, 0.0), (door + 0.5, 0.0, 2.1), PAINT),
            box((door - 0.42, -0.07, 0.02), (door + 0.42, -0.05, 2.02), "oak", tint=tint),
            box((window - 0.6, -0.06, 0.8), (window + 0.6, 0.0, 2.0), PAINT),
            box((window - 0.53, -0.065, 0.87), (window - 0.03, -0.06, 1.93), PAINT, tint=(0.12, 0.17, 0.2)),
            box((window + 0.03, -0.065, 0.87), (window + 0.53, -0.06, 1.93), PAINT, tint=(0.12, 0.17, 0.2)),
            box((-width / 2, -0.03, 0.0), (width / 2, 0.0, 0.2), "plaster", tint=(0.5, 0.5, 0.5), cell=0.2),
        ]
    )
