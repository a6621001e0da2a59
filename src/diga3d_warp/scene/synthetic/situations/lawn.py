"""Something stands on the uneven lawn of a garden."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from diga3d_warp.materials import stone
from diga3d_warp.scene.synthetic.materials import Material
from diga3d_warp.scene.synthetic.orbit import Orbit
from diga3d_warp.scene.synthetic.patterns import ground
from diga3d_warp.scene.synthetic.situations.light import sky_dome, sunlight
from diga3d_warp.scene.synthetic.situations.situation import Situation, distance_to_cover
from diga3d_warp.scene.synthetic.situations.surfaces import FENCES, Height, bumps, garden, pick, terrain
from diga3d_warp.scene.synthetic.situations.things import LARGE, some_things
from diga3d_warp.scene.synthetic.solids import Surface, joined, revolved

STONE = Material("stepping stone", 0.6, 256, stone.sandstone)


def build(rng: Generator) -> Situation:
    things = some_things(rng, LARGE, (0.45, 0.9))
    distance = distance_to_cover(things[0], rng.uniform(0.08, 0.12), 58.0)
    half = distance + rng.uniform(2.2, 3.5)
    mown, flowers = (0.14, 0) if rng.random() < 0.5 else (0.0, int(rng.integers(8, 30)))
    grass = Material("lawn", 0.95, 512, ground.lawn(mown, flowers))
    height = bumps(rng, rng.uniform(0.015, 0.035), rng.uniform(1.2, 2.4))
    lawn = terrain((-half, -half, half, half), grass, height=height, turn=rng.uniform(0, 90))
    fence_words, fence = pick(rng, FENCES)
    parts = [lawn, garden(rng, half, fence)]
    stones = bool(rng.random() < 0.5)
    if stones:
        parts.append(stepping_stones(rng, height))
    around = bool(rng.random() < 0.65)
    orbit = Orbit(
        target=(0.0, 0.0, 0.4 * float(things[0].size[2])),
        distance=distance,
        elevation=(14.0, 34.0),
        half_angle=180.0 if around else rng.uniform(35, 50),
    )
    kind = "striped lawn" if mown else "lawn with daisies"
    place = f"a {kind}{' with stepping stones' if stones else ''}, {fence_words} behind"
    return Situation.of(things, joined(parts), place, orbit, sunlight(rng), sky_dome())


def stepping_stones(rng: Generator, height: Height) -> Surface:
    """A row of round slabs on the ground that passes under the object."""
    parts, turn = [], rng.uniform(0, np.pi)
    for number in range(-4, 5):
        radius = rng.uniform(0.17, 0.22)
        slab = [(radius, -0.08), (radius, -0.004), (0.93 * radius, 0.0), (0.93 * radius, 0.0), (0.0, 0.0)]
        along, aside = 0.55 * number, rng.uniform(-0.06, 0.06) if number else 0.0
        x = along * np.cos(turn) - aside * np.sin(turn)
        y = along * np.sin(turn) + aside * np.cos(turn)
        level = float(height(np.array(x), np.array(y))) + 0.012 if number else 0.0
        disc = revolved(slab, STONE, repeats=(2.0, 0.5), segments=24).turned(rng.uniform(0, 360))
        parts.append(disc.moved((x, y, level)))
    return joined(parts)
