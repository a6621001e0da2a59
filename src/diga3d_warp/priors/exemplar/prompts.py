"""What prompts mean to the exemplar prior: sets of patches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch

from diga3d_warp.materials.prompt import material_of, words_of
from diga3d_warp.priors.conditioning import Prompts
from diga3d_warp.priors.protocol import Task

EXEMPLAR_SIZE = 256
"""Side of a painted material [px]; it is as large as an object in a photograph, about."""


@dataclass(frozen=True, eq=False)
class PatchPrompt:
    """Where patches come from.

    Attributes:
        part: The part of each view to take: around its mask, or within it. None for `exemplar`.
        exemplar: An image to take, in [0, 1], shape (H, W, 3); None for a part.
    """

    part: Literal["surroundings", "object"] | None = None
    exemplar: torch.Tensor | None = None


SURROUNDINGS = PatchPrompt("surroundings")
OBJECT = PatchPrompt("object")


def prompts_of(positive: str, negative: str, task: Task) -> Prompts:
    """Patches of the positive and the negative prompt (Tp and Tn of the paper).

    A removal goes on with the surroundings, whatever the positive prompt says, and away from the object if
    there is a negative one. The other tasks go towards the material that the positive prompt names, away from
    that of the negative one or, without one, from the object as it is.

    Raises:
        InputError: a prompt names no material, denies one, or is empty or too long where one is needed.
    """
    if task == "remove":
        if negative:
            words_of(negative)
        return Prompts(SURROUNDINGS, OBJECT if negative else SURROUNDINGS)
    return Prompts(_material(positive), _material(negative) if negative else OBJECT)


def _material(prompt: str) -> PatchPrompt:
    picture: np.ndarray = material_of(prompt).exemplar(EXEMPLAR_SIZE, 0)
    return PatchPrompt(exemplar=torch.from_numpy(picture))
