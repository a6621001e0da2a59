"""Remove an object from a scene (paper Sec. 3).

effects      choice of the effects to simulate
fit          the splat of the capture; photographs then take its exposure
lift         masks lifted to the object's gaussians, and widened
mirror       its mirror image in a glossy support, which goes with it
shadow       its shadow on the support, which is relit
clear        those gaussians deleted
look-behind  each mask shrunk to what no view saw behind the object
charts       surfaces that go on behind the object, filled in their own coordinates
references   K views by k-means on camera centres
fill         charts put into all views; the rest of the references filled in turn, and warped to the others
propagate    the other views filled, attending to the references
estimate     depth of the filled views, where DPT's weights are and the prior is a network
refit        the hole fitted to the filled views, with colour and depth
distil       the hole refined by score distillation, under texture and depth of the references
"""

from __future__ import annotations

if __name__ == "__main__":  # first of all, because the command tunes the process before torch is imported
    import sys

    from diga3d_warp.cli import main

    sys.exit(main(["remove", *sys.argv[1:]]))

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import torch

from diga3d_warp.gaussians.density import DensitySettings
from diga3d_warp.gaussians.fit import FitSettings
from diga3d_warp.gaussians.lift import LiftSettings
from diga3d_warp.gaussians.optimiser import LearningRates
from diga3d_warp.gaussians.representation import Representation
from diga3d_warp.perception.depth import DepthEstimator
from diga3d_warp.pipelines import (
    charting,
    clearing,
    coarse,
    fine,
    marking,
    mask_propagation,
    mirroring,
    shading,
    stages,
)
from diga3d_warp.pipelines.baking import publish_edit
from diga3d_warp.pipelines.contents import everything
from diga3d_warp.pipelines.fit import conclude, requested_fit
from diga3d_warp.pipelines.free_text import reads_free_text
from diga3d_warp.pipelines.marking import OWN_MASKS, Marks
from diga3d_warp.pipelines.method import Method, check_method, usual_method
from diga3d_warp.pipelines.own_fills import NO_FILLS, Fills, read_fills
from diga3d_warp.pipelines.request import EditRequest, EditResult
from diga3d_warp.pipelines.run import Run
from diga3d_warp.pipelines.standing import Masked
from diga3d_warp.priors.exemplar.prior import ExemplarPrior
from diga3d_warp.priors.protocol import DiffusionPrior, Prior
from diga3d_warp.propagation.references import References
from diga3d_warp.scene.scene import Scene
from diga3d_warp.surfaces.chart import Chart

REFIT = FitSettings(
    iterations=800,
    budget=0,  # the hole gets its gaussians from the references' fill, not by growth
    depth_weight=0.1,
    coarse_part=0.0,
    sh_steps=(0.0, 0.0, 0.0),
    density=DensitySettings(begin=0.1, end=0.6),
)
"""The fit of the hole. 1000 to 1500 iterations are the field's custom for edits; the hole starts from
gaussians on the filled surface, so fewer do."""

DISTIL = replace(
    REFIT,
    iterations=200,
    rates=LearningRates(means=5e-5),
    density=DensitySettings(end=0.0),
)
"""The fit of the fine stage: the gaussians of the hole exist already, so means have a lower learning rate,
and none is relocated or perturbed by noise."""


@dataclass(frozen=True)
class RemoveSettings:
    """Settings of a removal.

    Attributes:
        fit: Fit of the capture.
        refit: Fit of the hole.
        distil: Fit of the fine stage.
        lift: Thresholds for assigning a gaussian to the object.
        masking: Dilation of the masks.
        method: References, propagation and distillation; None for the default of the prior.
    """

    fit: FitSettings = field(default_factory=FitSettings)
    refit: FitSettings = REFIT
    distil: FitSettings = DISTIL
    lift: LiftSettings = field(default_factory=LiftSettings)
    masking: clearing.MaskSettings = field(default_factory=clearing.MaskSettings)
    method: Method | None = None

    def method_for(self, prior: Prior) -> Method:
        """The method to use with a prior.

        Raises:
            InputError: the prior cannot do what the method asks.
        """
        method = self.method or usual_method(prior)
        check_method(method, prior)
        return method


