"""The edits by text that are compared, and what the generator knows of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from diga3d_warp.bench.room import SETTINGS
from diga3d_warp.errors import InputError
from diga3d_warp.files import read_json
from diga3d_warp.objects.picture import chosen_material
from diga3d_warp.objects.solids import solid_of
from diga3d_warp.pipelines.method import PAPER, WARPED, Method
from diga3d_warp.pipelines.remove import RemoveSettings
from diga3d_warp.pipelines.replace import GROW, SETTLE, ReplaceSettings
from diga3d_warp.pipelines.retexture import RECOLOUR, RetextureSettings

Task = Literal["retexture", "replace"]

TRUTHS: Mapping[Task, str] = {"retexture": "other_material", "replace": "other_object"}
"""Folder of the generator's images that show the edit."""

UNEDITED = "nothing edited"
BUILT_IN = "built-in words"


def methods_of(prior: str) -> dict[str, Method]:
    """Methods by name. The built-in words need no network: the first is painted, or placed as a solid.

    Args:
        prior: As `priors.named.load_prior` takes it.
    """
    full = replace(PAPER, surfaces=False)
    return {
        BUILT_IN: WARPED,
        prior: full,
        f"{prior}, without TG-SDS": replace(full, distillation=None),
        f"{prior}, without AFP": replace(full, propagation="none", distillation=None),
        f"{prior}, from noise": replace(full, inversion="none", distillation=None),
    }


@dataclass(frozen=True)
class Prompts:
    """The prompts of a synthetic capture, as its captions say what its truths show.

    Attributes:
        retexture: The object in its other material, as in "a steel bucket".
        replace: The other object, as in "a cork parcel".
    """

    retexture: str
    replace: str

    @classmethod
    def of(cls, capture: Path) -> Prompts:
        """From the captions of a generated capture; all end in the words of its surroundings."""
        captions = read_json(capture / "captions.json", "generate the capture again")
        place = captions["images"].removeprefix(captions["object"])
        return cls(*(captions[name].removesuffix(place) for name in TRUTHS.values()))


def settings_of(task: Task, method: Method, removal: RemoveSettings = SETTINGS) -> object:
    """Settings of one edit, with the iterations of a removal's fits.

    Args:
        task: Which.
        method: The method.
        removal: Gives fit, refit and fine stage.
    """
    iterations = removal.refit.iterations
    if task == "retexture":
        return RetextureSettings(
            fit=removal.fit,
            refit=replace(RECOLOUR, iterations=iterations),
            distil=removal.distil,
            method=method,
        )
    return ReplaceSettings(
        removal=replace(removal, method=method),
        settle=replace(SETTLE, iterations=iterations),
        grow=replace(GROW, iterations=iterations),
    )


def knows(task: Task, prompt: str) -> bool:
    """Whether the built-in words understand a prompt."""
    try:
        if task == "retexture":
            chosen_material(prompt, None)
        else:
            solid_of(prompt, seed=0)
    except InputError:
        return False
    return True
