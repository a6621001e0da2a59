"""Prompts of what an image shows, from short to long."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.random import Generator

from diga3d_warp.materials.tint import COLORS, SHADES
from diga3d_warp.materials.vocabulary import MATERIALS
from diga3d_warp.scene.synthetic.situations.catalogue import build_situation
from diga3d_warp.scene.synthetic.situations.things import ADJECTIVES, KINDS, with_article
from training.recipe import DataRecipe, PromptRecipe
from training.rooms import PLACES, PLAIN, ROOM, ROOM_PLACE

ALSO: Mapping[str, Sequence[str]] = {
    "cube": ("box", "block"),
    "sphere": ("ball", "globe", "orb"),
    "ball": ("sphere",),
    "cylinder": ("column", "pillar"),
    "vase": ("jar", "pot"),
    "stack of books": ("books",),
}
"""Other words for shapes."""

JOINING = ("a", "an", "the", "of", "made", "on", "in", "at", "front", "with", "and", "behind")


def prompt_of(rng: Generator, row: Mapping[str, Any], recipe: PromptRecipe) -> str:
    """A prompt of an image; often none for a room alone, so that guidance has something to lead away from.

    Args:
        rng: Picks the form and the words.
        row: Of the image, from the store of windows.
        recipe: Shares of the forms.
    """
    if row["thing"] is None:
        return "" if rng.random() < recipe.unsaid_places else row["place"]
    color, material, kind = row["words"]
    forms = (MATERIALS[material].name, ADJECTIVES.get(material, material), *MATERIALS[material].also)
    weights = np.array([0.3, 0.4, *[0.3 / max(1, len(forms) - 2)] * (len(forms) - 2)])
    stuff = f"{color} {rng.choice(forms, p=weights / weights.sum())}".strip()
    if kind in ALSO and rng.random() < recipe.synonyms:
        kind = str(rng.choice(ALSO[kind]))
    thing = with_article(f"{stuff} {kind}")
    full = f"{thing} {row['stands']} {row['place']}"
    said = (full, thing, f"{with_article(kind)} made of {stuff}", stuff, with_article(kind))
    return str(rng.choice(said, p=recipe.forms))


def caption_of(row: Mapping[str, Any]) -> str:
    """The object of an image, as in "a dark green marble vase"."""
    color, material, kind = row["words"]
    return with_article(f"{color} {ADJECTIVES.get(material, material)} {kind}".strip())


def vocabulary(recipe: DataRecipe, seeds: int = 400) -> list[str]:
    """Every word that a prompt of the training may hold, sorted.

    Args:
        recipe: Its first seed.
        seeds: Rooms whose places are read; more hold no new words.
    """
    texts = [ROOM_PLACE, *JOINING, *KINDS, *PLAIN, *COLORS, *SHADES, *ADJECTIVES.values()]
    texts += [word for words in ALSO.values() for word in words]
    texts += [text for entry in MATERIALS.values() for text in (entry.name, *entry.also)]
    for seed in range(recipe.first_seed, recipe.first_seed + seeds):
        place = PLACES[seed % len(PLACES)]
        if place != ROOM:
            texts.append(build_situation(place, seed).captions.images)
    return sorted(set(re.findall(r"[a-z]+", " ".join(texts).lower())))
