"""Something stands on a patterned rug in a living room, which is seen from all sides or from the front."""

from __future__ import annotations

from numpy.random import Generator

from diga3d_warp.scene.synthetic.materials import Material
from diga3d_warp.scene.synthetic.orbit import Orbit
from diga3d_warp.scene.synthetic.patterns.rugs import COLORS, MOTIFS
from diga3d_warp.scene.synthetic.patterns.rugs import rug as woven
from diga3d_warp.scene.synthetic.situations.light import lamplight
from diga3d_warp.scene.synthetic.situations.situation import Situation, distance_to_cover
from diga3d_warp.scene.synthetic.situations.surfaces import FLOORS, PAPERS, living_room, pick, terrain
from diga3d_warp.scene.synthetic.situations.things import LARGE, some_things, with_article
from diga3d_warp.scene.synthetic.solids import box, joined, panel

THICK = 0.012
"""Of the rug [m]."""


def build(rng: Generator) -> Situation:
    things = some_things(rng, LARGE, (0.4, 0.75))
    distance = distance_to_cover(things[0], rng.uniform(0.09, 0.13), 58.0)
    half = max(2.0, distance + 0.9)
    width, depth = rng.uniform(1.5, 2.1), rng.uniform(1.1, 1.5)
    motif, colors = str(rng.choice(list(MOTIFS))), str(rng.choice(list(COLORS)))
    material = Material("rug", (width * depth) ** 0.5, 512, woven(width, depth, motif, colors))
    x, y = -width / 2, -depth / 2
    top = panel((x, y, 0.0), (width, 0, 0), (0, depth, 0), material, cell=0.035, whole=True)
    edge = box((x, y, -THICK), (-x, -y, -0.0002), "cloth", tint=(0.6, 0.5, 0.35), cell=0.1)
    # The object stands off the middle, so that it hides the border in some views and the motif in others.
    aside = (rng.uniform(-0.3, 0.3) * width, rng.uniform(-0.3, 0.3) * depth, 0.0)
    rug = joined([top, edge]).moved(aside).turned(rng.uniform(-30, 30))
    floor_words, floor = pick(rng, FLOORS)
    paper_words, paper = pick(rng, PAPERS)
    ground = terrain((-half, -half, half, half), floor, fine=1.0).moved((0.0, 0.0, -THICK))
    room = living_room(rng, half, paper).moved((0.0, 0.0, -THICK))
    around = bool(rng.random() < 0.6)
    orbit = Orbit(
        target=(0.0, 0.0, 0.4 * float(things[0].size[2])),
        distance=distance,
        elevation=(22.0, 42.0) if around else (20.0, 38.0),
        half_angle=180.0 if around else rng.uniform(35, 50),
    )
    place = f"{with_article(colors)} rug with {motif} on {floor_words}, {paper_words} behind"
    return Situation.of(things, joined([ground, room, rug]), place, orbit, lamplight(rng))
