"""Something stands in the corner of a room: a floor and two walls meet behind it."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from diga3d_warp.scene.synthetic.orbit import Orbit
from diga3d_warp.scene.synthetic.room import picture
from diga3d_warp.scene.synthetic.situations.light import lamplight
from diga3d_warp.scene.synthetic.situations.situation import Situation, distance_to_cover
from diga3d_warp.scene.synthetic.situations.surfaces import FLOORS, PAPERS, pick, terrain, wall
from diga3d_warp.scene.synthetic.situations.things import LARGE, some_things
from diga3d_warp.scene.synthetic.solids import joined


def build(rng: Generator) -> Situation:
    things = some_things(rng, LARGE, (0.4, 0.8))
    distance = distance_to_cover(things[0], rng.uniform(0.09, 0.13), 58.0)
    floor_words, floor = pick(rng, FLOORS)
    paper_words, paper = pick(rng, PAPERS)
    other_words, other = (paper_words, paper) if rng.random() < 0.5 else pick(rng, PAPERS)
    radius = float(np.hypot(*things[0].size[:2])) / 2
    back, side = radius + rng.uniform(0.02, 0.25, 2)  # from the object's axis to the walls
    length, height = distance + 2.0, 2.7
    parts = [terrain((-side, back - length, length - side, back), floor)]
    rear = wall(length, height, paper).moved((length / 2 - side, back, 0.0))
    left = wall(length, height, other).turned(90).moved((-side, back - length / 2, 0.0))
    parts += [rear, left]
    parts.append(picture(0.5, 0.4).moved((rng.uniform(0.4, 1.0), back, rng.uniform(1.0, 1.3))))
    parts.append(picture(0.4, 0.5).turned(90).moved((-side, -rng.uniform(0.4, 1.0), rng.uniform(1.0, 1.3))))
    orbit = Orbit(
        target=(0.0, 0.0, 0.4 * float(things[0].size[2])),
        distance=distance,
        elevation=(14.0, 38.0),
        middle=rng.uniform(35, 55),
        half_angle=rng.uniform(26, 36),
    )
    papers = paper_words if other_words == paper_words else f"{paper_words} and {other_words}"
    place = f"the corner of a room with {papers} and {floor_words}"
    light = lamplight(rng, azimuth=(-10.0, 100.0))
    return Situation.of(things, joined(parts), place, orbit, light, stands="in")
