"""Put another object in place of one in a scene.

fit ... distil  the old object taken out, as in `remove`
look            the old object in every view: its surface tells place, size and light

The new object is an asset or a built-in solid:

place           it stands on the support, with its shadow, drawn into every view
settle          it and the shaded floor are fitted to those views

or whatever a diffusion prior can be told; the hole behind it is then not refined:

imagine         it appears in the references one after another, then in all other views
measure         its depth, estimated and aligned to the scene
grow            gaussians on that depth, fitted to the imagined views
distil          refined by score distillation
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from dataclasses import replace as with_changes
from pathlib import Path

import torch

from diga3d_warp.config import ACCURACIES
from diga3d_warp.effects.overrides import format_overrides
from diga3d_warp.errors import InputError
from diga3d_warp.gaussians.density import DensitySettings
from diga3d_warp.gaussians.fit import FitSettings
from diga3d_warp.gaussians.optimiser import LearningRates
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.objects.asset import Asset, read_asset
from diga3d_warp.objects.solids import solid_of
from diga3d_warp.objects.surface import Sight
from diga3d_warp.perception.depth import DPT, DepthEstimator
from diga3d_warp.pipelines import fine, imagining, marking, placing, recolouring, stages
from diga3d_warp.pipelines.fit import conclude, fit_settings
from diga3d_warp.pipelines.free_text import FreeText, reads_free_text
from diga3d_warp.pipelines.marking import OWN_MASKS, Marks, read_marks
from diga3d_warp.pipelines.method import Choices
from diga3d_warp.pipelines.remove import DISTIL, REFIT, RemoveSettings, TakenOut, take_out
from diga3d_warp.pipelines.run import Run
from diga3d_warp.priors.exemplar.prior import ExemplarPrior
from diga3d_warp.priors.protocol import Prior
from diga3d_warp.scene.load import load_scene
from diga3d_warp.scene.scene import Scene

SETTLE = FitSettings(
    iterations=300,
    budget=0,  # the new object's gaussians cover it from the start
    depth_weight=0.1,
    coarse_part=0.0,
    sh_steps=(0.0, 0.0, 0.0),
    rates=LearningRates(means=5e-5, log_scales=5e-3, quaternions=1e-3, opacity_logits=1e-2, sh_dc=5e-3),
    density=DensitySettings(begin=0.1, end=0.6),
)
"""The fit of a placed object: its gaussians lie on its surface already and only grow together."""

GROW = with_changes(REFIT, iterations=1200)
"""The fit of an imagined object: its surface is a first guess, so it takes what edits take in the field."""


@dataclass(frozen=True)
class ReplaceSettings:
    """How an object is replaced.

    Attributes:
        removal: How the old one is taken out.
        placing: How the new one meets the scene.
        settle: Fit of the new one, if it is placed.
        grow: Fit of the new one, if it is imagined; `removal` says how that is sampled and refined.
    """

    removal: RemoveSettings = field(default_factory=RemoveSettings)
    placing: placing.PlacingSettings = field(default_factory=placing.PlacingSettings)
    settle: FitSettings = SETTLE
    grow: FitSettings = GROW


@dataclass(frozen=True, eq=False)
class ReplaceResult:
    """What a replacement leaves.

    Attributes:
        gaussians: The scene with the new object.
        source: The scene before the edit.
        run: The run folder, with views, masks, metrics and stages.
    """

    gaussians: Gaussians
    source: Gaussians
    run: Run


def replace(
    scene: Scene,
    prompt: str,
    run: Run,
    settings: ReplaceSettings | None = None,
    *,
    asset: Asset | None = None,
    prior: Prior | None = None,
    free_text: bool = False,
    negative: str = "",
    estimator: DepthEstimator | None = None,
    marks: Marks = OWN_MASKS,
    seed: int = 0,
    effects: Mapping[str, bool | int] | None = None,
) -> ReplaceResult:
    """Put another object in place of the masked one.

    Args:
        scene: With masks in at least one training view.
        prompt: A built-in solid and material, such as "a wooden cube", or free text; not read if an asset is
            given.
        run: Where stages and results go; finished stages of an interrupted run are taken up.
        settings: How.
        asset: The new object, from `objects.asset.read_asset`.
        prior: What invents the part that no view saw behind the old one; `ExemplarPrior` if None.
        free_text: Whether the prior invents the new object, too, from whatever the prompt says.
        negative: What it shall then go away from.
        estimator: What then estimates its depth; if None, its gaussians start on the old object's surface.
        marks: Boxes or words that say where the object is; the scene's masks do if there are none.
        seed: Same scene, prompt, asset, settings and seed: same bytes.
        effects: Effects on which the user insists, by name; the scene decides on the others.

    Raises:
        InputError: no view has a mask, the masks lift to nothing, there are fewer views than references, or
            the prompt names no built-in solid and material, or nothing that the prior understands.
    """
    settings = settings or ReplaceSettings()
    prior = prior or ExemplarPrior()
    removal, words = settings.removal, None
    method = removal.method_for(prior)
    if asset is None and free_text:
        words = FreeText.of(prior, prompt, negative, "replace", method)
        removal = with_changes(removal, method=with_changes(method, distillation=None))
    elif asset is None:
        asset = solid_of(prompt, seed)
    for note in asset.notes if asset else ():
        run.note(note)
    scene = marking.mark(run, scene, marks)
    stages.check_edit(scene, method.references)
    taken = take_out(scene, run, removal, prior, marks, seed, effects)
    sights = recolouring.look_at_object(run, taken.views, taken.source, taken.rows)
    if asset is not None:
        edited = _placed(run, taken, sights, asset, settings, seed)
        made = "settle", "place"
    else:
        assert words is not None
        edited = _imagined(run, taken, sights, words, estimator, settings, seed)
        made = "distil" if method.distillation else "grow", stages.LIFT
    stages.show_views(run, taken.scene, taken.source, edited)
    stages.finish(run, *made)
    return ReplaceResult(edited, taken.source, run)


def _placed(
    run: Run, taken: TakenOut, sights: Sequence[Sight], asset: Asset, settings: ReplaceSettings, seed: int
) -> Gaussians:
    """The scene with an asset in the old object's place."""
    others = stages.with_lifted_masks(run, taken.scene.test_views)
    staged = placing.place_object(run, taken.views, others, sights, taken.gaussians, asset, settings.placing)
    return placing.settle(run, staged, taken.scene.extent, settings.settle, seed)


