"""Remove an object from a scene (paper Sec. 3, with the fill of one prior for all references).

effects      what the scene calls for
fit          the splat of the capture; photographs then take its exposure
lift         masks lifted to the object's gaussians, and widened
clear        those gaussians deleted
look-behind  each mask shrunk to what no view saw behind the object
references   K views by k-means on camera centres
fill         references filled in turn, their fill warped to the other views
refit        the hole fitted to the filled views, with colour and depth
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import torch

from diga3d_warp.config import ACCURACIES
from diga3d_warp.effects.overrides import format_overrides
from diga3d_warp.gaussians.density import DensitySettings
from diga3d_warp.gaussians.fit import FitSettings
from diga3d_warp.gaussians.lift import LiftSettings
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.pipelines import carrying, marking, stages
from diga3d_warp.pipelines.fit import conclude, fit_settings
from diga3d_warp.pipelines.marking import OWN_MASKS, Marks, read_marks
from diga3d_warp.pipelines.run import Run
from diga3d_warp.priors.classical import ClassicalPrior
from diga3d_warp.priors.exemplar.prior import ExemplarPrior
from diga3d_warp.priors.protocol import Prior
from diga3d_warp.scene.load import load_scene
from diga3d_warp.scene.scene import Scene, View

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


PRIORS: dict[str, Callable[[], Prior]] = {"exemplar": ExemplarPrior, "classical": ClassicalPrior}
"""What `--prior` names."""


@dataclass(frozen=True)
class RemoveSettings:
    """How an object is removed.

    Attributes:
        fit: Fit of the capture.
        refit: Fit of the hole.
        lift: When a gaussian belongs to the object.
        masking: How masks are widened.
        references: Number K of references. Paper: 3.
        selection: "kmeans", or "random" to compare.
    """

    fit: FitSettings = field(default_factory=FitSettings)
    refit: FitSettings = REFIT
    lift: LiftSettings = field(default_factory=LiftSettings)
    masking: stages.MaskSettings = field(default_factory=stages.MaskSettings)
    references: int = 3
    selection: str = "kmeans"


@dataclass(frozen=True, eq=False)
class RemoveResult:
    """What a removal leaves.

    Attributes:
        gaussians: The scene without the object.
        source: The scene before the edit.
        run: The run folder, with views, masks, metrics and stages.
    """

    gaussians: Gaussians
    source: Gaussians
    run: Run


def remove(
    scene: Scene,
    run: Run,
    settings: RemoveSettings | None = None,
    *,
    prior: Prior | None = None,
    marks: Marks = OWN_MASKS,
    seed: int = 0,
    effects: Mapping[str, bool | int] | None = None,
) -> RemoveResult:
    """Remove the masked object.

    Args:
        scene: With masks in at least one training view.
        run: Where stages and results go; finished stages of an interrupted run are taken up.
        settings: How.
        prior: What invents the part that no view saw; `ExemplarPrior` if None.
        marks: Boxes or words that say where the object is; the scene's masks do if there are none.
        seed: Same scene, settings and seed: same bytes.
        effects: Effects on which the user insists, by name; the scene decides on the others.

    Raises:
        InputError: no view has a mask, the masks lift to nothing, or there are fewer views than references.
    """
    scene = marking.mark(run, scene, marks)
    settings = settings or RemoveSettings()
    prior = prior or ExemplarPrior()
    stages.check_edit(scene, settings.references)
    taken = take_out(scene, run, settings, prior, marks, seed, effects)
    stages.show_views(run, taken.scene, taken.source, taken.gaussians)
    stages.finish(run, "refit")
    return RemoveResult(taken.gaussians, taken.source, run)


@dataclass(frozen=True, eq=False)
class TakenOut:
    """A scene whose object has been taken out and whose hole is filled.

    Attributes:
        gaussians: The scene without the object.
        source: The scene before.
        rows: Which gaussians of the source were the object's, shape (N,), bool.
        scene: The capture, with the cameras and masks in use.
        views: Its training views with widened masks.
    """

    gaussians: Gaussians
    source: Gaussians
    rows: torch.Tensor
    scene: Scene
    views: list[View]


def take_out(
    scene: Scene, run: Run, settings: RemoveSettings, prior: Prior, marks: Marks, seed: int,
    effects: Mapping[str, bool | int] | None,
) -> TakenOut:  # fmt: skip
    """The stages of a removal, from the fit to the filled hole; arguments as `remove`."""
    scene = stages.begin(run, scene, effects)
    source = stages.fit_source(run, scene, settings.fit, seed)
    scene = stages.even_exposure(run, scene)
    scene = carrying.carry_masks(run, scene, source, marks, settings.lift)
    rows, views = stages.lift_object(run, scene, source, settings.lift, settings.masking)
    cleared = stages.clear_object(run, views, source, rows, settings.lift)
    backgrounds, depths = stages.look_behind(run, cleared)
    references = stages.choose_references(run, cleared.views, settings.references, settings.selection, seed)
    fills = stages.fill_views(run, cleared.views, backgrounds, depths, references, prior, seed)
    edited = stages.refit(run, cleared, fills, scene.extent, settings.refit, seed)
    return TakenOut(edited, source, rows, scene, views)


def remove_command(
    scene: Path, out: Path, masks: Path | None, mask_boxes: Sequence[Sequence[str]],
    mask_prompt: str | None, mask_models: Path | None, image_scale: float,
    iterations: int | None, hold_out: int, seed: int, resume: bool, effects: Mapping[str, bool | int],
    accuracy: str, prior: str, references: int, selection: str,
) -> Run:  # fmt: skip
    """`diga3d remove`: read the capture, remove the object, measure, and leave a run folder.

    Raises:
        InputError: the input or the run folder is not usable.
    """
    marks = read_marks(masks, mask_boxes, mask_prompt, mask_models)
    capture = load_scene(scene, image_scale=image_scale, masks=masks, hold_out=hold_out, progress=True)
    settings = RemoveSettings(
        fit=fit_settings(capture, iterations, ACCURACIES[accuracy]),
        refit=replace(REFIT, accuracy=ACCURACIES[accuracy]),
        references=references,
        selection=selection,
    )
    stages.check_edit(marking.glance(capture, marks), settings.references)
    run = Run(
        out,
        "remove",
        {
            "scene": scene, "masks": masks, **marks.settings(),
            "image_scale": image_scale, "hold_out": hold_out, "seed": seed,
            "iterations": settings.fit.iterations, "accuracy": accuracy, "prior": prior,
            "references": references, "selection": selection, "effects": format_overrides(effects),
        },
        resume=resume,
    )  # fmt: skip
    remove(capture, run, settings, prior=PRIORS[prior](), marks=marks, seed=seed, effects=effects)
    conclude(run, capture)
    return run
