"""The stage that finds the mirror image of the object in its support."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TypedDict

import numpy as np
import torch

from diga3d_warp.effects.mirror import choose_mirror
from diga3d_warp.effects.plan import Choice
from diga3d_warp.files import write_array, write_image, write_json
from diga3d_warp.gaussians.lift import vote
from diga3d_warp.mirrors.find import Mirror, find_mirror
from diga3d_warp.mirrors.masks import mirror_mask, mirrored_rows
from diga3d_warp.mirrors.picture import mirror_picture
from diga3d_warp.mirrors.reflection import Placing, Reflection, reflection
from diga3d_warp.pipelines.clearing import Masks, read_masks, widened
from diga3d_warp.pipelines.run import say
from diga3d_warp.pipelines.stages import decide
from diga3d_warp.pipelines.standing import Masked, solid_of
from diga3d_warp.splatting.render import render
from diga3d_warp.state import read_array, read_state

STAGE, PICTURE = "mirror", "mirror.png"
"""The stage, and in the run folder a photograph with the mirror image marked."""


class MirrorRecord(TypedDict):
    """What was found: `choice` is an `effects.plan.Choice`."""

    choice: dict


@dataclass(frozen=True, eq=False)
class Image:
    """The mirror image of the object.

    Attributes:
        masks: Where views show it, of all views.
        rows: Gaussians under the support that stand for it, shape (N,), bool.
    """

    masks: Masks
    rows: torch.Tensor

    def with_object(self, edit_masks: Masks) -> Masks:
        """Edit masks of the object and its mirror image."""
        return {name: mask | self.masks[name] for name, mask in edit_masks.items()}


def find_image(masked: Masked, wish: bool | None, *, filled: bool = False) -> Image | None:
    """Find the mirror image of the object; None if its support shows none.

    Args:
        masked: The object. Its run folder receives the stage, the choice and a picture.
        wish: Whether the user insists on a mirror image.
        filled: Whether the user filled views, which show it or not as they should.
    """
    run, source = masked.run, masked.source
    if filled and wish is None:
        said = "not looked for: fills are given, which show mirror images as they should be"
        decide(run, Choice("mirror", False, said, "task"))
    if not run.effects.mirror:
        return None

    def compute(folder: Path) -> None:
        standing = masked.standing
        support, own, found = standing.support, source.select(standing.own), None
        if support is not None:
            frame = support.frame

            def reflect(placing: Placing) -> Sequence[Reflection]:
                cameras = [photo.camera for photo in standing.photos]
                return [reflection(own, camera, frame, run.effects, placing) for camera in cameras]

            found = find_mirror(standing.photos, solid_of(own), support, reflect)
        choice = choose_mirror(found[1] if found else None, wish)
        if found and choice.value:
            _write_image(folder, masked, standing.own, found[0])
        write_json(folder / "mirror.json", {"choice": asdict(choice)})

    folder = run.stage(STAGE, compute)
    choice = Choice(**read_state(folder / "mirror.json", MirrorRecord)["choice"])
    decide(run, choice)
    say(f"mirror image: {'taken out' if choice.value else 'none'} ({choice.evidence})")
    if not choice.value:
        return None
    run.note(f"the support mirrors the object: its image is taken out, too ({PICTURE} shows it)")
    run.publish(folder / PICTURE, PICTURE)
    image = read_masks(folder / "image", masked.views)
    return Image(image, torch.from_numpy(read_array(folder / "rows.npy")))


def _write_image(folder: Path, masked: Masked, own: torch.Tensor, mirror: Mirror) -> None:
    """Masks of the mirror image in all views, its gaussians, and a picture of it."""
    run, source, edit_masks = masked.run, masked.source, masked.edit_masks
    thing, left = source.select(own), source.select(~masked.rows)
    found: dict[str, np.ndarray] = {}
    most = 0
    for view in masked.views:
        image = reflection(thing, view.camera, mirror.frame, run.effects)
        with torch.no_grad():
            depth = render(left, view.camera, effects=replace(run.effects, depth=True)).depth.numpy()
        mask = mirror_mask(mirror, image, view.camera, depth)
        found[view.name] = widened(mask, masked.masking) if mask.any() else mask
        write_image(folder / "image" / f"{view.name}.png", found[view.name])
        write_image(folder / "masks" / f"{view.name}.png", found[view.name] | edit_masks[view.name])
        shown = int((mask & ~edit_masks[view.name]).sum())
        if shown >= most:
            most = shown
            write_image(folder / PICTURE, mirror_picture(view.pixels, image, mask & ~edit_masks[view.name]))
    views = masked.scene.views
    votes = vote(left, [view.camera for view in views], [found[view.name] for view in views], run.effects)
    under = torch.zeros_like(masked.rows)
    under[~masked.rows] = mirrored_rows(left, mirror, votes, masked.lift)
    write_array(folder / "rows.npy", under)
