"""Stages that the tasks share. Each reads what earlier stages wrote and writes its own products.

A stage never hands tensors on in memory: it loads them from its folder, finished or resumed alike. So a run
that was killed and resumed ends with the same bytes as one that was not.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypedDict

import numpy as np
import torch

from diga3d_warp.config import Effects
from diga3d_warp.effects.plan import EffectsPlan, plan_effects
from diga3d_warp.effects.prices import priced
from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.record import CAMERAS, RESULT, SOURCE, CurveRecord, EffectsRecord
from diga3d_warp.files import to_bytes, write_array, write_image, write_json
from diga3d_warp.gaussians.exposure import exposure_corrected
from diga3d_warp.gaussians.fit import FitResult, FitSettings, Target, fit
from diga3d_warp.gaussians.initialise import initialise
from diga3d_warp.gaussians.lift import LiftSettings, object_mask, object_rows, vote
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.gaussians.thinning import thinned
from diga3d_warp.gaussians.working import to_user, to_working
from diga3d_warp.pipelines.method import Method
from diga3d_warp.pipelines.run import Run
from diga3d_warp.propagation.references import (
    References,
    check_reference_count,
    select_references,
    usable_views,
)
from diga3d_warp.propagation.unseen import Background, observe_behind
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.formats.read import read_splat
from diga3d_warp.scene.layouts.cameras_file import CameraSet, save_cameras
from diga3d_warp.scene.photographs.images import BACKGROUND
from diga3d_warp.scene.scene import Scene, View
from diga3d_warp.scene.working_frame import WorkingFrame, with_near_planes
from diga3d_warp.splatting.render import render
from diga3d_warp.splatting.shade import coefficient_count
from diga3d_warp.state import read_array, read_mask, read_picture, read_plane, read_state

GAUSSIANS = RESULT
LIFT = "lift"
CURVE = "curve.json"
PLAN = "plan.json"
EXPOSURES = "exposures.npy"
PRICED_MOST = 60_000
"""Sparse points from which the cost of effects is measured: a fit of default budget ends with as many."""


class ReferencesRecord(TypedDict):
    """References and clusters, see `propagation.references.References`."""

    indices: list[int]
    names: list[str]
    cluster: list[int]


@dataclass(frozen=True)
class MaskSettings:
    """Dilation of the masks before anything is filled.

    Attributes:
        dilation: Radius [image diagonals]. Masks seldom reach the object's very rim, and splats reach over
            it. SPIn-NeRF: five times 5 x 5, 10 px at a diagonal of 1157 px; here a little more, against the
            halo of fitted splats.
    """

    dilation: float = 0.012


def check_splat(scene: Scene) -> None:
    """Refuse a capture's splat that is not usable, before anything is written.

    Raises:
        InputError: the splat that the scene came with holds no usable gaussian.
    """
    if scene.splat is not None:
        read_splat(scene.splat)


def check_edit(scene: Scene, references: int) -> None:
    """Check the input of an edit before anything is written, as its errors would show only after a long fit.

    Args:
        scene: The capture.
        references: Number K of references.

    Raises:
        InputError: no view has a mask, there are fewer views than references, or the scene's splat is not
            usable.
    """
    masked_views(scene)
    check_reference_count(references, len(scene.views))
    check_splat(scene)


def begin(run: Run, scene: Scene, overrides: Mapping[str, bool | int] | None = None) -> Scene:
    """Record the notes of the reader, plan the effects, and write cameras.json.

    Args:
        run: Run that receives the effects, and the plan in its manifest.
        scene: The capture.
        overrides: Effects forced on or off by the user, by name.

    Returns:
        The scene with the cameras to use, in working units, as all stages have it; `finish` and the cameras
        file give what is made in the user's world. Where the lens is not followed, cameras have none in any
        stage. Views have an alpha exactly if a background is simulated.
    """
    for note in scene.notes:
        run.note(note)
    run.frame = WorkingFrame.of(scene)
    run.record("working_frame", run.frame.as_json())
    working = run.frame.working_scene(scene)

    def compute(folder: Path) -> None:
        given = read_splat(scene.splat) if scene.splat else None
        splat = to_working(Gaussians.from_rows(given.rows), run.frame) if given else None
        antialiased = given is not None and given.antialiased
        plan = plan_effects(working, splat, antialiased=antialiased, overrides=overrides)
        if antialiased and plan.effects.antialias:
            run.note("the splat was fitted with anti-aliasing, and is drawn with it")
        drawn = splat or initialise(thinned(working.points, PRICED_MOST))
        write_json(folder / PLAN, priced(plan, drawn, working.views[0].camera).as_json())

    data = read_state(run.stage("effects", compute) / PLAN, EffectsRecord)
    plan = EffectsPlan.from_json(data)
    run.effects = plan.effects
    run.record("effects", data)
    print(plan.table().text(), file=sys.stderr)
    if not plan.effects.lens:
        scene, working = scene.without_lens(), working.without_lens()
    save_cameras(run.folder / CAMERAS, CameraSet.of(with_near_planes(scene)))
    return working.with_alpha(plan.effects.background)


def fit_source(run: Run, scene: Scene, settings: FitSettings, seed: int) -> Gaussians:
    """Fit the splat of the capture; the splat of a capture that has one is taken instead."""

    def compute(folder: Path) -> None:
        if scene.splat is not None:
            run.note(f"{scene.splat.name} is taken as it is, not fitted again")
            given = to_working(Gaussians.from_rows(read_splat(scene.splat).rows), run.frame)
            given.save_ply(folder / GAUSSIANS, antialiased=run.effects.antialias)
            write_json(folder / CURVE, {"curve": []})
            return
        targets = [
            Target(view.camera, torch.from_numpy(view.pixels), alpha=tensor_of(view.alpha))
            for view in scene.views
        ]
        points = thinned(scene.points, max(settings.budget, 1))
        if len(points) < len(scene.points):
            run.note(
                f"the fit starts from {len(points)} of {len(scene.points)} sparse points, thinned evenly in "
                "space: as many as its budget of gaussians"
            )
        coefficients = coefficient_count(run.effects.sh_degree)
        result = fit(
            initialise(points, coefficients), targets, scene.extent, settings, effects=run.effects,
            seed=seed, checkpoint=folder / "checkpoint.pt", note=run.note, progress=True,
        )  # fmt: skip
        keep_fit(run, folder, result)

    return fitted(run, "fit", compute)


def correct_exposure(run: Run, scene: Scene) -> Scene:
    """The scene with the fitted exposure of each training view undone, where exposures were fitted.

    Photographs then agree in colour with the splat and with each other, so that one may fill another's hole.
    Later fits of the run have no exposures.
    """
    run.effects = replace(run.effects, exposure=False)
    file = run.folder / "stages" / "fit" / EXPOSURES
    if not file.exists():
        return scene
    transforms = torch.from_numpy(read_array(file))
    views = [
        replace(view, pixels=exposure_corrected(view.pixels, transform, view.alpha))
        for view, transform in zip(scene.views, transforms, strict=True)
    ]
    return replace(scene, views=views)


def masked_views(scene: Scene) -> list[View]:
    """Training views with a mask, at least one.

    Raises:
        InputError: no view has a mask.
    """
    masked = [view for view in scene.views if view.mask is not None]
    if not masked:
        if scene.mask_problem is not None:
            raise InputError(scene.mask_problem)
        raise InputError(
            f"{scene.path}: no view has a mask; put one for each image into {scene.path / 'masks'}, "
            "white on the object, or name a folder with --masks"
        )
    return masked


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

    gaussians: Gaussians
    free: torch.Tensor

    def held(self, count: int) -> torch.Tensor:
        """Mask of the rows that keep their values while the hole is filled, of `count` gaussians."""
        return torch.nn.functional.pad(~self.free, (0, count - len(self.free)))


def lift_object(
    run: Run, scene: Scene, object_masks: Masks, source: Gaussians, settings: LiftSettings,
    masking: MaskSettings,
) -> tuple[torch.Tensor, Masks]:  # fmt: skip
    """Lift object masks to the object's gaussians, and widen them.

    Args:
        run: Run folder that receives the stage.
        scene: The capture.
        object_masks: Of some views or all; of those in training, at least one. Views without one get one from
            the object's gaussians.
        source: The splat, N gaussians.
        settings: Thresholds for assigning a gaussian to the object.
        masking: Dilation of the masks.

    Returns:
        Which gaussians belong to the object, shape (N,), bool, and the edit masks of all views.

    Raises:
        InputError: the masks lift to no gaussian or to all of them.
    """

    def compute(folder: Path) -> None:
        masked = [view for view in scene.views if view.name in object_masks]
        cameras, masks = [view.camera for view in masked], [object_masks[view.name] for view in masked]
        votes = vote(source, cameras, masks, run.effects)
        rows = object_rows(votes, settings)
        if not rows.any():
            raise InputError(
                f"{scene.path}: the masks lift to no gaussian; do they belong to these images? The object "
                "may also be too small or thin: try more --iterations"
            )
        if rows[votes.total > settings.faint].all():
            raise InputError(f"{scene.path}: the masks lift to every gaussian seen; mask the object only")
        for view in [*scene.views, *scene.test_views]:
            mask = object_masks.get(view.name)
            if mask is None:
                mask = object_mask(source, view.camera, rows, settings, run.effects)
            write_image(folder / "masks" / f"{view.name}.png", widened(mask, masking))
        write_array(folder / "object.npy", rows)

    folder = run.stage(LIFT, compute)
    edit_masks = read_masks(folder / "masks", [*scene.views, *scene.test_views])
    return torch.from_numpy(read_array(folder / "object.npy")), edit_masks


def read_masks(folder: Path, views: Sequence[View]) -> Masks:
    """The masks of views from a stage's folder."""
    return {view.name: read_mask(folder / f"{view.name}.png") for view in views}


