"""A scenery with and without the object, with another object and another material, seen from one camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.random import Generator

from diga3d_warp.kernels.raycast import Hits
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.scene import Points
from diga3d_warp.scene.synthetic.gloss import Mirror, level_faces
from diga3d_warp.scene.synthetic.lighting import corner_light
from diga3d_warp.scene.synthetic.rendering import Body, Rays, Textures, camera_rays, cast, developed
from diga3d_warp.scene.synthetic.scenery import Scenery
from diga3d_warp.scene.synthetic.solids import Surface, joined

POINTS_PER_VIEW = 250
"""Sparse points from each view: 24 views give 6000, what COLMAP finds in a small textured room."""

POINT_NOISE = 0.002
"""Deviation of sparse points from the surface [m], that of COLMAP at this distance and resolution."""


@dataclass(frozen=True, eq=False)
class Stage:
    """Surroundings and objects with the light that falls on them in each case.

    Attributes:
        room, object, other_object, other_material: What can be seen.
        room_alone, room_with_object, room_with_other: Tinted light on the surroundings; one array where the
            objects cast no shadows.
        on_object, on_other_object, on_other_material: Tinted light on the objects.
        level: Which faces of the surroundings mirror, shape (F,); None if none does.
        gloss: Reflectance of these, see `gloss.Mirror`.
    """

    room: Body
    object: Body
    other_object: Body
    other_material: Body
    room_alone: wp.array
    room_with_object: wp.array
    room_with_other: wp.array
    on_object: wp.array
    on_other_object: wp.array
    on_other_material: wp.array
    level: np.ndarray | None = None
    gloss: float = 0.0


@dataclass(frozen=True, eq=False)
class Shot:
    """Everything known of one view.

    Attributes:
        image, without_object, other_object, other_material: shape (H, W, 3), uint8 RGB.
        mask: Where the object shows, even in a part of the pixel, shape (H, W), bool.
        depth, depth_without_object: z depth through the pixels' centres [m], shape (H, W), float32.
        points: Surface points under random pixels, with noise, in the pixels' colours.
    """

    image: np.ndarray
    without_object: np.ndarray
    other_object: np.ndarray
    other_material: np.ndarray
    mask: np.ndarray
    depth: np.ndarray
    depth_without_object: np.ndarray
    points: Points


class Lit:
    """What stays of a scenery, and the light in it.

    Args:
        scenery: Surfaces and light.
        things: Surfaces that may stand in it, for their textures.
        seed: Of textures and sampling noise.

    Attributes:
        textures: Of all surfaces.
        body: The surroundings, with the backdrop if there is one.
    """

    def __init__(self, scenery: Scenery, things: Sequence[Surface], seed: int) -> None:
        self._scenery, self._seed = scenery, seed
        room = scenery.surroundings
        backdrop = [] if scenery.backdrop is None else [scenery.backdrop]
        self.textures = Textures(seed, joined([room, *things, *backdrop]).palette)
        seen = joined([room, *backdrop]) if backdrop else room
        # A backdrop shows its texture as it is.
        self._far = np.ones((len(seen.vertices) - len(room.vertices), 3))
        self.body = Body(seen, self.textures)

    def light(self, *things: Surface) -> list[np.ndarray]:
        """Light on the corners of the surroundings, and of the things that then stand in them."""
        parts = [self._scenery.surroundings, *things]
        whole = joined(parts)
        received = corner_light(whole, self.textures.corner_albedo(whole), self._seed, self._scenery.lighting)
        return np.split(received, np.cumsum([len(part.vertices) for part in parts[:-1]]))

    def tinted(self, received: np.ndarray) -> wp.array:
        """Tinted light on the surroundings and the backdrop, from that on the surroundings."""
        return self.body.tinted(np.concatenate([received, self._far]))


def set_stage(scenery: Scenery, seed: int, shadows: bool, gloss: float | None = None) -> Stage:
    """Light a scenery in each of its cases.

    Args:
        scenery: Surfaces and light.
        seed: Of textures and sampling noise.
        shadows: Whether the object darkens and colours its surroundings.
        gloss: Reflectance of the level surfaces at the object's foot; None if they are matte.
    """
    thing, other, recast = scenery.thing, scenery.other_object, scenery.other_material
    lit = Lit(scenery, [thing, other, recast], seed)
    (alone,) = lit.light()
    beside_object, on_object = lit.light(thing)
    beside_other, on_other = lit.light(other)
    object_body, other_body, recast_body = (Body(each, lit.textures) for each in (thing, other, recast))
    room_alone = lit.tinted(alone)
    return Stage(
        room=lit.body,
        object=object_body,
        other_object=other_body,
        other_material=recast_body,
        room_alone=room_alone,
        room_with_object=lit.tinted(beside_object) if shadows else room_alone,
        room_with_other=lit.tinted(beside_other) if shadows else room_alone,
        on_object=object_body.tinted(on_object),
        on_other_object=other_body.tinted(on_other),
        # The same shape in another material: only the object itself changes, not what it sends to the room.
        on_other_material=recast_body.tinted(on_object),
        level=None if gloss is None else _level(lit.body, scenery),
        gloss=gloss or 0.0,
    )


def _level(body: Body, scenery: Scenery) -> np.ndarray:
    """Which faces of the surroundings with their backdrop mirror."""
    level = np.zeros(len(body.mesh.indices) // 3, bool)
    found = level_faces(scenery.surroundings)
    level[: len(found)] = found
    return level


def take(stage: Stage, camera: Camera, supersampling: int, rng: Generator) -> Shot:
    """Render everything that is known of one view.

    Args:
        stage: The lit scenery.
        camera: A pinhole camera inside it.
        supersampling: Rays per pixel and axis.
        rng: Picks the sparse points and their noise.
    """
    shape = (camera.height, camera.width)
    rays = camera_rays(camera, supersampling)
    hits = cast(stage.room, rays)
    behind = hits.distance.numpy()
    alone, with_object, with_other = _colors_by_light(
        stage.room, hits, rays, [stage.room_alone, stage.room_with_object, stage.room_with_other]
    )
    recast = with_object
    if stage.level is not None:
        mirror = Mirror(rays, hits, stage.level, stage.gloss)
        alone, with_object, with_other, recast = _mirrored(stage, mirror, alone, with_object, with_other)
    thing, other = (Front(body, camera, rays, behind) for body in (stage.object, stage.other_object))
    image = developed(thing.over(with_object, stage.object, stage.on_object), shape)

    centers = camera.height * camera.width
    distance = thing.nearest[:centers]
    picked = rng.choice(centers, min(POINTS_PER_VIEW, centers), replace=False)
    along = rays.directions.numpy()[picked].astype(np.float64)
    positions = camera.center + along * distance[picked, None]
    positions += POINT_NOISE * rng.standard_normal(positions.shape)
    return Shot(
        image=image,
        without_object=developed(alone, shape),
        other_object=developed(other.over(with_other, stage.other_object, stage.on_other_object), shape),
        other_material=developed(thing.over(recast, stage.other_material, stage.on_other_material), shape),
        mask=np.any(thing.shown.reshape(-1, *shape), axis=0),
        depth=distance.reshape(shape) * rays.slant,
        depth_without_object=behind[:centers].reshape(shape) * rays.slant,
        points=Points(positions, image.reshape(-1, 3)[picked]),
    )


def take_alone(stage: Stage, camera: Camera, supersampling: int) -> tuple[np.ndarray, np.ndarray]:
    """A view without the object: its image (H, W, 3), uint8 RGB, and z depth (H, W) [m], float32."""
    shape = (camera.height, camera.width)
    rays = camera_rays(camera, supersampling)
    hits = cast(stage.room, rays)
    colors = stage.room.colors(hits, stage.room_alone, rays.spread)
    if stage.level is not None:
        mirror = Mirror(rays, hits, stage.level, stage.gloss)
        below = cast(stage.room, mirror.rays)
        colors = mirror.mixed(colors, stage.room.colors(below, stage.room_alone, rays.spread))
    image = developed(colors, shape)
    return image, hits.distance.numpy()[: camera.height * camera.width].reshape(shape) * rays.slant


def _mirrored(
    stage: Stage, mirror: Mirror, alone: np.ndarray, with_object: np.ndarray, with_other: np.ndarray
) -> list[np.ndarray]:
    """Linear colours of the surroundings with the mirror images in them, each of shape (R, 3).

    Args:
        stage: The lit scenery.
        mirror: Its support.
        alone, with_object, with_other: The surroundings without, by what stands in them.

    Returns:
        Alone, with the object, with the other object, and with the object in the other material.
    """
    hits = cast(stage.room, mirror.rays)
    behind = hits.distance.numpy()
    room, beside_object, beside_other = _colors_by_light(
        stage.room, hits, mirror.rays, [stage.room_alone, stage.room_with_object, stage.room_with_other]
    )
    thing, other = (Front(body, None, mirror.rays, behind) for body in (stage.object, stage.other_object))
    return [
        mirror.mixed(alone, room),
        mirror.mixed(with_object, thing.over(beside_object, stage.object, stage.on_object)),
        mirror.mixed(with_other, other.over(beside_other, stage.other_object, stage.on_other_object)),
        mirror.mixed(with_object, thing.over(beside_object, stage.other_material, stage.on_other_material)),
    ]


class Front:
    """A body in front of what stays.

    Args:
        body: The object.
        camera, rays: Where it is seen from; without the camera all rays may meet it.
        behind: Distance along each ray of what stays, shape (R,).

    Attributes:
        shown: Rays that meet the body first, shape (R,), bool.
        nearest: Distance of what each ray meets first, shape (R,).
    """

    def __init__(self, body: Body, camera: Camera | None, rays: Rays, behind: np.ndarray) -> None:
        rays_there = np.arange(len(behind)) if camera is None else rays.towards(body, camera)
        hits = cast(body, rays.part(rays_there))
        distance = hits.distance.numpy()
        front = distance < behind[rays_there]
        self._hits, self._spread, self._front = hits, rays.spread, front
        self._indices = rays_there[front]
        self.shown = np.zeros(len(behind), bool)
        self.shown[self._indices] = True
        self.nearest = behind.copy()
        self.nearest[self._indices] = distance[front]

    def over(self, background: np.ndarray, body: Body, tinted_light: wp.array) -> np.ndarray:
        """Linear colours of all rays: the body's, or one's of the same shape, where shown; shape (R, 3)."""
        colors = background.copy()
        colors[self._indices] = body.colors(self._hits, tinted_light, self._spread)[self._front]
        return colors


def _colors_by_light(body: Body, hits: Hits, rays: Rays, lights: list[wp.array]) -> list[np.ndarray]:
    """Linear colours of the hits in each light; once for lights that are one array."""
    known: dict[int, np.ndarray] = {}
    for light in lights:
        if id(light) not in known:
            known[id(light)] = body.colors(hits, light, rays.spread)
    return [known[id(light)] for light in lights]
