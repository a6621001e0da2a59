"""Stages that clear the object: masks lifted to gaussians, gaussians deleted, background behind observed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.files import to_bytes, write_array, write_image, write_json
from diga3d_warp.gaussians.lift import LiftSettings, divided, lies_elsewhere, object_mask, object_rows, vote
from diga3d_warp.gaussians.representation import Representation
from diga3d_warp.gaussians.storage import load
from diga3d_warp.pipelines.run import Run
from diga3d_warp.pipelines.stages import LIFT
from diga3d_warp.propagation.unseen import Background, observe_behind
from diga3d_warp.scene.photographs.names import listed
from diga3d_warp.scene.scene import Scene, View
from diga3d_warp.shadows.find import Shadow
from diga3d_warp.shadows.relight import relit_gaussians, relit_view, shaded_in
from diga3d_warp.splatting.render import render
from diga3d_warp.state import read_array, read_mask, read_picture, read_plane


@dataclass(frozen=True)
class MaskSettings:
    """Dilation of the masks before anything is filled.

    Attributes:
        dilation: Radius [image diagonals]. Masks seldom reach the object's very rim, and splats reach over
            it. SPIn-NeRF: five times 5 x 5, 10 px at a diagonal of 1157 px; here a little more, against the
            halo of fitted splats.
    """

    dilation: float = 0.012


Masks = Mapping[str, np.ndarray]
"""Masks by the name of their view, shape (H, W), bool. Of an object mask, True is where the object is; of an
edit mask, where the view may be changed: the object mask, widened."""


@dataclass(frozen=True, eq=False)
class Cleared:
    """The scene with the object's gaussians taken out.

    Attributes:
        gaussians: What is left.
        free: Rows that show within the edit masks and may change when the hole is filled, shape (N,).
    """

    gaussians: Representation
    free: torch.Tensor

    def held(self, count: int) -> torch.Tensor:
        """Mask of the rows that keep their values while the hole is filled, of `count` gaussians."""
        return torch.nn.functional.pad(~self.free, (0, count - len(self.free)))


def lift_object(
    run: Run, scene: Scene, object_masks: Masks, source: Representation, settings: LiftSettings,
    masking: MaskSettings,
) -> tuple[Representation, torch.Tensor, Masks]:  # fmt: skip
    """Lift object masks to the object's gaussians, and widen them.

    Args:
        run: Run folder that receives the stage.
        scene: The capture.
        object_masks: Of some views or all; of those in training, at least one. Views without one get one from
            the object's gaussians.
        source: The splat, N gaussians or anchors.
        settings: Thresholds for assigning a gaussian to the object.
        masking: Dilation of the masks.

    Returns:
        The splat, whose anchors are divided where only some of their gaussians are the object's; which rows
        of it are, shape (N,), bool; and the edit masks of all views.

    Raises:
        InputError: the masks lift to no gaussian or to all of them.
    """

    def compute(folder: Path) -> None:
        masked = [view for view in scene.views if view.name in object_masks]
        cameras, masks = [view.camera for view in masked], [object_masks[view.name] for view in masked]
        parted = divided(source, cameras, masks, settings, run.effects)
        votes = vote(parted, cameras, masks, run.effects)
        rows = object_rows(votes, settings)
        if not rows.any():
            raise InputError(
                f"{scene.path}: the masks lift to no gaussian; do they belong to these images? The object "
                "may also be too small or thin: try more --iterations"
            )
        if rows[votes.total > settings.faint].all():
            raise InputError(f"{scene.path}: the masks lift to every gaussian seen; mask the object only")
        elsewhere = []
        for view in [*scene.views, *scene.test_views]:
            shown = object_mask(parted, view.camera, rows, settings, run.effects)
            mask = object_masks.get(view.name, shown)
            if lies_elsewhere(mask, shown, settings):
                elsewhere.append(view.name)
            write_image(folder / "masks" / f"{view.name}.png", widened(mask, masking))
        if elsewhere:
            run.note(
                f"the masks of {len(elsewhere)} views do not lie on the object that all masks together mark: "
                f"{listed(elsewhere)}; do they belong to these photographs?"
            )
        write_array(folder / "object.npy", rows)
        if parted is not source:
            parted.save(folder)

    folder = run.stage(LIFT, compute)
    if source.slots > 1:
        source = load(folder)
    edit_masks = read_masks(folder / "masks", [*scene.views, *scene.test_views])
    return source, torch.from_numpy(read_array(folder / "object.npy")), edit_masks


def read_masks(folder: Path, views: Sequence[View]) -> Masks:
    """The masks of views from a stage's folder."""
    return {view.name: read_mask(folder / f"{view.name}.png") for view in views}


