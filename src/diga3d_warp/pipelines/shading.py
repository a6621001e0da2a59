"""The stage that finds the shadow of the object on its support."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TypedDict

import numpy as np
import torch

from diga3d_warp.effects.plan import Choice
from diga3d_warp.effects.shadow import choose_shadow
from diga3d_warp.files import write_array, write_arrays, write_image, write_json
from diga3d_warp.pipelines.charting import frame_arrays, frame_of
from diga3d_warp.pipelines.clearing import Masks, read_masks
from diga3d_warp.pipelines.run import say
from diga3d_warp.pipelines.stages import decide
from diga3d_warp.pipelines.standing import Masked, solid_of
from diga3d_warp.shadows.find import Shadow, find_shadow
from diga3d_warp.shadows.picture import shadow_picture
from diga3d_warp.state import read_array, read_arrays, read_state

PICTURE = "shadow.png"
"""The support before and after, and the share of the light between, in the run folder."""


class ShadeRecord(TypedDict):
    """What was found.

    Attributes:
        choice: As `effects.plan.Choice`.
        masked: Whether masks held the shadow.
    """

    choice: dict
    masked: bool


@dataclass(frozen=True, eq=False)
class Shade:
    """What goes with the object besides its gaussians.

    Attributes:
        rows: The object's gaussians, without support that masks held with the shadow, shape (N,), bool.
        edit_masks: Edit masks of all views, without that support.
        shadow: The shadow; None if the object casts none that shows.
    """

    rows: torch.Tensor
    edit_masks: Masks
    shadow: Shadow | None


def find_shade(
    masked: Masked, wish: bool | None, *, filled: bool = False, image: Masks | None = None
) -> Shade:
    """Find the shadow of the object, and part masks that hold it.

    Args:
        masked: The object. Its run folder receives the stage, the choice and a picture.
        wish: Whether the user insists on a shadow.
        filled: Whether the user filled views, which show shadows as they should be.
        image: Where views show the object's mirror image; None if they show none.
    """
    run, rows, edit_masks = masked.run, masked.rows, masked.edit_masks
    if filled and wish is None:
        said = "not looked for: fills are given, which show shadows as they should be"
        decide(run, Choice("shadow", False, said, "task"))
    if not run.effects.shadow:
        return Shade(rows, edit_masks, None)

    def compute(folder: Path) -> None:
        standing = masked.standing if image is None else masked.standing_beside(image)
        support, held, found = standing.support, standing.held, None
        if support is not None:
            found = find_shadow(
                standing.photos, solid_of(masked.source.select(standing.own)), support, masked.seed
            )
        choice = choose_shadow(found[1] if found else None, wish)
        parted = choice.value and bool(held.any())
        if found and choice.value:
            shadow, _, chart = found
            arrays = {"ratio": shadow.ratio, "floor": np.array(shadow.floor)}
            write_arrays(folder / "shadow.npz", **arrays, **frame_arrays(shadow.frame))
            write_image(folder / PICTURE, shadow_picture(chart, shadow))
        if parted:
            own = standing.own
            for view in masked.views:
                kept = edit_masks[view.name] & masked.about(own, view.camera)
                write_image(folder / "masks" / f"{view.name}.png", kept)
            write_array(folder / "object.npy", own)
        write_json(folder / "shade.json", {"choice": asdict(choice), "masked": parted})

    folder = run.stage("shadow", compute)
    record = read_state(folder / "shade.json", ShadeRecord)
    choice = Choice(**record["choice"])
    decide(run, choice)
    say(f"shadow: {'relit' if choice.value else 'none'} ({choice.evidence})")
    if record["masked"]:
        run.note("the masks hold the object's shadow: it is relit, and only the object itself is taken out")
        rows = torch.from_numpy(read_array(folder / "object.npy"))
        edit_masks = read_masks(folder / "masks", masked.views)
    if not choice.value:
        return Shade(rows, edit_masks, None)
    run.publish(folder / PICTURE, PICTURE)
    arrays = read_arrays(folder / "shadow.npz")
    return Shade(rows, edit_masks, Shadow(frame_of(arrays), arrays["ratio"], float(arrays["floor"])))