def remove_object(
    scene: Scene,
    run: Run,
    settings: RemoveSettings | None = None,
    *,
    prior: Prior | None = None,
    marks: Marks = OWN_MASKS,
    own: Fills = NO_FILLS,
    estimator: DepthEstimator | None = None,
    seed: int = 0,
    effects: Mapping[str, bool | int] | None = None,
) -> EditResult:
    """Run the stages of a removal in an open run folder; `remove` also reads, checks and measures.

    Args:
        scene: With masks in at least one training view.
        run: Run folder that receives stages and results; finished stages of an interrupted run are reused.
        settings: Fits, masks and method.
        prior: Prior that inpaints what no view saw; `ExemplarPrior` if None.
        marks: Boxes or a prompt that mark the object; empty uses the masks of the scene.
        own: Reference views that the user filled; they replace the prior's.
        estimator: Depth estimator for the filled views; if None, the surface around the hole is continued.
        seed: The same scene, settings and seed give the same bytes.
        effects: Effects forced on or off by the user, by name; the others are chosen from the scene.

    Raises:
        InputError: no view has a mask, the masks lift to nothing, there are fewer views than references, or
            the prior cannot do what the method asks.
    """
    settings = settings or RemoveSettings()
    prior = prior or ExemplarPrior()
    method = settings.method_for(prior)
    run.hold_to(**everything(scene, settings, seed, effects, prior, method, own))
    scene = marking.mark(run, scene, marks)
    stages.check_edit(scene, method.references)
    taken = take_out(scene, run, settings, prior, marks, seed, effects, own, estimator)
    edited, source = publish_edit(run, taken.scene, taken.stage, taken.behind.masks, seed)
    return EditResult(edited, run, source)


@dataclass(frozen=True, eq=False)
class TakenOut:
    """A scene whose object has been taken out and whose hole is filled.

    Attributes:
        gaussians: The scene without the object.
        source: The scene before.
        rows: Which gaussians of the source were the object's, shape (N,), bool.
        scene: The capture, with the cameras in use.
        edit_masks: Edit masks of its training and held-out views.
        references: Reference views and clusters.
        charts: Surfaces behind the object, filled.
        stage: The stage that made `gaussians`.
        behind: What was known behind the object, and masks of all that was edited.
    """

    gaussians: Representation
    source: Representation
    rows: torch.Tensor
    scene: Scene
    edit_masks: clearing.Masks
    references: References
    charts: Sequence[Chart]
    stage: str
    behind: clearing.Behind