def clear_object(
    run: Run, views: Sequence[View], edit_masks: Masks, source: Gaussians, rows: torch.Tensor,
    settings: LiftSettings,
) -> Cleared:  # fmt: skip
    """Delete the object's gaussians.

    Args:
        run: Run folder that receives the stage.
        views: Training views.
        edit_masks: Of these views.
        source: N gaussians.
        rows: Those of the object, shape (N,).
        settings: Which of the others may change.
    """

    def compute(folder: Path) -> None:
        left = source.select(~rows)
        masks = [edit_masks[view.name] for view in views]
        near = vote(left, [view.camera for view in views], masks, run.effects)
        left.save_ply(folder / GAUSSIANS, antialiased=run.effects.antialias)
        write_array(folder / "free.npy", near.share > settings.free_share)
        write_json(folder / "counts.json", {"object": int(rows.sum()), "left": int((~rows).sum())})

    folder = run.stage("clear", compute)
    free = torch.from_numpy(read_array(folder / "free.npy"))
    return Cleared(Gaussians.load_ply(folder / GAUSSIANS, every_row=True), free)


def look_behind(
    run: Run, views: Sequence[View], edit_masks: Masks, cleared: Cleared
) -> tuple[list[Background], list[np.ndarray]]:
    """Background that other views observed behind the object, and depth of the cleared scene, per view."""
    masks = [edit_masks[view.name] for view in views]

    def compute(folder: Path) -> None:
        depths, alphas = [], []
        with_depth = replace(run.effects, depth=True)
        for view in views:
            with torch.no_grad():
                rendering = render(cleared.gaussians, view.camera, effects=with_depth)
            depths.append(rendering.depth.numpy())
            alphas.append(rendering.alpha.numpy())
        backgrounds = observe_behind(views, masks, depths, alphas)
        for view, background, depth, alpha in zip(views, backgrounds, depths, alphas, strict=True):
            write_image(folder / f"{view.name}.png", background.image)
            write_image(folder / f"{view.name}.unseen.png", background.unseen)
            if background.alpha is not None:
                write_image(folder / f"{view.name}.alpha.png", background.alpha)
            surface = np.where(alpha > 0.5, depth, 0.0).astype(np.float32)
            write_array(folder / f"{view.name}.depth.npy", surface)

    folder = run.stage("look-behind", compute)
    backgrounds, depths = [], []
    for view, mask in zip(views, masks, strict=True):
        unseen = read_mask(folder / f"{view.name}.unseen.png")
        image = read_picture(folder / f"{view.name}.png")
        alpha = None if view.alpha is None else read_plane(folder / f"{view.name}.alpha.png")
        backgrounds.append(Background(unseen, image, mask & ~unseen, alpha))
        depths.append(read_array(folder / f"{view.name}.depth.npy"))
    return backgrounds, depths


