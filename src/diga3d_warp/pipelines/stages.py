"""Stages that the tasks share. Each reads what earlier stages wrote and writes its own products.

A stage never hands tensors on in memory: it loads them from its folder, finished or resumed alike. So a run
that was killed and resumed ends with the same bytes as one that was not.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypedDict

import numpy as np
import torch

from diga3d_warp.config import Effects
from diga3d_warp.effects.plan import Choice, EffectsPlan, plan_effects
from diga3d_warp.effects.prices import priced
from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.record import CAMERAS, RESULT, SOURCE, CurveRecord, EffectsRecord
from diga3d_warp.files import to_bytes, write_array, write_image, write_json
from diga3d_warp.gaussians.exposure import exposure_corrected
from diga3d_warp.gaussians.fit import FitResult, FitSettings, fit
from diga3d_warp.gaussians.initialise import initialise
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.gaussians.representation import Representation
from diga3d_warp.gaussians.scaffold.initialise import initial_anchors
from diga3d_warp.gaussians.storage import load
from diga3d_warp.gaussians.surround import beyond, render_before, surround_of
from diga3d_warp.gaussians.target import Target
from diga3d_warp.gaussians.thinning import thinned
from diga3d_warp.gaussians.working import to_user, to_working
from diga3d_warp.pipelines.given_splat import what_is_missing
from diga3d_warp.pipelines.method import Method
from diga3d_warp.pipelines.own_fills import NO_FILLS, Fills
from diga3d_warp.pipelines.run import Run
from diga3d_warp.propagation.references import (
    References,
    check_reference_count,
    given_references,
    select_references,
    usable_views,
)
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.formats.read import read_splat
from diga3d_warp.scene.layouts.cameras_file import CameraSet, save_cameras
from diga3d_warp.scene.scene import Scene, View
from diga3d_warp.scene.working_frame import WorkingFrame, with_near_planes
from diga3d_warp.splatting.shade import coefficient_count
from diga3d_warp.state import read_array, read_state

GAUSSIANS = RESULT
SHELL = "surround.ply"
"""In the folder of the fit: what lies behind everything; stages do without it."""
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


def begin(
    run: Run, scene: Scene, overrides: Mapping[str, bool | int] | None = None, *, takes_out: bool = False
) -> Scene:
    """Record the notes of the reader, plan the effects, and write cameras.json.

    Args:
        run: Run that receives the effects, and the plan in its manifest.
        scene: The capture.
        overrides: Effects forced on or off by the user, by name.
        takes_out: Whether an object is taken out.

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
        splat = to_working(Gaussians.from_rows(given.scene), run.frame) if given else None
        antialiased, surrounded = (
            given is not None and given.antialiased,
            given is not None and given.surround > 0,
        )
        plan = plan_effects(
            working, splat, antialiased=antialiased, surrounded=surrounded, takes_out=takes_out,
            overrides=overrides,
        )  # fmt: skip
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


def decide(run: Run, choice: Choice) -> None:
    """Replace a choice of the plan by what a stage has found since."""
    plan = EffectsPlan.from_json(run.recorded("effects")).replaced(choice)
    run.effects = replace(run.effects, **{choice.effect: choice.value})  # type: ignore[arg-type]
    run.record("effects", plan.as_json())


def fit_source(run: Run, scene: Scene, settings: FitSettings, seed: int) -> Representation:
    """Fit gaussians or anchors to the capture; the splat of a capture that has one is taken instead."""

    def compute(folder: Path) -> None:
        if scene.splat is not None:
            run.note(f"{scene.splat.name} is taken as it is, not fitted again")
            content = read_splat(scene.splat)
            given = to_working(Gaussians.from_rows(content.scene), run.frame)
            if note := what_is_missing(scene, scene.splat.name, given):
                run.note(note)
            given.save_ply(folder / GAUSSIANS, antialiased=run.effects.antialias)
            if content.surround and run.effects.surround:
                to_working(Gaussians.from_rows(content.shell), run.frame).save_ply(folder / SHELL)
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
        start: Representation = initialise(points, coefficients)
        if settings.scaffold is not None:
            start = initial_anchors(points, scene.extent, settings.budget, settings.scaffold)
        shell = None
        if run.effects.surround:
            shell = surround_of(
                [view.camera for view in scene.views], [view.pixels for view in scene.views],
                start.means, scene.extent, coefficients,
            )  # fmt: skip
        result = fit(
            start, targets, scene.extent, settings, effects=run.effects, seed=seed, surround=shell,
            checkpoint=folder / "checkpoint.pt", note=run.note, progress=True,
        )  # fmt: skip
        keep_fit(run, folder, result)
        if shell is not None:
            beyond(shell, result.gaussians.means, scene.extent).save_ply(folder / SHELL)

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


