"""Things that may stand somewhere: the objects of the situations, shapes in materials that suit them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from diga3d_warp.materials.vocabulary import MATERIALS as VOCABULARY
from diga3d_warp.scene.synthetic.materials import Material
from diga3d_warp.scene.synthetic.solids import Surface, ball, box, joined, revolved, smooth_profile

SIDE = 256
"""Edge of an object's texture [texels]: 1 mm a texel on things of a hand's size, 3 mm on larger ones."""


ADJECTIVES = {
    "wood": "wooden",
    "gold": "golden",
    "rust": "rusty",
    "planks": "planked",
    "polka dots": "polka dot",
}
"""What a caption says of a material where its name will not do."""


@dataclass(frozen=True, eq=False)
class Thing:
    """An object that stands on z = 0 about the origin.

    Attributes:
        kind: A key of `KINDS`.
        material: A material of the vocabulary.
        surface: Its shape [m].
    """

    kind: str
    material: str
    surface: Surface

    @property
    def caption(self) -> str:
        """Material and kind with their article, as in "a walnut stool"."""
        return with_article(f"{ADJECTIVES.get(self.material, self.material)} {self.kind}")

    @property
    def size(self) -> np.ndarray:
        """Extent along x, y and z [m], shape (3,)."""
        return np.ptp(self.surface.vertices, axis=0)


def with_article(words: str) -> str:
    """Words with "a" or "an" before them."""
    return f"{'an' if words[0] in 'aeiou' else 'a'} {words}"


Builder = Callable[[Generator, Material, float], Surface]
"""A random generator, a material and a height [m] to a shape that stands on z = 0 about the origin."""


def turned_profile(points: Sequence[tuple[float, float]], material: Material, smooth: bool = True) -> Surface:
    """A profile turned about z, with the material at its own size."""
    profile = smooth_profile(points, 36) if smooth else list(points)
    radius = max(point[0] for point in profile)
    length = float(np.linalg.norm(np.diff(np.array(profile), axis=0), axis=1).sum())
    around = max(1.0, round(2 * np.pi * radius / material.period))
    return revolved(profile, material, repeats=(around, max(length / material.period, 0.2)))


def _handle(radius: float, thickness: float, material: Material) -> Surface:
    """A ring that stands upright in the x-z plane about the origin."""
    angle = np.linspace(0, 2 * np.pi, 13)
    ring = [(radius + thickness * float(np.cos(a)), thickness * float(np.sin(a))) for a in angle]
    return revolved(ring, material, repeats=(3.0, 0.2), segments=28).turned(90, "x")


def vase(rng: Generator, material: Material, height: float) -> Surface:
    foot, belly, neck, lip = rng.uniform((0.13, 0.24, 0.08, 0.11), (0.2, 0.36, 0.14, 0.18)) * height
    at = rng.uniform(0.3, 0.55) * height
    outer = [(0.0, 0.0), (foot, 0.0), (0.6 * foot + 0.4 * belly, 0.3 * at), (belly, at)]
    outer += [(neck, 0.82 * height), (lip, height), (0.8 * lip, 0.99 * height), (0.8 * neck, 0.8 * height)]
    return turned_profile(outer, material)


def jug(rng: Generator, material: Material, height: float) -> Surface:
    belly, neck = rng.uniform((0.26, 0.15), (0.34, 0.2)) * height
    body = [(0.0, 0.0), (0.8 * belly, 0.0), (belly, 0.3 * height), (0.8 * belly, 0.55 * height)]
    body += [(neck, 0.78 * height), (1.15 * neck, height), (neck, 0.98 * height), (0.8 * neck, 0.75 * height)]
    handle = _handle(0.2 * height, 0.035 * height, material)
    return joined([turned_profile(body, material), handle.moved((neck + 0.12 * height, 0, 0.66 * height))])


def bucket(rng: Generator, material: Material, height: float) -> Surface:
    foot, rim = rng.uniform((0.3, 0.42), (0.38, 0.5)) * height
    wall = [(0.0, 0.0), (foot, 0.0), (foot, 0.0), (rim, 0.92 * height), (rim, 0.92 * height)]
    wall += [(1.06 * rim, 0.93 * height), (1.06 * rim, height), (1.06 * rim, height), (0.95 * rim, height)]
    wall += [(0.95 * rim, height), (0.95 * foot, 0.1 * height), (0.0, 0.1 * height)]
    return turned_profile(wall, material, smooth=False)


def crate(rng: Generator, material: Material, height: float) -> Surface:
    x, y = rng.uniform(0.45, 0.75, 2) * height
    bar = 0.09 * height
    parts = [box((-x, -y, 0.01 * height), (x, y, 0.97 * height), material)]
    out, shade = 0.2 * bar, (0.75, 0.75, 0.75)
    for z in (0.0, 0.5 * (height - bar), height - bar):
        for side in (-1, 1):
            front, flank = side * y, side * x
            parts.append(
                box((-x - out, front - out, z), (x + out, front + out, z + bar), material, tint=shade)
            )
            parts.append(box((flank - out, -y, z), (flank + out, y, z + bar), material, tint=shade))
    for a in (-1, 1):
        for b in (-1, 1):
            low = (a * x - 0.5 * bar, b * y - 0.5 * bar, 0.0)
            parts.append(box(low, (low[0] + bar, low[1] + bar, height), material, tint=(0.85,) * 3))
    return joined(parts).turned(rng.uniform(0, 90))


def parcel(rng: Generator, material: Material, height: float) -> Surface:
    x, y = rng.uniform(0.5, 0.9, 2) * height
    tape = 0.09 * height
    parts = [box((-x, -y, 0.0), (x, y, 0.995 * height), material)]
    parts.append(box((-1.004 * x, -tape, 0.0), (1.004 * x, tape, height), material, tint=(1.5, 1.25, 0.9)))
    return joined(parts).turned(rng.uniform(0, 90))


def stack_of_books(rng: Generator, material: Material, height: float) -> Surface:
    count = int(rng.integers(5, 9))
    parts, base = [], 0.0
    for thickness in rng.dirichlet(np.full(count, 8.0)) * height:
        x, y = rng.uniform((0.5, 0.38), (0.7, 0.5)) * height
        tint = rng.uniform(0.25, 1.3, 3)
        cover = box((-x, -y, base), (x, y, base + 0.98 * thickness), material, tint=tint)
        inset = (base + 0.14 * thickness, base + 0.84 * thickness)
        pages = box(
            (-0.97 * x, -0.97 * y, inset[0]), (1.004 * x, 0.97 * y, inset[1]), material, tint=(2.2, 2.1, 1.8)
        )
        parts.append(joined([cover, pages]).turned(rng.uniform(-14, 14)))
        base += thickness
    return joined(parts).turned(rng.uniform(0, 360))


def stool(rng: Generator, material: Material, height: float) -> Surface:
    seat, thick = rng.uniform(0.3, 0.4) * height, 0.09 * height
    top = [
        (0.0, height - thick),
        (seat, height - thick),
        (seat, height - thick),
        (1.05 * seat, height - 0.5 * thick),
    ]
    top += [(seat, height), (seat, height), (0.0, height)]
    parts = [turned_profile(top, material, smooth=False)]
    legs = int(rng.integers(3, 5))
    for number in range(legs):
        leg = [(0.045 * height, 0.0), (0.06 * height, 0.95 * height)]
        tilted = revolved(leg, material, segments=12).turned(-9, "y").moved((0.95 * seat, 0.0, 0.0))
        parts.append(tilted.turned(360 * number / legs))
    ring = [(0.77 * seat, 0.3 * height), (0.82 * seat, 0.3 * height), (0.82 * seat, 0.34 * height)]
    ring += [(0.77 * seat, 0.34 * height), (0.77 * seat, 0.3 * height)]
    return joined([*parts, revolved(ring, material, repeats=(6.0, 0.2))]).turned(rng.uniform(0, 120))


def sphere(rng: Generator, material: Material, height: float) -> Surface:
    around = max(1.0, round(np.pi * height / material.period))
    body = ball(height / 2, material, repeats=(around, 0.5 * around)).turned(rng.uniform(15, 60), "x")
    return body.turned(rng.uniform(0, 360)).moved((0.0, 0.0, height / 2))


def pawn(rng: Generator, material: Material, height: float) -> Surface:
    foot, waist = rng.uniform((0.3, 0.1), (0.36, 0.14)) * height
    body = [
        (0.0, 0.0),
        (foot, 0.0),
        (foot, 0.08 * height),
        (0.7 * foot, 0.18 * height),
        (waist, 0.4 * height),
    ]
    body += [(waist, 0.58 * height), (2 * waist, 0.63 * height), (waist, 0.68 * height), (0.0, 0.7 * height)]
    head = 0.17 * height
    top = sphere(rng, material, 2 * head)
    return joined([turned_profile(body, material), top.moved((0.0, 0.0, height - 2 * head))])


def teapot(rng: Generator, material: Material, height: float) -> Surface:
    radius = rng.uniform(0.42, 0.52) * height
    body = [(0.0, 0.0), (0.6 * radius, 0.0), (radius, 0.35 * height), (0.8 * radius, 0.65 * height)]
    body += [(0.45 * radius, 0.78 * height), (0.0, 0.84 * height)]
    knob = ball(0.07 * height, material, segments=16).moved((0.0, 0.0, 0.93 * height))
    spout = revolved([(0.13 * height, 0.0), (0.05 * height, 0.6 * height)], material, segments=16)
    spout = spout.turned(48, "y").moved((0.7 * radius, 0.0, 0.3 * height))
    handle = _handle(0.24 * height, 0.04 * height, material).moved((-radius, 0.0, 0.45 * height))
    return joined([turned_profile(body, material), knob, spout, handle]).turned(rng.uniform(0, 360))


def lantern(rng: Generator, material: Material, height: float) -> Surface:
    half, post = rng.uniform(0.2, 0.28) * height, 0.035 * height
    parts = [box((-1.2 * half, -1.2 * half, 0.0), (1.2 * half, 1.2 * half, 0.08 * height), material)]
    foot, eaves = 0.08 * height, 0.68 * height
    for x in (-half, half):
        for y in (-half, half):
            parts.append(box((x - post, y - post, foot), (x + post, y + post, eaves), material))
    roof = [(1.75 * half, 0.68 * height), (1.75 * half, 0.71 * height), (1.75 * half, 0.71 * height)]
    roof += [(0.25 * half, 0.92 * height), (0.25 * half, 0.92 * height), (0.12 * half, height), (0.0, height)]
    parts.append(revolved(roof, material, repeats=(4.0, 1.0), segments=4).turned(45))
    candle = [(0.0, 0.08 * height), (0.4 * half, 0.08 * height), (0.4 * half, 0.08 * height)]
    candle += [(0.4 * half, 0.42 * height), (0.4 * half, 0.42 * height), (0.0, 0.43 * height)]
    parts.append(revolved(candle, material, tint=(2.0, 1.9, 1.6)))
    return joined(parts).turned(rng.uniform(0, 90))


KINDS: dict[str, tuple[Builder, tuple[str, ...]]] = {
    "vase": (vase, ("porcelain", "terracotta", "marble", "jade", "copper", "mosaic")),
    "jug": (jug, ("porcelain", "terracotta", "steel", "copper", "slate")),
    "bucket": (bucket, ("steel", "copper", "rust", "wicker", "polka dots")),
    "crate": (crate, ("wood", "walnut", "planks")),
    "parcel": (parcel, ("cork", "paper", "sandstone")),
    "stack of books": (stack_of_books, ("linen", "leather")),
    "stool": (stool, ("wood", "walnut", "bamboo")),
    "ball": (sphere, ("tartan", "polka dots", "checkerboard", "leather", "gold", "malachite")),
    "pawn": (pawn, ("marble", "black marble", "wood", "granite", "lapis lazuli")),
    "teapot": (teapot, ("porcelain", "steel", "copper", "jade")),
    "lantern": (lantern, ("rust", "bronze", "wood", "sandstone")),
}
"""Shapes by name, each with the materials of the vocabulary that suit it."""

SMALL = ("vase", "jug", "teapot", "pawn", "ball", "stack of books", "lantern", "parcel")
"""Kinds that stand on a table or in a shelf."""

LARGE = ("vase", "bucket", "crate", "stool", "ball", "pawn", "lantern", "parcel", "jug")
"""Kinds that stand on the floor."""


def stuff(name: str, height: float) -> Material:
    """A material of the vocabulary for a thing of some height: about one repeat over it."""
    return Material(name, 0.8 * height, SIDE, VOCABULARY[name].painter)


def make(rng: Generator, kind: str, material: str, height: float) -> Thing:
    """A thing of a kind, in a material of the vocabulary, `height` metres high."""
    return Thing(kind, material, KINDS[kind][0](rng, stuff(material, height), height))


def some_things(
    rng: Generator, kinds: Sequence[str], height: tuple[float, float]
) -> tuple[Thing, Thing, Thing]:
    """The object, the same shape in another material, and another object.

    Args:
        rng: Picks all three.
        kinds: Keys of `KINDS` to choose from, at least two.
        height: Range of their heights [m].
    """
    kind, other_kind = (str(name) for name in rng.choice(kinds, 2, replace=False))
    material, other_material = (str(name) for name in rng.choice(KINDS[kind][1], 2, replace=False))
    tall = rng.uniform(*height)
    shape = int(rng.integers(2**31))
    thing = make(np.random.default_rng(shape), kind, material, tall)
    recast = make(np.random.default_rng(shape), kind, other_material, tall)
    other_shape = int(rng.integers(2**31))
    stuff_of_other = str(rng.choice(KINDS[other_kind][1]))
    other = make(np.random.default_rng(other_shape), other_kind, stuff_of_other, tall)
    # As large as the object: a kind that is wide for its height comes out lower.
    share = float(min(height[1] / tall, np.cbrt(np.prod(thing.size) / np.prod(other.size))))
    other = make(np.random.default_rng(other_shape), other_kind, stuff_of_other, share * tall)
    return thing, recast, other


def reach_back(things: Sequence[Thing]) -> float:
    """How far things reach from the origin towards +y [m]."""
    return max(float(thing.surface.vertices[:, 1].max()) for thing in things)