def choose_references(
    run: Run, views: Sequence[View], areas: Sequence[np.ndarray], method: Method, seed: int
) -> References:
    """K references by k-means on camera centres, or at random, among the views that show what is edited.

    Args:
        run: Run folder that receives the stage.
        views: Training views.
        areas: Where each of them is edited, shape (H, W), bool.
        method: Number of references, and how they are chosen.
        seed: Seed of k-means or of the draw.

    Raises:
        InputError: no view is edited anywhere.
    """

    def compute(folder: Path) -> None:
        centers = np.stack([view.camera.center for view in views])
        usable = usable_views(areas)
        chosen = select_references(centers, method.references, seed, method.selection, usable)
        if len(chosen.indices) < method.references:
            run.note(
                f"{len(chosen.indices)} of {len(views)} views show enough of the object to be references; "
                f"{method.references} were asked for"
            )
        names = [views[index].name for index in chosen.indices]
        data = {"indices": chosen.indices, "names": names, "cluster": chosen.cluster.tolist()}
        write_json(folder / "references.json", data)

    folder = run.stage("references", compute)
    data = read_state(folder / "references.json", ReferencesRecord)
    return References(data["indices"], np.array(data["cluster"]))


def show_views(run: Run, scene: Scene, before: Gaussians | None, after: Gaussians) -> None:
    """Pictures of every view before and after; before a fit, that is the photograph."""

    def compute(folder: Path) -> None:
        for view in [*scene.views, *scene.test_views]:
            first = view.pixels if before is None else picture(before, view.camera, run.effects)
            write_image(folder / "before" / f"{view.name}.png", first)
            write_image(folder / "after" / f"{view.name}.png", picture(after, view.camera, run.effects))

    _publish_pictures(run, run.stage("views", compute), "views")


