"""Something stands before a curved surface: a thick column, or the hollow of a round wall."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.random import Generator

from diga3d_warp.materials import crafted, masonry, stone
from diga3d_warp.scene.synthetic.materials import Material
from diga3d_warp.scene.synthetic.orbit import Orbit
from diga3d_warp.scene.synthetic.patterns import ground, tiles, walls
from diga3d_warp.scene.synthetic.situations.light import lamplight
from diga3d_warp.scene.synthetic.situations.situation import Situation, distance_to_cover
from diga3d_warp.scene.synthetic.situations.surfaces import FLOORS, PAPERS, living_room, pick, terrain
from diga3d_warp.scene.synthetic.situations.things import LARGE, reach_back, some_things
from diga3d_warp.scene.synthetic.solids import WHITE, Surface, joined, revolved, sheet

COATS: Sequence[tuple[str, Material]] = (
    ("brick", Material("bricks", 0.96, 512, masonry.bricks)),
    ("mosaic", Material("mosaic", 0.6, 512, masonry.mosaic)),
    ("blue tiled", Material("column tiles", 0.8, 512, tiles.squares(8, "#d9dfe2", "#4f7da3"))),
    ("green tiled", Material("green tiles", 0.8, 512, tiles.bond(12, 6, "#7fa58c", "dark"))),
    ("striped", Material("stripes", 0.7, 256, walls.striped_paper("#e0d8c6", "#a3463c", 4))),
    ("marble", Material("column marble", 0.9, 512, stone.marble)),
    ("checkered", Material("checks", 0.9, 256, crafted.checkerboard)),
)
"""What curved surfaces are covered with, by what a caption says of them."""

STONE_FLOORS: Sequence[tuple[str, Material]] = (
    *FLOORS,
    (
        "sandstone slabs",
        Material("slabs", 2.2, 1024, ground.slabs(("#b59a76", "#cdb795", "#dccbad"), "#7d705d")),
    ),
    ("grey tiles", Material("hall tiles", 1.6, 512, tiles.squares(5, "#a6a7a4", "#8d8f8e"))),
)
TALL = 2.7
"""Of column and wall [m]."""


def build(rng: Generator) -> Situation:
    things = some_things(rng, LARGE, (0.4, 0.75))
    distance = distance_to_cover(things[0], rng.uniform(0.09, 0.13), 58.0)
    reach = reach_back(things)
    floor_words, floor = pick(rng, STONE_FLOORS)
    coat_words, coat = pick(rng, COATS)
    half = distance + 1.1
    if rng.random() < 0.6:
        radius = rng.uniform(0.35, 0.6)
        curve = drum(radius, coat).moved((0.0, radius + reach + rng.uniform(0.03, 0.2), 0.0))
        shape, half_angle = "column", rng.uniform(35, 48)
        _, paper = pick(rng, PAPERS)
        behind = living_room(rng, max(half, 2 * radius + reach + 1.3), paper)
        half = max(half, 2 * radius + reach + 1.3)
    else:
        radius = rng.uniform(1.3, 2.0)
        gap = reach + rng.uniform(0.05, 0.3)
        curve = hollow(radius, coat).moved((0.0, gap - radius, 0.0))
        shape, half_angle = "round wall", rng.uniform(22, 30)
        _, paper = pick(rng, PAPERS)
        half = max(half, radius + 0.4)
        behind = living_room(rng, half, paper)
    parts = [terrain((-half, -half, half, half), floor), behind, curve]
    orbit = Orbit(
        target=(0.0, 0.0, 0.45 * float(things[0].size[2])),
        distance=distance,
        elevation=(10.0, 32.0),
        middle=rng.uniform(-8, 8),
        half_angle=half_angle,
    )
    place = f"a {coat_words} {shape} on {floor_words}"
    light = lamplight(rng, azimuth=(-75.0, 75.0), farthest=1.6)
    return Situation.of(things, joined(parts), place, orbit, light, stands="in front of")


def drum(radius: float, coat: Material) -> Surface:
    """A column about the z axis with a base."""
    around = float(max(1, round(2 * np.pi * radius / coat.period)))
    profile = [(radius, float(z)) for z in np.linspace(0, TALL, 36)]
    shaft = revolved(profile, coat, repeats=(around, TALL / coat.period), segments=72)
    base = [(1.08 * radius, 0.0), (1.08 * radius, 0.08), (1.08 * radius, 0.08), (1.0 * radius, 0.12)]
    foot = revolved(base, "marble", tint=(0.6, 0.58, 0.55), repeats=(4.0, 0.2), segments=72)
    return joined([shaft, foot])


def hollow(radius: float, coat: Material) -> Surface:
    """The half of a round wall that lies towards +y, seen from inside, with a plinth."""
    plinth = Material("plinth", 0.6, 256, stone.marble)
    return joined([_inside(radius, (0.0, TALL), coat), _inside(0.985 * radius, (0.0, 0.1), plinth)])


def _inside(radius: float, heights: tuple[float, float], material: Material) -> Surface:
    """Half of a cylinder about the z axis, towards +y, seen from inside; the texture at its own size."""
    low, high = heights
    rows = max(2, round((high - low) / 0.08) + 1)
    angle, z = np.meshgrid(np.linspace(np.pi, 0.0, 64), np.linspace(low, high, rows))
    outwards = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], -1)
    uvs = np.stack([-radius * angle, -z], -1) / material.period
    return sheet(radius * outwards + z[..., None] * (0.0, 0.0, 1.0), -outwards, uvs, material, WHITE)
