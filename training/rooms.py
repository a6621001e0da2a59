"""Rooms to train on: the generator's situations with objects in many materials, each with its words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import warp as wp
from numpy.random import Generator

from diga3d_warp.materials.tint import COLORS, SHADES, Tint
from diga3d_warp.materials.vocabulary import MATERIALS as VOCABULARY
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.synthetic.arc import arc_cameras
from diga3d_warp.scene.synthetic.materials import Material
from diga3d_warp.scene.synthetic.rendering import Body, camera_rays, cast, developed
from diga3d_warp.scene.synthetic.room import room_scenery
from diga3d_warp.scene.synthetic.scenery import Scenery
from diga3d_warp.scene.synthetic.shots import Front, Lit
from diga3d_warp.scene.synthetic.situations.catalogue import SITUATIONS, build_situation
from diga3d_warp.scene.synthetic.situations.things import KINDS, SIDE, turned_profile
from diga3d_warp.scene.synthetic.solids import Surface, box
from training.recipe import DataRecipe

ROOM = "room"
"""The room with a vase, beside the generator's situations."""

PLACES = (*SITUATIONS, ROOM)

ROOM_PLACE = "a red rug on a plank floor, flowered wallpaper behind"


@dataclass(frozen=True)
class Words:
    """What may be said of an object.

    Attributes:
        kind: Its shape, as in "vase".
        material: A name of the vocabulary.
        color: A colour, after its shade if it has one, as in "dark green"; empty for the material's own.
    """

    kind: str
    material: str
    color: str


@dataclass(frozen=True, eq=False)
class Room:
    """A lit room with two objects, one at a time, each in several materials.

    Attributes:
        place: What a caption says of the room.
        stands: Where the object is with respect to the place: "on", "in", "in front of".
        things: What is said of each object in each material.
        views: Cameras of a capture.
        surroundings: Everything that stays.
        alone, beside: Tinted light on it without an object and with each.
        bodies, on: Each object in each material, and tinted light on it.
    """

    place: str
    stands: str
    things: tuple[tuple[Words, ...], ...]
    views: list[Camera]
    surroundings: Body
    alone: wp.array
    beside: list[wp.array]
    bodies: list[list[Body]]
    on: list[list[wp.array]]

    def take(self, camera: Camera, supersampling: int) -> Window:
        """Render all that a window shows."""
        shape = (camera.height, camera.width)
        rays = camera_rays(camera, supersampling)
        hits = cast(self.surroundings, rays)
        behind = hits.distance.numpy()
        centers = camera.height * camera.width
        images, masks, depths = [], [], []
        for bodies, beside, on in zip(self.bodies, self.beside, self.on, strict=True):
            front = Front(bodies[0], camera, rays, behind)
            background = self.surroundings.colors(hits, beside, rays.spread)
            shown = [front.over(background, body, light) for body, light in zip(bodies, on, strict=True)]
            images.append([developed(colors, shape) for colors in shown])
            masks.append(np.any(front.shown.reshape(-1, *shape), axis=0))
            depths.append(front.nearest[:centers].reshape(shape) * rays.slant)
        return Window(
            developed(self.surroundings.colors(hits, self.alone, rays.spread), shape),
            behind[:centers].reshape(shape) * rays.slant,
            np.array(images),
            np.array(masks),
            np.array(depths),
        )


@dataclass(frozen=True, eq=False)
class Window:
    """All that is known of one window.

    Attributes:
        alone: Without an object, shape (H, W, 3), uint8.
        depth: z depth of that [m], shape (H, W).
        images: With each object in each material, shape (T, R, H, W, 3), uint8.
        masks: Where each object shows, shape (T, H, W), bool.
        depths: z depth with each object [m], shape (T, H, W).
    """

    alone: np.ndarray
    depth: np.ndarray
    images: np.ndarray
    masks: np.ndarray
    depths: np.ndarray