def finish(run: Run, result: str, masks: str = LIFT) -> tuple[Gaussians, Gaussians]:
    """Publish the splats, in the user's world, and the masks of a run.

    Args:
        run: The run.
        result: The stage that made the final splat.
        masks: The stage that made the masks of all that was edited.

    Returns:
        The final splat and the one before the edit, which for a fit is the same.
    """
    if result == "fit":
        fitted = _publish_splat(run, result, RESULT)
        return fitted, fitted
    _publish_pictures(run, run.folder / "stages" / masks / "masks", "masks")
    source = _publish_splat(run, "fit", SOURCE)
    return _publish_splat(run, result, RESULT), source


def _publish_splat(run: Run, stage: str, name: str) -> Gaussians:
    working = Gaussians.load_ply(run.folder / "stages" / stage / GAUSSIANS, every_row=True)
    gaussians = to_user(working, run.frame)
    gaussians.save_ply(run.folder / name, antialiased=run.effects.antialias)
    if gaussians.means.dtype == torch.float64:
        run.note(f"{name} holds x, y, z as double: the scene lies too far from the origin for float32")
    return gaussians


def _publish_pictures(run: Run, source: Path, name: str) -> None:
    for file in sorted(source.rglob("*.png")):
        run.publish(file, f"{name}/{file.relative_to(source)}")


def picture(gaussians: Gaussians, camera: Camera, effects: Effects) -> np.ndarray:
    """A rendering as an 8-bit image, shape (H, W, 3), over `BACKGROUND` where that is seen."""
    with torch.no_grad():
        seen = render(gaussians, camera, effects=replace(effects, depth=False), background=BACKGROUND)
    return to_bytes(seen.color)


def widened(mask: np.ndarray, settings: MaskSettings) -> np.ndarray:
    """A mask dilated by a disc, shape (H, W), bool."""
    import cv2

    radius = max(1, round(settings.dilation * float(np.hypot(*mask.shape))))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    return cv2.dilate(mask.astype(np.uint8), disc) > 0


def fitted(run: Run, name: str, compute: Callable[[Path], None]) -> Gaussians:
    """Run a stage that ends with `keep_fit`, and show its curve in the report."""
    folder = run.stage(name, compute)
    run.add_metrics(name, dict(read_state(folder / CURVE, CurveRecord)))
    return Gaussians.load_ply(folder / GAUSSIANS, every_row=True)


def keep_fit(run: Run, folder: Path, result: FitResult) -> None:
    """Write the result of a fit into the folder of its stage, and delete the checkpoint."""
    result.gaussians.save_ply(folder / GAUSSIANS, antialiased=run.effects.antialias)
    write_json(folder / CURVE, {"curve": result.curve})
    if result.exposures is not None:
        write_array(folder / EXPOSURES, result.exposures)
    (folder / "checkpoint.pt").unlink(missing_ok=True)


def tensor_of(alpha: np.ndarray | None) -> torch.Tensor | None:
    """Opacity of a view as a tensor for `Target`, shape (H, W), uint8; None without a background."""
    return None if alpha is None else torch.from_numpy(alpha)