def _imagined(
    run: Run, taken: TakenOut, sights: Sequence[Sight], words: FreeText, estimator: DepthEstimator | None,
    settings: ReplaceSettings, seed: int,
) -> Gaussians:  # fmt: skip
    """The scene with what a prior imagines in the old object's place."""
    extent, references = taken.scene.extent, taken.references
    images = imagining.imagine(run, taken.views, sights, taken.gaussians, references, words)
    imagined = imagining.measure(run, taken.views, sights, images, taken.gaussians, estimator)
    grown = imagining.grow(run, taken.gaussians, imagined, references, extent, settings.grow, seed)
    if words.method.distillation is None:
        return grown
    held = torch.arange(len(grown)) < len(taken.gaussians)
    return fine.distil(
        run, grown, held, [each.target for each in imagined], [stages.mask_of(view) for view in taken.views],
        references, words.prior, words.guidance, words.method.distillation, extent, settings.removal.distil,
        seed, windowed=True,
    )  # fmt: skip


def replace_command(
    scene: Path, prompt: str | None, exemplar: Path | None, asset: Path | None, out: Path, masks: Path | None,
    mask_boxes: Sequence[Sequence[str]], mask_prompt: str | None, mask_models: Path | None,
    image_scale: float, iterations: int | None, hold_out: int,
    seed: int, resume: bool, effects: Mapping[str, bool | int], accuracy: str, choices: Choices,
) -> Run:  # fmt: skip
    """`diga3d replace`: read the capture, replace the object, measure, and leave a run folder.

    Raises:
        InputError: the input or the run folder is not usable.
    """
    free_text = asset is None and reads_free_text(choices)
    if exemplar is not None and (asset is not None or free_text):
        raise InputError(
            "--exemplar is the material of a built-in solid: give --prompt with --prior exemplar or classical"
        )
    new = estimator = None
    if asset is not None:
        new = read_asset(asset)
    elif not free_text:
        new = solid_of(prompt or "", seed, exemplar)
    # The negative prompt of free text is the new object's, not that of the hole behind it.
    prior = (with_changes(choices, negative="") if free_text else choices).load("remove")
    method = choices.method(prior)
    if free_text:
        FreeText.of(prior, prompt or "", choices.negative, "replace", method)  # refuses before a long fit
        estimator = DepthEstimator.if_downloaded()
    marks = read_marks(masks, mask_boxes, mask_prompt, mask_models)
    capture = load_scene(scene, image_scale=image_scale, masks=masks, hold_out=hold_out, progress=True)
    removal = RemoveSettings(
        fit=fit_settings(capture, iterations, ACCURACIES[accuracy]),
        refit=with_changes(REFIT, accuracy=ACCURACIES[accuracy]),
        distil=with_changes(DISTIL, accuracy=ACCURACIES[accuracy]),
        method=method,
    )
    settings = ReplaceSettings(
        removal,
        settle=with_changes(SETTLE, accuracy=ACCURACIES[accuracy]),
        grow=with_changes(GROW, accuracy=ACCURACIES[accuracy]),
    )
    stages.check_edit(marking.glance(capture, marks), method.references)
    run = Run(
        out,
        "replace",
        {
            "scene": scene, "prompt": prompt, "exemplar": exemplar, "asset": asset, "masks": masks,
            **marks.settings(), "image_scale": image_scale, "hold_out": hold_out,
            "seed": seed, "iterations": removal.fit.iterations, "accuracy": accuracy,
            "effects": format_overrides(effects), "depth_estimated": estimator is not None,
            **asdict(choices), **method.summary(),
        },
        resume=resume,
    )  # fmt: skip
    if free_text and estimator is None:
        run.note(f"the new object starts on the old one's surface; to estimate its depth: {DPT.command}")
    replace(
        capture, prompt or "", run, settings, asset=new, prior=prior, free_text=free_text,
        negative=choices.negative, estimator=estimator, marks=marks, seed=seed, effects=effects,
    )  # fmt: skip
    conclude(run, capture)
    return run
