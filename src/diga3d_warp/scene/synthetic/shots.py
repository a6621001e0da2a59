"""The room with and without the object, with another object and another material, seen from one camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.random import Generator

from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.scene import Points
from diga3d_warp.scene.synthetic.lighting import corner_light
from diga3d_warp.scene.synthetic.rendering import Body, Textures, camera_rays, cast, developed
from diga3d_warp.scene.synthetic.room import furnished_room, golden_ball, vase
from diga3d_warp.scene.synthetic.solids import Surface, joined

POINTS_PER_VIEW = 250
"""Sparse points from each view: 24 views give 6000, what COLMAP finds in a small textured room."""

POINT_NOISE = 0.002
"""Deviation of sparse points from the surface [m], that of COLMAP at this distance and resolution."""


@dataclass(frozen=True, eq=False)
class Stage:
    """Room and objects with the light that falls on them in each case.

    Attributes:
        room, object, other_object, other_material: What can be seen.
        room_alone, room_with_object, room_with_other: Tinted light on the room.
        on_object, on_other_object, on_other_material: Tinted light on the objects.
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


def set_stage(seed: int, shadows: bool) -> Stage:
    """Build and light the room and its objects.

    Args:
        seed: Of textures, small things and sampling noise.
        shadows: Whether the object darkens and colours the room.
    """
    textures = Textures(seed)
    room, thing, other, marble = furnished_room(seed), vase(), golden_ball(), vase("marble")

    def light(*parts: Surface) -> list[np.ndarray]:
        whole = joined(parts)
        received = corner_light(whole, textures.corner_albedo(whole), seed)
        return np.split(received, np.cumsum([len(part.vertices) for part in parts[:-1]]))

    alone = light(room)[0]
    beside_object, on_object = light(room, thing)
    beside_other, on_other = light(room, other)
    if not shadows:
        beside_object = beside_other = alone
    room_body, marble_body = Body(room, textures), Body(marble, textures)
    object_body, other_body = Body(thing, textures), Body(other, textures)
    return Stage(
        room=room_body,
        object=object_body,
        other_object=other_body,
        other_material=marble_body,
        room_alone=room_body.tinted(alone),
        room_with_object=room_body.tinted(beside_object),
        room_with_other=room_body.tinted(beside_other),
        on_object=object_body.tinted(on_object),
        on_other_object=other_body.tinted(on_other),
        # The same shape in another material: only the object itself changes, not what it sends to the room.
        on_other_material=marble_body.tinted(on_object),
    )


def take(stage: Stage, camera: Camera, supersampling: int, rng: Generator) -> Shot:
    """Render everything that is known of one view.

    Args:
        stage: The lit room.
        camera: A pinhole camera inside it.
        supersampling: Rays per pixel and axis.
        rng: Picks the sparse points and their noise.
    """
    shape = (camera.height, camera.width)
    rays = camera_rays(camera, supersampling)
    room, thing, other = (cast(body, rays) for body in (stage.room, stage.object, stage.other_object))
    behind = room.distance.numpy()
    front, other_front = thing.distance.numpy() < behind, other.distance.numpy() < behind

    def picture(shown: np.ndarray, foreground: np.ndarray, room_light: wp.array) -> np.ndarray:
        background = stage.room.colors(room, room_light, rays.spread)
        return developed(np.where(shown[:, None], foreground, background), shape)

    porcelain = stage.object.colors(thing, stage.on_object, rays.spread)
    marble = stage.other_material.colors(thing, stage.on_other_material, rays.spread)
    gold = stage.other_object.colors(other, stage.on_other_object, rays.spread)
    image = picture(front, porcelain, stage.room_with_object)

    centers = camera.height * camera.width
    distance = np.minimum(behind, thing.distance.numpy())[:centers]
    picked = rng.choice(centers, min(POINTS_PER_VIEW, centers), replace=False)
    along = rays.directions.numpy()[picked].astype(np.float64)
    positions = camera.center + along * distance[picked, None]
    positions += POINT_NOISE * rng.standard_normal(positions.shape)
    return Shot(
        image=image,
        without_object=developed(stage.room.colors(room, stage.room_alone, rays.spread), shape),
        other_object=picture(other_front, gold, stage.room_with_other),
        other_material=picture(front, marble, stage.room_with_object),
        mask=front.reshape(-1, *shape).any(0),
        depth=distance.reshape(shape) * rays.slant,
        depth_without_object=behind[:centers].reshape(shape) * rays.slant,
        points=Points(positions, image.reshape(-1, 3)[picked]),
    )
