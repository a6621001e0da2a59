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
from diga3d_warp.gaussians.lift import LiftSettings
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.pipelines.charting import frame_arrays, frame_of
from diga3d_warp.pipelines.clearing import Masks, MaskSettings, read_masks
from diga3d_warp.pipelines.run import Run, say
from diga3d_warp.pipelines.stages import decide
from diga3d_warp.pipelines.standing import about, find_standing, solid_of
from diga3d_warp.scene.scene import Scene
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
    run: Run, scene: Scene, edit_masks: Masks, source: Gaussians, rows: torch.Tensor,
    lift: LiftSettings, masking: MaskSettings, wish: bool | None, seed: int, *, filled: bool = False,
    besides: Masks | None = None,
) -> Shade:  # fmt: skip
    """Find the shadow of the object, and part masks that hold it.

    Args:
        run: Run folder that receives the stage, the choice and a picture.
        scene: The capture.
        edit_masks: Of all views.
        source: The splat, N gaussians.
        rows: Those of the object, shape (N,).
        lift: Where the object's gaussians are in the way.
        masking: Dilation of the masks.
        wish: Whether the user insists on a shadow.
        seed: Of random choices.
        filled: Whether the user filled views, which show shadows as they should be.
        besides: What else is not the support's own in the views, such as a mirror image; None if nothing is.
    """
    if filled and wish is None:
        decide(
            run,
            Choice(
                "shadow",
                False,
                "not looked for: fills are given, which show shadows as they should be",
                "task",
            ),
        )
    if not run.effects.shadow:
        return Shade(rows, edit_masks, None)
    views = [*scene.views, *scene.test_views]

    def compute(folder: Path) -> None:
        standing = find_standing(run, scene, edit_masks, source, rows, lift, masking, seed, besides)
        support, held, found = standing.support, standing.held, None
        if support is not None:
            found = find_shadow(standing.photos, solid_of(source.select(standing.own)), support, seed)
        choice = choose_shadow(found[1] if found else None, wish)
        parted = choice.value and bool(held.any())
        if found and choice.value:
            shadow, _, chart = found
            arrays = {"ratio": shadow.ratio, "floor": np.array(shadow.floor)}
            write_arrays(folder / "shadow.npz", **arrays, **frame_arrays(shadow.frame))
            write_image(folder / PICTURE, shadow_picture(chart, shadow))
        if parted:
            own = standing.own
            for view in views:
                kept = edit_masks[view.name] & about(source, view.camera, own, lift, masking, run)
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
        edit_masks = read_masks(folder / "masks", views)
    if not choice.value:
        return Shade(rows, edit_masks, None)
    run.publish(folder / PICTURE, PICTURE)
    arrays = read_arrays(folder / "shadow.npz")
    return Shade(rows, edit_masks, Shadow(frame_of(arrays), arrays["ratio"], float(arrays["floor"])))