def clear_object(
    run: Run, views: Sequence[View], edit_masks: Masks, source: Representation, rows: torch.Tensor,
    settings: LiftSettings, shadow: Shadow | None = None,
) -> Cleared:  # fmt: skip
    """Delete the object's gaussians, and take its shadow from the others.

    Args:
        run: Run folder that receives the stage.
        views: Training views.
        edit_masks: Of these views.
        source: N gaussians or anchors.
        rows: Those of the object, shape (N,).
        settings: Which of the others may change.
        shadow: Of the object; None if it casts none.
    """

    def compute(folder: Path) -> None:
        left: Representation = source.select(~rows)
        masks = [edit_masks[view.name] for view in views]
        near = vote(left, [view.camera for view in views], masks, run.effects)
        free = near.share > settings.free_share
        if shadow is not None:
            left, relit = relit_gaussians(left, shadow)
            free |= relit
        left.save(folder, antialiased=run.effects.antialias)
        write_array(folder / "free.npy", free)
        write_json(folder / "counts.json", {"object": int(rows.sum()), "left": int((~rows).sum())})

    folder = run.stage("clear", compute)
    free = torch.from_numpy(read_array(folder / "free.npy"))
    return Cleared(load(folder), free)


@dataclass(frozen=True, eq=False)
class Behind:
    """What is known behind the object.

    Attributes:
        views: Training views, in full light where the object's shadow was.
        backgrounds: What other views observed behind the object, one per view.
        depths: z of the cleared scene, one per view [scene units], shape (H, W); 0 where it shows nothing.
        changed: Masks of all that is edited, of training and other views.
        masks: The stage that made these.
    """

    views: list[View]
    backgrounds: list[Background]
    depths: list[np.ndarray]
    changed: Masks
    masks: str


def look_behind(
    run: Run, views: Sequence[View], edit_masks: Masks, cleared: Cleared, others: Sequence[View] = (),
    shadow: Shadow | None = None, masks_of: str = LIFT,
) -> Behind:  # fmt: skip
    """Background that other views observed behind the object, and depth of the cleared scene, per view.

    Args:
        run: Run folder that receives the stage.
        views: Training views.
        edit_masks: Of these and the others.
        cleared: The scene without the object.
        others: Held-out views; only their masks are extended by the shadow.
        shadow: Of the object; None if it casts none.
        masks_of: The stage that made the masks.
    """

    def compute(folder: Path) -> None:
        depths, alphas, lit, masks = [], [], [], []
        for view in [*views, *others]:
            with torch.no_grad():
                rendering = render(cleared.gaussians, view.camera, effects=replace(run.effects, depth=True))
            depths.append(rendering.depth.numpy())
            alphas.append(rendering.alpha.numpy())
            mask = edit_masks[view.name]
            if shadow is not None:
                shaded = shaded_in(view, depths[-1], shadow)
                view, mask = relit_view(view, shaded), mask | shaded.black
                write_image(folder / "masks" / f"{view.name}.png", mask | shaded.where)
                write_image(folder / f"{view.name}.mask.png", mask)
                write_image(folder / f"{view.name}.relit.png", view.pixels)
            lit.append(view)
            masks.append(mask)
        count = len(views)
        backgrounds = observe_behind(lit[:count], masks[:count], depths[:count], alphas[:count])
        for view, background, depth, alpha in zip(lit, backgrounds, depths, alphas, strict=False):
            write_image(folder / f"{view.name}.png", background.image)
            write_image(folder / f"{view.name}.unseen.png", background.unseen)
            if background.alpha is not None:
                write_image(folder / f"{view.name}.alpha.png", background.alpha)
            surface = np.where(alpha > 0.5, depth, 0.0).astype(np.float32)
            write_array(folder / f"{view.name}.depth.npy", surface)

    folder = run.stage("look-behind", compute)
    lit, backgrounds, depths = [], [], []
    for view in views:
        mask = edit_masks[view.name]
        if shadow is not None:
            mask = read_mask(folder / f"{view.name}.mask.png")
            view = replace(view, pixels=to_bytes(read_picture(folder / f"{view.name}.relit.png")))
        lit.append(view)
        unseen = read_mask(folder / f"{view.name}.unseen.png")
        image = read_picture(folder / f"{view.name}.png")
        alpha = None if view.alpha is None else read_plane(folder / f"{view.name}.alpha.png")
        backgrounds.append(Background(unseen, image, mask & ~unseen, alpha))
        depths.append(read_array(folder / f"{view.name}.depth.npy"))
    if shadow is None:
        return Behind(lit, backgrounds, depths, edit_masks, masks_of)
    changed = read_masks(folder / "masks", [*views, *others])
    return Behind(lit, backgrounds, depths, changed, "look-behind")


def widened(mask: np.ndarray, settings: MaskSettings) -> np.ndarray:
    """A mask dilated by a disc, shape (H, W), bool."""
    import cv2

    radius = max(1, round(settings.dilation * float(np.hypot(*mask.shape))))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    return cv2.dilate(mask.astype(np.uint8), disc) > 0
