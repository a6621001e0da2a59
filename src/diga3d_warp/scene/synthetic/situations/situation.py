"""A situation: what is seen, from where, and its captions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from diga3d_warp.scene.synthetic.lighting import Lighting
from diga3d_warp.scene.synthetic.orbit import Orbit
from diga3d_warp.scene.synthetic.scenery import Scenery
from diga3d_warp.scene.synthetic.situations.things import Thing
from diga3d_warp.scene.synthetic.solids import Surface


@dataclass(frozen=True)
class Captions:
    """What the images of a capture show, in words.

    Attributes:
        object: The object, as in "a walnut stool".
        material: Its material, a name that a prompt may use.
        images, without_object, other_object, other_material: The images in the folders of these names.
    """

    object: str
    material: str
    images: str
    without_object: str
    other_object: str
    other_material: str


@dataclass(frozen=True, eq=False)
class Situation:
    """An object in its surroundings.

    Attributes:
        scenery: Surfaces and light; the object stands at the origin, z up, metres.
        orbit: Where cameras stand.
        captions: What the images show.
    """

    scenery: Scenery
    orbit: Orbit
    captions: Captions

    @classmethod
    def of(
        cls,
        things: tuple[Thing, Thing, Thing],
        surroundings: Surface,
        place: str,
        orbit: Orbit,
        lighting: Lighting,
        backdrop: Surface | None = None,
        *,
        stands: str = "on",
    ) -> Situation:
        """Put it together.

        Args:
            things: The object, the same shape in another material, and another object.
            surroundings: Everything that stays.
            place: What a caption says of it, as in "a red rug on an oak floor".
            orbit: Where cameras stand.
            lighting: Lamp and sky.
            backdrop: A sky, where one is seen.
            stands: Where the object is with respect to the place: "on", "in", "in front of".
        """
        thing, recast, other = things
        scenery = Scenery(surroundings, thing.surface, other.surface, recast.surface, lighting, backdrop)
        captions = Captions(
            object=thing.caption,
            material=thing.material,
            images=f"{thing.caption} {stands} {place}",
            without_object=place,
            other_object=f"{other.caption} {stands} {place}",
            other_material=f"{recast.caption} {stands} {place}",
        )
        return cls(scenery, orbit, captions)


def distance_to_cover(thing: Thing, share: float, field_of_view: float) -> float:
    """From where an object's box, seen 30 degrees from above, covers a share of an image of 4 x 3 [m].

    Args:
        thing: The object.
        share: Of the image's pixels [1].
        field_of_view: Horizontal [degrees].
    """
    x, y, height = thing.size
    front, top = np.cos(np.radians(30)) * 0.5 * (x + y) * height, np.sin(np.radians(30)) * x * y
    focal = 0.5 / np.tan(np.radians(field_of_view / 2))  # in widths of the image
    return float(focal * np.sqrt(4 / 3 * (front + 0.7 * top) / share))
