"""Something large stands before the end of a park bench and hides it: nobody sees where the bench ends."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.random import Generator

from diga3d_warp.materials import nature, stone
from diga3d_warp.scene.synthetic.materials import Material
from diga3d_warp.scene.synthetic.orbit import Orbit
from diga3d_warp.scene.synthetic.patterns import ground, walls
from diga3d_warp.scene.synthetic.situations.light import sky_dome, sunlight
from diga3d_warp.scene.synthetic.situations.situation import Situation, distance_to_cover
from diga3d_warp.scene.synthetic.situations.surfaces import FENCES, PAVINGS, garden, pick, terrain
from diga3d_warp.scene.synthetic.situations.things import reach_back, some_things
from diga3d_warp.scene.synthetic.solids import Surface, box, joined

HIDING = ("parcel", "crate", "bucket")
"""Kinds that are wide enough to hide the end of a bench."""

GROUNDS: Sequence[tuple[str, Material]] = (
    *PAVINGS,
    ("gravel", Material("gravel", 0.7, 512, stone.pebbles)),
    ("a lawn", Material("lawn", 0.95, 512, ground.lawn(0.0, 12))),
    ("sand", Material("sand", 1.5, 512, nature.sand)),
)

PAINTS: Sequence[tuple[str, Material]] = (
    ("wooden", Material("slats", 0.8, 256, walls.boards(1, "#7d4d26", "#b98550", 0.0))),
    ("green", Material("green slats", 0.8, 256, walls.painted("#3f6b4a"))),
    ("white", Material("white slats", 0.8, 256, walls.painted("#deddd6"))),
    ("red", Material("red slats", 0.8, 256, walls.painted("#9a3b2f"))),
    ("grey", Material("grey slats", 0.8, 256, walls.boards(1, "#76716a", "#a8a399", 0.0))),
)
IRON = Material("iron", 0.5, 128, walls.painted("#3a3d40"))


def build(rng: Generator) -> Situation:
    things = some_things(rng, HIDING, (0.6, 0.8))
    x = float(things[0].size[0])
    distance = distance_to_cover(things[0], rng.uniform(0.1, 0.14), 62.0)
    half = distance + 2.2
    words, slats = pick(rng, PAINTS)
    ground_words, below = pick(rng, GROUNDS)
    fence_words, fence = pick(rng, FENCES)
    side = 1 if rng.random() < 0.5 else -1
    # Its hidden end lies behind the object's middle, the other in full view.
    bench = park_bench(rng.uniform(1.5, 1.9), slats, side)
    bench = bench.moved(
        (-side * rng.uniform(-0.1, 0.12) * x, reach_back(things) + rng.uniform(0.05, 0.12), 0.0)
    )
    parts = [terrain((-half, -half, half, half), below), garden(rng, half, fence, trees=4), bench]
    orbit = Orbit(
        target=(0.3 * side, 0.2, 0.35),
        distance=distance,
        elevation=(10.0, 30.0),
        half_angle=rng.uniform(20, 28),
        field_of_view=62.0,
    )
    place = f"a {words} park bench on {ground_words}, {fence_words} behind"
    light = sunlight(rng, azimuth=(-80.0, 80.0))
    return Situation.of(things, joined(parts), place, orbit, light, sky_dome(), stands="in front of")


def park_bench(length: float, slats: Material, side: int) -> Surface:
    """A bench of slats on iron legs that faces -y, its front at y = 0, from x = 0 towards `side`."""
    parts = []
    low, high = sorted((0.0, side * length))
    for number in range(4):
        y = 0.02 + 0.115 * number
        parts.append(box((low, y, 0.43), (high, y + 0.095, 0.46), slats, cell=0.05))
    for number in range(3):
        z, y = 0.56 + 0.13 * number, 0.47 + 0.03 * number
        parts.append(box((low, y, z), (high, y + 0.025, z + 0.1), slats, cell=0.05))
    for share in (0.1, 0.5, 0.9):
        x = low + share * (high - low)
        for y in (0.04, 0.44):
            parts.append(box((x - 0.025, y, 0.0), (x + 0.025, y + 0.04, 0.43), IRON))
        parts.append(box((x - 0.025, 0.02, 0.39), (x + 0.025, 0.5, 0.43), IRON))
        parts.append(box((x - 0.025, 0.52, 0.4), (x + 0.025, 0.56, 0.92), IRON))
    for x in (low + 0.06, high - 0.06):
        parts.append(box((x - 0.02, 0.05, 0.43), (x + 0.02, 0.09, 0.62), IRON))
        parts.append(box((x - 0.025, 0.04, 0.62), (x + 0.025, 0.56, 0.65), IRON))
    return joined(parts)
