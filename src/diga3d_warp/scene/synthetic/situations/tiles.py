"""Something stands on the tiled floor of a bathroom."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.random import Generator

from diga3d_warp.scene.synthetic.materials import Material
from diga3d_warp.scene.synthetic.orbit import Orbit
from diga3d_warp.scene.synthetic.patterns import tiles, walls
from diga3d_warp.scene.synthetic.situations.light import lamplight
from diga3d_warp.scene.synthetic.situations.situation import Situation, distance_to_cover
from diga3d_warp.scene.synthetic.situations.surfaces import PAINTED, pick, terrain, wall
from diga3d_warp.scene.synthetic.situations.things import LARGE, some_things
from diga3d_warp.scene.synthetic.solids import Surface, box, joined, panel, revolved, smooth_profile

FLOORS: Sequence[tuple[str, Material]] = (
    ("black and white tiles", Material("checked tiles", 1.6, 512, tiles.squares(8, "#e6e4de", "#33363a"))),
    ("grey tiles", Material("grey tiles", 1.5, 512, tiles.squares(5, "#9a9c9a", grout="light"))),
    ("beige tiles", Material("beige tiles", 1.8, 512, tiles.squares(6, "#c8b79a", grout="dark"))),
    ("hexagonal tiles", Material("hexagons", 1.05, 512, tiles.hexagons("#e2dfd6", "#3d5f73", "dark"))),
    ("blue and white tiles", Material("blue tiles", 1.6, 512, tiles.squares(8, "#dfe3e4", "#5b7f9c"))),
    ("oblong slate tiles", Material("slate tiles", 1.6, 512, tiles.bond(8, 4, "#6d7378"))),
)
"""Floors by what a caption says of them."""

WALLS: Sequence[tuple[str, Material]] = (
    ("white tiled walls", Material("white wall tiles", 0.9, 256, tiles.squares(6, "#e9e8e3"))),
    ("green tiled walls", Material("green wall tiles", 0.9, 256, tiles.bond(12, 6, "#9db8a4"))),
    ("metro tiled walls", Material("metro tiles", 0.9, 256, tiles.bond(10, 4, "#e3e2dc", "dark"))),
    ("blue tiled walls", Material("blue wall tiles", 0.9, 256, tiles.squares(6, "#a9c0cf"))),
)
ENAMEL = Material("enamel", 0.8, 128, walls.painted("#eeeeea"))
PLASTER = Material("bathroom plaster", 1.2, 256, walls.painted("#dfdcd2"))


def build(rng: Generator) -> Situation:
    things = some_things(rng, LARGE, (0.35, 0.65))
    distance = distance_to_cover(things[0], rng.uniform(0.09, 0.13), 58.0)
    half = max(1.5, distance + 0.85)
    floor_words, floor = pick(rng, FLOORS)
    wall_words, covering = pick(rng, WALLS)
    ground = terrain((-half, -half, half, half), floor, turn=float(rng.choice([0.0, 0.0, 45.0])))
    sides = [bathtub(), washstand(rng), toilet(), towel_rail(rng)]
    parts = [ground]
    for side, index in enumerate(rng.permutation(4)):
        fitting = sides[index].moved((rng.uniform(-0.25, 0.25) * half, half, 0.0))
        parts.append(
            joined([tiled_wall(2 * half, covering).moved((0.0, half, 0.0)), fitting]).turned(90 * side)
        )
    around = bool(rng.random() < 0.5)
    orbit = Orbit(
        target=(0.0, 0.0, 0.35 * float(things[0].size[2])),
        distance=distance,
        elevation=(20.0, 40.0),
        half_angle=180.0 if around else rng.uniform(38, 55),
    )
    place = f"{floor_words} in a bathroom with {wall_words}"
    return Situation.of(things, joined(parts), place, orbit, lamplight(rng, farthest=0.6 * half))


def tiled_wall(width: float, covering: Material) -> Surface:
    """A wall that faces -y at y = 0: tiles, a dark border, paint above."""
    tiled = wall(width, 1.3, covering, skirting=0.0)
    border = box(
        (-width / 2, -0.012, 1.3), (width / 2, 0.0, 1.36), PAINTED, tint=(0.12, 0.22, 0.32), cell=0.2
    )
    above = panel((-width / 2, 0.0, 1.36), (width, 0, 0), (0, 0, 1.3), PLASTER, cell=0.2)
    return joined([tiled, border, above])


def bathtub() -> Surface:
    """A tub along a wall at y = 0, before it, 1.6 m long."""
    x, depth, height, rim = 0.8, 0.7, 0.52, 0.07
    return joined(
        [
            box((-x, -depth, 0.06), (x, -depth + rim, height), ENAMEL),
            box((-x, -rim, 0.06), (x, 0.0, height), ENAMEL),
            box((-x, -depth, 0.06), (-x + rim, 0.0, height), ENAMEL),
            box((x - rim, -depth, 0.06), (x, 0.0, height), ENAMEL),
            box((-x, -depth, 0.06), (x, 0.0, 0.16), ENAMEL),
            box((-0.9 * x, -0.96 * depth, 0.0), (0.9 * x, 0.0, 0.06), PAINTED, tint=(0.3, 0.3, 0.3)),
        ]
    )


def washstand(rng: Generator) -> Surface:
    """A cabinet with a basin and a mirror's frame above it."""
    tint = rng.uniform(0.5, 1.1, 3)
    basin = [(0.1, 0.0), (0.26, 0.1), (0.27, 0.12), (0.24, 0.11), (0.08, 0.02), (0.0, 0.02)]
    return joined(
        [
            box((-0.45, -0.45, 0.1), (0.45, 0.0, 0.8), "oak", tint=tint),
            box((-0.43, -0.46, 0.13), (-0.01, -0.45, 0.77), "oak", tint=0.8 * tint),
            box((0.01, -0.46, 0.13), (0.43, -0.45, 0.77), "oak", tint=0.8 * tint),
            box((-0.48, -0.48, 0.8), (0.48, 0.0, 0.84), "marble"),
            revolved(smooth_profile(basin, 20), ENAMEL, segments=28).moved((0.0, -0.24, 0.84)),
            box((-0.4, -0.03, 1.1), (0.4, 0.0, 1.9), "walnut"),
            box((-0.35, -0.035, 1.15), (0.35, -0.03, 1.85), PAINTED, tint=(0.55, 0.62, 0.66)),
        ]
    )


def toilet() -> Surface:
    """A bowl with its lid and a cistern."""
    bowl = [(0.13, 0.0), (0.12, 0.12), (0.2, 0.36), (0.21, 0.4), (0.2, 0.42), (0.0, 0.425)]
    return joined(
        [
            revolved(smooth_profile(bowl, 24), ENAMEL, segments=28)
            .stretched((1, 1.3, 1))
            .moved((0, -0.42, 0)),
            box((-0.2, -0.2, 0.36), (0.2, 0.0, 0.8), ENAMEL),
            box((-0.21, -0.21, 0.8), (0.21, 0.0, 0.83), ENAMEL),
        ]
    )


def towel_rail(rng: Generator) -> Surface:
    """Two towels over a rail."""
    parts = [box((-0.55, -0.08, 1.02), (0.55, -0.06, 1.04), PAINTED, tint=(0.5, 0.5, 0.5))]
    for x in (-0.45, 0.05):
        low = rng.uniform(0.3, 0.5)
        parts.append(box((x, -0.11, low), (x + 0.38, -0.03, 1.05), "cloth", tint=rng.uniform(0.15, 1.0, 3)))
    return joined(parts)