def take_out(
    scene: Scene, run: Run, settings: RemoveSettings, prior: Prior, marks: Marks, seed: int,
    effects: Mapping[str, bool | int] | None, own: Fills = NO_FILLS, estimator: DepthEstimator | None = None,
    *, filled: bool = False,
) -> TakenOut:  # fmt: skip
    """The stages of a removal, from the fit to the filled hole.

    Arguments as `remove_object`, and `filled`: whether the user filled views for what comes after.
    """
    method = settings.method_for(prior)
    if isinstance(prior, DiffusionPrior) and not prior.learned and prior.guidance.scale != 1.0:
        run.note(
            f"prior {prior.name} reads no words of the negative prompt: it steers away from the masked object"
        )
    scene = stages.begin(run, scene, effects, takes_out=True)
    source = stages.fit_source(run, scene, settings.fit, seed)
    scene = stages.correct_exposure(run, scene)
    object_masks = mask_propagation.propagate_masks(run, scene, source, marks, settings.lift)
    source, rows, edit_masks = clearing.lift_object(
        run, scene, object_masks, source, settings.lift, settings.masking
    )
    wishes = {name: bool(value) for name, value in (effects or {}).items()}
    masked = Masked(run, scene, edit_masks, source, rows, settings.lift, settings.masking, seed)
    image = mirroring.find_image(masked, wishes.get("mirror"), filled=filled or bool(own))
    shade = shading.find_shade(
        masked, wishes.get("shadow"), filled=filled or bool(own), image=image.masks if image else None
    )
    rows, edit_masks, shadow = shade.rows, shade.edit_masks, shade.shadow
    holes_of, out, made = edit_masks, rows, stages.LIFT
    if image is not None:
        holes_of, out, made = image.with_object(edit_masks), rows | image.rows, mirroring.STAGE
    cleared = clearing.clear_object(run, scene.views, holes_of, source, out, settings.lift, shadow)
    behind = clearing.look_behind(
        run, scene.views, holes_of, cleared, scene.test_views, shadow, masks_of=made
    )
    views, backgrounds, depths = behind.views, behind.backgrounds, behind.depths
    scene = replace(scene, views=views)
    charts = charting.chart_surfaces(run, views, backgrounds, depths, scene.points, prior, method, seed, own)
    unseen = [at.unseen for at in backgrounds]
    holes = unseen if any(hole.any() for hole in unseen) else [holes_of[view.name] for view in views]
    references = stages.choose_references(run, views, holes, method, seed, own)
    fills = coarse.fill_views(run, views, backgrounds, depths, charts, references, prior, method, seed, own)
    fills = coarse.propagate(run, views, backgrounds, depths, fills, references, prior, method, seed)
    fills = coarse.estimate_depth(run, views, backgrounds, depths, charts, fills, estimator)
    edited = coarse.refit(
        run, views, cleared, backgrounds, depths, charts, fills, references, scene.extent, settings.refit,
        seed,
    )  # fmt: skip
    if method.distillation is None:
        return TakenOut(edited, source, rows, scene, edit_masks, references, charts, "refit", behind)
    assert isinstance(prior, DiffusionPrior), "check_method refuses others"
    refined = fine.distil(
        run, edited, cleared.held(len(edited)), coarse.targets_of(views, backgrounds, fills),
        unseen, references, prior, prior.guidance, method,
        scene.extent, settings.distil, seed, known=[at.image for at in backgrounds],
    )  # fmt: skip
    return TakenOut(refined, source, rows, scene, edit_masks, references, charts, "distil", behind)


def remove(
    scene: str | Path | Scene, out: str | Path, *, settings: RemoveSettings | None = None, **options: Any
) -> EditResult:
    """Remove the masked object from a capture, measure the result, and leave a run folder.

    Args:
        scene: Folder or file of a capture, or a scene from `load_scene`.
        out: Run folder, a new one unless `resume=True`.
        settings: Fits, masks and method; chosen by the scene and the options if None.
        options: Further attributes of `EditRequest`, such as `prior`, `masks`, `seed`, `resume`.

    Raises:
        InputError: the input or the run folder is not usable.
        TypeError: an option is unknown.
    """
    request = EditRequest(scene=scene, out=out, **options)
    request.refuse("remove", "exemplar", "asset")
    if request.prompt is not None and not reads_free_text(request):
        request.refuse(f"remove with prior {request.prior_name}", "prompt")
    prior = request.load_prior("remove", request.prompt or "")
    method = request.choose_method(prior)
    learned = isinstance(prior, DiffusionPrior) and prior.learned
    estimator = DepthEstimator.if_downloaded() if learned else None
    marks = request.marks()
    capture = request.load()
    own = read_fills(request.fill, capture)
    if own:
        method = replace(method, references=len(own))
    settings = settings or remove_settings(capture, request, method)
    method = settings.method_for(prior)
    stages.check_edit(marking.quick_masks(capture, marks), method.references)
    run = request.open_edit(
        "remove", capture, settings.fit.iterations, marks, method, prompt=request.prompt,
        depth_estimated=estimator is not None,
    )  # fmt: skip
    result = remove_object(
        capture, run, settings, prior=prior, marks=marks, own=own, estimator=estimator, seed=request.seed,
        effects=request.effects,
    )  # fmt: skip
    conclude(run, capture)
    return result


def remove_settings(scene: Scene, request: EditRequest, method: Method) -> RemoveSettings:
    """Default settings of a removal of a scene, with the options of the request applied."""
    return RemoveSettings(
        fit=requested_fit(scene, request),
        refit=replace(REFIT, accuracy=request.knobs),
        distil=replace(DISTIL, accuracy=request.knobs),
        method=method,
    )
