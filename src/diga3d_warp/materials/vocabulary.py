"""The vocabulary: materials that a prompt may name, without any learned weights."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from diga3d_warp.materials import crafted, masonry, metal, nature, soft, stone, wood
from diga3d_warp.materials.tint import Tint

Painter = Callable[[Generator, int], np.ndarray]
"""A random generator and a side [texels] to a seamless texture, display values, shape (side, side, 3)."""


@dataclass(frozen=True)
class Material:
    """One entry of the vocabulary.

    Attributes:
        name: As a prompt names it.
        painter: Paints its texture, upright: v runs downwards on an object.
        also: Other words for it.
        polish: How much of its look is a mirror image, from 0 for none to 1 [1]: see `objects.sheen`.
        tint: The colour that a prompt asks for; None for its own.
        notes: Assumptions made in reading the prompt or picture, one line each.
    """

    name: str
    painter: Painter
    also: tuple[str, ...] = ()
    polish: float = 0.0
    tint: Tint | None = None
    notes: tuple[str, ...] = ()

    def exemplar(self, size: int, seed: int) -> np.ndarray:
        """A seamless picture of the material in display values, shape (size, size, 3), float32 in [0, 1].

        Args:
            size: Edge [texels].
            seed: Same size and seed, same picture.
        """
        rng = np.random.default_rng([seed, *self.name.encode()])
        texture = np.clip(self.painter(rng, size), 0.0, 1.0).astype(np.float32)
        return texture if self.tint is None else self.tint.on(texture)


def _upright(painter: Painter) -> Painter:
    """The same material with its u along v: things stand along their fibres."""
    return lambda rng, side: painter(rng, side).swapaxes(0, 1)


MATERIALS: dict[str, Material] = {
    material.name: material
    for material in (
        Material("wood", _upright(wood.oak), ("wooden", "oak", "timber")),
        Material("walnut", _upright(wood.walnut), ("mahogany", "dark wood")),
        Material("planks", _upright(wood.planks), ("boards", "parquet")),
        Material("bamboo", wood.bamboo),
        Material("bark", wood.bark, ("tree bark",)),
        Material("cork", wood.cork),
        Material("wicker", wood.wicker, ("rattan", "basket")),
        Material("marble", stone.marble, ("white marble",)),
        Material("black marble", stone.black_marble, ("dark marble",)),
        Material("granite", stone.granite),
        Material("slate", stone.slate),
        Material("sandstone", stone.sandstone),
        Material("terrazzo", stone.terrazzo),
        Material("jade", stone.jade),
        Material("malachite", stone.malachite),
        Material("lapis lazuli", stone.lapis, ("lapis",)),
        Material("pebbles", stone.pebbles, ("pebble", "gravel")),
        Material("brick", masonry.bricks, ("bricks",)),
        Material("concrete", masonry.concrete, ("cement",)),
        Material("plaster", masonry.plaster, ("stucco",)),
        Material("terracotta", masonry.terracotta, ("clay",)),
        Material("tiles", masonry.tiles, ("tiled", "tile")),
        Material("mosaic", masonry.mosaic),
        Material("cobblestone", masonry.cobbles, ("cobblestones", "stone", "cobbles")),
        Material("gold", metal.hammered_gold, ("golden", "gilded"), polish=1.0),
        Material("silver", metal.silver, ("silvery",), polish=1.0),
        Material("copper", metal.copper, polish=1.0),
        Material("bronze", metal.bronze, ("brass",), polish=0.5),
        Material("steel", metal.steel, ("metal", "metallic", "iron", "chrome"), polish=0.7),
        Material("rust", metal.rust, ("rusty", "rusted")),
        Material("denim", soft.denim, ("jeans",)),
        Material("linen", soft.linen, ("canvas", "burlap")),
        Material("knitted wool", soft.knit, ("wool", "woollen", "woolen", "knitted", "knit")),
        Material("tartan", soft.tartan, ("plaid",)),
        Material("velvet", soft.velvet),
        Material("leather", soft.leather),
        Material("snakeskin", soft.snakeskin, ("scales", "scaly")),
        Material("grass", nature.grass, ("grassy", "lawn")),
        Material("moss", nature.moss, ("mossy",)),
        Material("leaf", nature.leaf, ("leaves", "leafy")),
        Material("sand", nature.sand, ("sandy",)),
        Material("snow", nature.snow, ("snowy",)),
        Material("ice", nature.ice, ("icy", "frozen")),
        Material("lava", nature.lava, ("magma", "molten")),
        Material("porcelain", crafted.porcelain, ("china", "ceramic")),
        Material("paper", crafted.paper),
        Material("chocolate", crafted.chocolate),
        Material("camouflage", crafted.camouflage, ("camo",)),
        Material("checkerboard", crafted.checkerboard, ("checkered", "chequered")),
        Material("polka dots", crafted.polka_dots, ("polka dot", "dotted")),
    )
}
"""The vocabulary by name, kin beside kin."""
