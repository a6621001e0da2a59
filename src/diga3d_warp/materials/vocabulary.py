"""The vocabulary: materials that a prompt may name, without any learned weights."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from diga3d_warp.errors import InputError
from diga3d_warp.materials import crafted, masonry, metal, nature, soft, stone, wood

PROMPT_MOST = 1000
"""Longest prompt [characters]. The text encoder of Stable Diffusion reads 77 tokens, about 300 characters."""

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
    """

    name: str
    painter: Painter
    also: tuple[str, ...] = ()
    polish: float = 0.0

    def exemplar(self, size: int, seed: int) -> np.ndarray:
        """A seamless picture of the material in display values, shape (size, size, 3), float32 in [0, 1].

        Args:
            size: Edge [texels].
            seed: Same size and seed, same picture.
        """
        rng = np.random.default_rng([seed, *self.name.encode()])
        return np.clip(self.painter(rng, size), 0.0, 1.0).astype(np.float32)


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

_BY_WORDS = {words: material for material in MATERIALS.values() for words in (material.name, *material.also)}


def words_of(prompt: str) -> list[str]:
    """The words of a prompt in lower case.

    Raises:
        InputError: the prompt holds no word, or more than `PROMPT_MOST` characters.
    """
    if len(prompt) > PROMPT_MOST:
        raise InputError(f"the prompt has {len(prompt)} characters: give at most {PROMPT_MOST}")
    words = re.findall(r"\w+", prompt.lower())
    if not words:
        raise InputError('the prompt is empty: give one such as --prompt "white marble"')
    return words


def first_named(words: list[str], names: dict[str, Material]) -> Material | None:
    """The entry that is named first; of several that begin with one word, the longest name."""
    for start in range(len(words)):
        for length in (3, 2, 1):
            found = names.get(" ".join(words[start : start + length]))
            if found is not None:
                return found
    return None


def material_of(prompt: str) -> Material:
    """The material that a prompt names: the first one, "black marble" before "marble".

    Raises:
        InputError: the prompt is empty or too long, or names no material of the vocabulary.
    """
    found = first_named(words_of(prompt), _BY_WORDS)
    if found is None:
        shown = prompt if len(prompt) <= 60 else prompt[:57] + "..."
        raise InputError(
            f"the prompt {shown!r} names no built-in material: use one of {', '.join(MATERIALS)}; "
            "for free text use --prior sd-inpainting or --prior powerpaint"
        )
    return found