def choose_references(
    run: Run, views: Sequence[View], areas: Sequence[np.ndarray], method: Method, seed: int,
    own: Fills = NO_FILLS,
) -> References:  # fmt: skip
    """The views that the user filled; else K references by k-means on camera centres, or at random.

    Args:
        run: Run folder that receives the stage.
        views: Training views.
        areas: Where each of them is edited, shape (H, W), bool.
        method: Number of references, and how they are chosen.
        own: Views that the user filled.
        seed: Seed of k-means or of the draw.

    Raises:
        InputError: no view is edited anywhere.
    """

    def compute(folder: Path) -> None:
        centers = np.stack([view.camera.center for view in views])
        usable = usable_views(areas)
        filled = [index for index, view in enumerate(views) if view.name in own]
        if filled:
            chosen = given_references(centers, filled)
        else:
            chosen = select_references(centers, method.references, seed, method.selection, usable)
        if not filled and len(chosen.indices) < method.references:
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
    before, after = None if before is None else _surrounded(run, before), _surrounded(run, after)

    def compute(folder: Path) -> None:
        for view in [*scene.views, *scene.test_views]:
            first = view.pixels if before is None else picture(before, view.camera, run.effects)
            write_image(folder / "before" / f"{view.name}.png", first)
            write_image(folder / "after" / f"{view.name}.png", picture(after, view.camera, run.effects))

    _publish_pictures(run, run.stage("views", compute), "views")


def finish(run: Run, result: str, masks: str = LIFT, source: str = "fit") -> tuple[Gaussians, Gaussians]:
    """Publish the splats, in the user's world, and the masks of a run.

    Args:
        run: The run.
        result: The stage that made the final splat, of gaussians.
        masks: The stage that made the masks of all that was edited.
        source: The stage that made the splat before the edit; `result` if there was none.

    Returns:
        The final splat and the one before the edit, which for a fit is the same.
    """
    if result == source:
        fitted = _publish_splat(run, result, RESULT)
        return fitted, fitted
    _publish_pictures(run, run.folder / "stages" / masks / "masks", "masks")
    before = _publish_splat(run, source, SOURCE)
    return _publish_splat(run, result, RESULT), before


def _publish_splat(run: Run, stage: str, name: str) -> Gaussians:
    working = Gaussians.load_ply(run.folder / "stages" / stage / GAUSSIANS, every_row=True)
    joined = _surrounded(run, working)
    gaussians = to_user(joined, run.frame)
    gaussians.save_ply(
        run.folder / name, antialiased=run.effects.antialias, surround=len(joined) - len(working)
    )
    if gaussians.means.dtype == torch.float64:
        run.note(f"{name} holds x, y, z as double: the scene lies too far from the origin for float32")
    return gaussians


def shell_of(run: Run) -> Gaussians | None:
    """The surround of the run's splat, if it has one."""
    return shell_in(run.folder)


def shell_in(folder: Path) -> Gaussians | None:
    """The surround of the splat in a run folder, if it has one."""
    shell = folder / "stages" / "fit" / SHELL
    return Gaussians.load_ply(shell, every_row=True) if shell.is_file() else None


def shown(splat: Representation, shell: Gaussians | None, camera: Camera, effects: Effects) -> np.ndarray:
    """A rendering of gaussians or anchors before the surround, if there is one, shape (H, W, 3), uint8."""
    return to_bytes(render_before(shell, splat, camera, replace(effects, depth=False)).color)


def _surrounded(run: Run, gaussians: Gaussians) -> Gaussians:
    """The splat of a stage with the surround behind it, if the run has one."""
    shell = shell_of(run)
    return gaussians if shell is None else gaussians.joined(shell)


def _publish_pictures(run: Run, source: Path, name: str) -> None:
    for file in sorted(source.rglob("*.png")):
        run.publish(file, f"{name}/{file.relative_to(source)}")


def picture(gaussians: Gaussians, camera: Camera, effects: Effects) -> np.ndarray:
    """A rendering as an 8-bit image, shape (H, W, 3), over `BACKGROUND` where that is seen."""
    return shown(gaussians, None, camera, effects)


def fitted(run: Run, name: str, compute: Callable[[Path], None]) -> Representation:
    """Run a stage that ends with `keep_fit`, and show its curve in the report."""
    folder = run.stage(name, compute)
    run.add_metrics(name, dict(read_state(folder / CURVE, CurveRecord)))
    return load(folder)


def keep_fit(run: Run, folder: Path, result: FitResult) -> None:
    """Write the result of a fit into the folder of its stage, and delete the checkpoint."""
    result.gaussians.save(folder, antialiased=run.effects.antialias)
    write_json(folder / CURVE, {"curve": result.curve})
    if result.exposures is not None:
        write_array(folder / EXPOSURES, result.exposures)
    (folder / "checkpoint.pt").unlink(missing_ok=True)


def tensor_of(alpha: np.ndarray | None) -> torch.Tensor | None:
    """Opacity of a view as a tensor for `Target`, shape (H, W), uint8; None without a background."""
    return None if alpha is None else torch.from_numpy(alpha)
