"""Surfaces that situations share: grounds with fine cells about the object, walls, rooms, gardens."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.random import Generator

from diga3d_warp.materials import masonry, wood
from diga3d_warp.scene.synthetic.materials import Material
from diga3d_warp.scene.synthetic.patterns import ground, tiles, walls
from diga3d_warp.scene.synthetic.room import bookshelf, picture, potted_plant, side_table, sideboard
from diga3d_warp.scene.synthetic.solids import WHITE, Surface, ball, box, joined, panel, revolved, sheet

FINE_CELL, COARSE_CELL = 0.035, 0.3
"""Edges of the cells near the object and far from it [m]: the object's penumbras are some fine cells wide."""

TABLE_CELL = 0.015
"""Edge of the cells near things of a hand's size [m]."""

GROWTH = 1.25
"""Each cell beyond the fine ones is longer than the one before by this factor [1]."""

Height = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""x and y [m] to the height of the ground [m]."""


def terrain(
    bounds: tuple[float, float, float, float],
    material: Material,
    *,
    height: Height | None = None,
    fine: float = 0.8,
    cell: float = FINE_CELL,
    turn: float = 0.0,
) -> Surface:
    """Ground that faces upwards, in cells that are fine about the origin.

    Args:
        bounds: x and y of its first, x and y of its last corner [m]; the origin may lie outside.
        material: What it is made of, at its own size.
        height: Height of the ground [m]; 0 if None.
        fine: How far fine cells reach from the origin [m].
        cell: Edge of the fine cells [m].
        turn: Of the texture about the origin [degrees].
    """
    low_x, low_y, high_x, high_y = bounds
    x, y = np.meshgrid(_lines(low_x, high_x, fine, cell), _lines(low_y, high_y, fine, cell))
    z, slope_x, slope_y = np.zeros_like(x), np.zeros_like(x), np.zeros_like(x)
    if height is not None:
        step = 0.5 * cell
        z = height(x, y)
        slope_x = (height(x + step, y) - height(x - step, y)) / (2 * step)
        slope_y = (height(x, y + step) - height(x, y - step)) / (2 * step)
    normals = np.stack([-slope_x, -slope_y, np.ones_like(x)], -1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    cosine, sine = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    uvs = np.stack([cosine * x + sine * y, cosine * y - sine * x], -1) / material.period
    return sheet(np.stack([x, y, z], -1), normals, uvs, material, WHITE)


def _lines(low: float, high: float, fine: float, cell: float) -> np.ndarray:
    """Places of the grid lines from `low` to `high`, close together about 0."""
    places, step = [0.0], cell
    while places[-1] < max(abs(low), abs(high)):
        step = step if places[-1] < fine else min(step * GROWTH, COARSE_CELL)
        places.append(places[-1] + step)
    both = np.concatenate([-np.array(places[:0:-1]), places])
    inside = both[(both > low + 0.3 * cell) & (both < high - 0.3 * cell)]
    return np.concatenate([[low], inside, [high]])


def bumps(rng: Generator, amplitude: float, length: float) -> Height:
    """Gentle undulation that is 0 at the origin.

    Args:
        rng: Picks directions and phases.
        amplitude: Deviation of the heights [m], about.
        length: Longest wave [m].
    """
    waves = 7
    angle, phase = rng.uniform(0, 2 * np.pi, (2, waves))
    number = 2 * np.pi / (length * 0.72 ** np.arange(waves))
    size = amplitude * 0.72 ** np.arange(waves) / np.sqrt(waves)

    def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        along = x[..., None] * np.cos(angle) + y[..., None] * np.sin(angle)
        return (size * (np.sin(number * along + phase) - np.sin(phase))).sum(-1)

    return height


PAPERS: Sequence[tuple[str, Material]] = (
    ("striped wallpaper", Material("striped paper", 0.6, 256, walls.striped_paper("#d9cfb5", "#8d9c86", 4))),
    ("red striped wallpaper", Material("red paper", 0.7, 256, walls.striped_paper("#e3d8c6", "#9c5148", 5))),
    (
        "blue striped wallpaper",
        Material("blue paper", 0.6, 256, walls.striped_paper("#ccd3d8", "#557088", 6)),
    ),
    (
        "flowered wallpaper",
        Material("flowered paper", 0.64, 256, walls.flowered_paper("#dcd6c2", "#a65b52", "#5f7350")),
    ),
    (
        "blue flowered wallpaper",
        Material("blue flowers", 0.56, 256, walls.flowered_paper("#e2e2dd", "#4f6f9c", "#c49a4a")),
    ),
    ("a brick wall", Material("bricks", 0.96, 512, masonry.bricks)),
    ("a plastered wall", Material("plaster", 1.28, 512, masonry.plaster)),
    ("panelled walls", Material("panels", 1.2, 512, walls.boards(8, "#c9c2b0", "#e8e2d2", 0.03))),
)
"""Coverings of indoor walls, by what a caption says of them."""

_PARQUET = ground.herringbone(("#6f4423", "#9a6636", "#b98550"), "#3c2614")

FLOORS: Sequence[tuple[str, Material]] = (
    ("a plank floor", Material("planks", 2.56, 1024, wood.planks)),
    ("a herringbone parquet floor", Material("parquet", 0.8, 512, _PARQUET)),
    ("a terracotta tile floor", Material("terracotta tiles", 1.6, 512, tiles.squares(6, "#b06a48"))),
    ("a concrete floor", Material("concrete", 1.6, 512, masonry.concrete)),
)
"""Floors of living rooms, by what a caption says of them."""

PAVINGS: Sequence[tuple[str, Material]] = (
    (
        "irregular flagstones",
        Material(
            "flagstones",
            2.0,
            1024,
            ground.flagstones(("#8d8377", "#aca18f", "#c2b8a4", "#9a8f85"), "#5a5348"),
        ),
    ),
    (
        "slate flagstones",
        Material(
            "slate flags", 1.8, 1024, ground.flagstones(("#4f565c", "#6b7075", "#82837f"), "#a79f8e", 5)
        ),
    ),
    (
        "sandstone slabs",
        Material("slabs", 2.4, 1024, ground.slabs(("#b08d62", "#cdb084", "#d9c49d"), "#6f6250")),
    ),
    (
        "herringbone brick paving",
        Material("herringbone", 0.9, 512, ground.herringbone(("#7d3b2a", "#a2553c", "#b97052"), "#8f8576")),
    ),
    ("cobblestones", Material("cobbles", 1.1, 512, masonry.cobbles)),
)
"""Paving outdoors, by what a caption says of it."""


def pick(rng: Generator, choices: Sequence[tuple[str, Material]]) -> tuple[str, Material]:
    """One of a table of materials."""
    return choices[int(rng.integers(len(choices)))]


PAINTED = Material("painted wood", 0.64, 256, walls.painted("#e8e4da"))


def wall(
    width: float, height: float, material: Material, *, skirting: float = 0.1, cell: float = 0.12
) -> Surface:
    """An upright wall along x that faces -y at y = 0, its middle at the origin, with a skirting board."""
    face = panel((-width / 2, 0, 0), (width, 0, 0), (0, 0, height), material, cell=cell)
    if not skirting:
        return face
    board = box((-width / 2, -0.018, 0.0), (width / 2, 0.0, skirting), PAINTED, cell=cell)
    return joined([face, board])


def living_room(rng: Generator, half: float, paper: Material, *, height: float = 2.7) -> Surface:
    """Four walls about the origin with furniture along them, without a floor.

    Args:
        rng: Picks the furniture.
        half: From the origin to each wall [m].
        paper: Covering of three walls; the fourth has another.
        height: Of the walls [m].
    """
    parts = []
    accent = pick(rng, PAPERS)[1]
    odd = int(rng.integers(4))
    for side, furniture in enumerate(rng.permutation(4)):
        covering = accent if side == odd else paper
        stands = [
            wall(2 * half, height, covering).moved((0.0, half, 0.0)),
            _along_wall(rng, int(furniture), half),
        ]
        parts.append(joined(stands).turned(90 * side))
    return joined(parts)


def _along_wall(rng: Generator, kind: int, half: float) -> Surface:
    """Furniture before a wall at y = half that faces -y."""
    aside = rng.uniform(-0.3, 0.3) * half
    if kind == 0:
        return bookshelf(rng).moved((aside, half - 0.02, 0.0))
    if kind == 1:
        low = sideboard().moved((aside, half - 0.02, 0.0))
        return joined([low, picture(0.95, 0.7).moved((aside, half, 1.5))])
    if kind == 2:
        plant = potted_plant(rng).moved((aside - 0.6, half - 0.4, 0.0))
        return joined([plant, picture(0.6, 0.8).moved((aside + 0.3, half, 1.4))])
    table = side_table().moved((aside, half - 0.4, 0.0))
    return joined([table, picture(0.5, 0.62).moved((aside - 0.8, half, 1.4))])


HEDGE = Material("hedge", 1.2, 512, walls.hedge)
FENCES: Sequence[tuple[str, Material]] = (
    ("a wooden fence", Material("fence", 1.2, 512, walls.boards(8, "#6b4a2e", "#a8805a", 0.06))),
    ("a grey fence", Material("grey fence", 1.3, 512, walls.boards(9, "#6f6d68", "#a5a29a", 0.08))),
    ("a brick wall", Material("bricks", 0.96, 512, masonry.bricks)),
    ("a hedge", HEDGE),
)
"""What encloses a garden, by what a caption says of it."""


def garden(rng: Generator, half: float, fence: Material, *, trees: int = 3) -> Surface:
    """A fence about the origin, bushes and trees before it, without the ground.

    Args:
        rng: Picks heights and places.
        half: From the origin to the fence [m].
        fence: What it is made of.
        trees: How many.
    """
    height = rng.uniform(1.5, 2.1)
    parts = []
    for side in range(4):
        face = wall(2 * half, height, fence, skirting=0.0, cell=0.3).moved((0.0, half, -0.1))
        parts.append(face.turned(90 * side))
    bark = Material("bark", 0.6, 256, wood.bark)
    for angle in (
        rng.uniform(0, 360) + np.linspace(0, 360, trees, endpoint=False) + rng.uniform(-25, 25, trees)
    ):
        away = half - rng.uniform(0.5, 0.9)
        trunk = revolved([(0.14, -0.1), (0.1, 1.2), (0.08, 3.0)], bark, repeats=(1.0, 4.0), segments=16)
        crown = [
            ball(size, HEDGE, repeats=(4.0, 2.0), segments=20).moved((*rng.uniform(-0.4, 0.4, 2), level))
            for size, level in zip(rng.uniform(0.6, 0.9, 3), (2.2, 2.8, 3.3), strict=True)
        ]
        parts.append(joined([trunk, *crown]).moved((0.0, away, 0.0)).turned(angle))
    for angle in rng.uniform(0, 360, 6):
        bush = ball(1.0, HEDGE, repeats=(3.0, 1.5), segments=18).stretched(rng.uniform(0.3, 0.6, 3).tolist())
        parts.append(bush.moved((0.0, half - 0.45, 0.15)).turned(angle))
    return joined(parts)
