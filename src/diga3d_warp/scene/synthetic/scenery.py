"""What a synthetic capture shows: everything that stays, the object, and what may take its place."""

from __future__ import annotations

from dataclasses import dataclass

from diga3d_warp.scene.synthetic.lighting import LIGHTING, Lighting
from diga3d_warp.scene.synthetic.solids import Surface


@dataclass(frozen=True, eq=False)
class Scenery:
    """Surfaces and light.

    Attributes:
        surroundings: Everything that stays.
        thing: The object.
        other_object: What may stand in its place.
        other_material: The object's own shape in another material.
        lighting: Lamp and sky.
        backdrop: What is seen far away and neither casts shadows nor receives light, such as a sky; None
            where walls close the view.
    """

    surroundings: Surface
    thing: Surface
    other_object: Surface
    other_material: Surface
    lighting: Lighting = LIGHTING
    backdrop: Surface | None = None