def build_room(place: str, seed: int, recipe: DataRecipe) -> Room:
    """Light a room.

    Args:
        place: One of `PLACES`.
        seed: Of everything.
        recipe: What is rendered.
    """
    rng = np.random.default_rng([seed, 5])
    paths = np.random.default_rng([seed, 2])
    size = 4 * 80, 3 * 80  # only their shape counts: windows have their own focal length
    if place == ROOM:
        scenery, said, stands = room_scenery(seed), ROOM_PLACE, "on"
        kinds = ["vase", "ball"]
        views = list(arc_cameras(*size, recipe.cameras, seed).values())
    else:
        situation = build_situation(place, seed)
        scenery, captions = situation.scenery, situation.captions
        said = captions.without_object
        stands = captions.images.removeprefix(captions.object).removesuffix(said).strip()
        other = captions.other_object.removesuffix(f"{stands} {said}").strip()
        kinds = [_kind_in(captions.object), _kind_in(other)]
        views = list(situation.orbit.cameras(*size, recipe.cameras, paths).values())
    shapes = [scenery.thing, scenery.other_object]
    if rng.random() < recipe.plain_solids:
        kinds[1], shapes[1] = _plain_solid(rng, np.ptp(shapes[0].vertices, axis=0))
    things = tuple(_some_words(rng, kind, recipe) for kind in kinds)
    cast_in = [
        [recast(shape, words) for words in chosen] for shape, chosen in zip(shapes, things, strict=True)
    ]
    return _lit(scenery, seed, said, stands, things, cast_in, views)


def _lit(
    scenery: Scenery,
    seed: int,
    place: str,
    stands: str,
    things: tuple[tuple[Words, ...], ...],
    recasts: list[list[Surface]],
    views: list[Camera],
) -> Room:
    lit = Lit(scenery, [surface for shapes in recasts for surface in shapes], seed)
    bodies = [[Body(surface, lit.textures) for surface in shapes] for shapes in recasts]
    lights = [lit.light(shapes[0]) for shapes in recasts]
    return Room(
        place,
        stands,
        things,
        views,
        lit.body,
        lit.tinted(lit.light()[0]),
        [lit.tinted(beside) for beside, _ in lights],
        bodies,
        [[body.tinted(on) for body in shapes] for shapes, (_, on) in zip(bodies, lights, strict=True)],
    )


def recast(surface: Surface, words: Words) -> Surface:
    """A shape in one material all over; its parts keep their tints."""
    height = float(np.ptp(surface.vertices[:, 2]))
    entry = VOCABULARY[words.material]
    tint = _tint(words.color)

    def paint(rng: Generator, side: int) -> np.ndarray:
        texture = np.clip(entry.painter(rng, side), 0.0, 1.0)
        return texture if tint is None else tint.on(texture)

    material = Material(f"{words.color} {words.material}".strip(), 0.8 * height, SIDE, paint)
    return replace(surface, palette=(material,), materials=np.zeros_like(surface.materials))


def _tint(color: str) -> Tint | None:
    if not color:
        return None
    shade, _, rest = color.partition(" ")
    return Tint(rest, SHADES[shade]) if shade in SHADES and rest else Tint(color)


def _kind_in(caption: str) -> str:
    """The kind that a caption such as "a polka dot ball" ends with."""
    return max((kind for kind in KINDS if caption.endswith(kind)), key=len)


PLAIN = ("cube", "cylinder", "cone", "sphere")
"""Solids that `replace` knows, beside the generator's kinds."""


def _plain_solid(rng: Generator, extent: np.ndarray) -> tuple[str, Surface]:
    """A solid that fits where an object of some extent [m] stands."""
    kind = str(rng.choice(PLAIN))
    across, height = float(min(extent[:2])), float(extent[2])
    stuff = Material("plaster", 0.8 * height, SIDE, VOCABULARY["plaster"].painter)
    if kind == "cube":
        half = 0.5 * min(across / 1.2, height)
        return kind, box((-half, -half, 0.0), (half, half, 2 * half), stuff).turned(rng.uniform(0, 90))
    if kind == "sphere":
        builder, _ = KINDS["ball"]
        return kind, builder(rng, stuff, min(across, height))
    radius = min(0.5 * across, 0.5 * height)
    top = radius if kind == "cylinder" else 0.02 * radius
    profile = [(0.0, 0.0), (radius, 0.0), (radius, 0.0), (top, height), (top, height), (0.0, height)]
    return kind, turned_profile(profile, stuff, smooth=False)


def _some_words(rng: Generator, kind: str, recipe: DataRecipe) -> tuple[Words, ...]:
    chosen: list[Words] = []
    suited: Sequence[str] = KINDS[kind][1] if kind in KINDS else ()
    while len(chosen) < recipe.recasts:
        pool = suited if suited and rng.random() < recipe.suited else tuple(VOCABULARY)
        material, color = str(rng.choice(pool)), ""
        if rng.random() < recipe.tinted:
            color = str(rng.choice(tuple(COLORS)))
            if rng.random() < 0.3 and " " not in color:
                color = f"{rng.choice(tuple(SHADES))} {color}"
        words = Words(kind, material, color)
        if words not in chosen:
            chosen.append(words)
    return tuple(chosen)
