"""Put another object in place of one in a scene.

fit ... distil  the old object taken out, as in `remove`
look            the old object in every view: its surface tells place, size and light
place           the new object on the support, with its shadow, drawn into every view
settle          new object and shaded floor fitted to those views
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from dataclasses import replace as with_changes
from pathlib import Path

from diga3d_warp.config import ACCURACIES
from diga3d_warp.effects.overrides import format_overrides
from diga3d_warp.errors import InputError
from diga3d_warp.gaussians.density import DensitySettings
from diga3d_warp.gaussians.fit import FitSettings
from diga3d_warp.gaussians.optimiser import LearningRates
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.objects.asset import Asset, read_asset
from diga3d_warp.objects.solids import solid_of
from diga3d_warp.pipelines import marking, placing, recolouring, stages
from diga3d_warp.pipelines.fit import conclude, fit_settings
from diga3d_warp.pipelines.marking import OWN_MASKS, Marks, read_marks
from diga3d_warp.pipelines.method import Choices
from diga3d_warp.pipelines.remove import DISTIL, REFIT, RemoveSettings, take_out
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
"""The fit of the new object: its gaussians lie on its surface already and only grow together."""


@dataclass(frozen=True)
class ReplaceSettings:
    """How an object is replaced.

    Attributes:
        removal: How the old one is taken out.
        placing: How the new one meets the scene.
        settle: Fit of the new one.
    """

    removal: RemoveSettings = field(default_factory=RemoveSettings)
    placing: placing.PlacingSettings = field(default_factory=placing.PlacingSettings)
    settle: FitSettings = SETTLE


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
    marks: Marks = OWN_MASKS,
    seed: int = 0,
    effects: Mapping[str, bool | int] | None = None,
) -> ReplaceResult:
    """Put another object in place of the masked one.

    Args:
        scene: With masks in at least one training view.
        prompt: A built-in solid and material, such as "a wooden cube"; not read if an asset is given.
        run: Where stages and results go; finished stages of an interrupted run are taken up.
        settings: How.
        asset: The new object, from `objects.asset.read_asset`.
        prior: What invents the part that no view saw behind the old one; `ExemplarPrior` if None.
        marks: Boxes or words that say where the object is; the scene's masks do if there are none.
        seed: Same scene, prompt, asset, settings and seed: same bytes.
        effects: Effects on which the user insists, by name; the scene decides on the others.

    Raises:
        InputError: no view has a mask, the masks lift to nothing, there are fewer views than references, or
            the prompt names no built-in solid and material.
    """
    settings = settings or ReplaceSettings()
    prior = prior or ExemplarPrior()
    asset = asset or solid_of(prompt, seed)
    scene = marking.mark(run, scene, marks)
    stages.check_edit(scene, settings.removal.method_for(prior).references)
    taken = take_out(scene, run, settings.removal, prior, marks, seed, effects)
    sights = recolouring.look_at_object(run, taken.views, taken.source, taken.rows)
    others = stages.with_lifted_masks(run, taken.scene.test_views)
    staged = placing.place_object(run, taken.views, others, sights, taken.gaussians, asset, settings.placing)
    edited = placing.settle(run, staged, scene.extent, settings.settle, seed)
    stages.show_views(run, taken.scene, taken.source, edited)
    stages.finish(run, "settle", masks="place")
    return ReplaceResult(edited, taken.source, run)


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
    if asset is not None and exemplar is not None:
        raise InputError("--exemplar is the material of a built-in solid: give --prompt instead of --asset")
    new = read_asset(asset) if asset is not None else solid_of(prompt or "", seed, exemplar)
    prior = choices.load("remove")
    method = choices.method(prior)
    marks = read_marks(masks, mask_boxes, mask_prompt, mask_models)
    capture = load_scene(scene, image_scale=image_scale, masks=masks, hold_out=hold_out, progress=True)
    removal = RemoveSettings(
        fit=fit_settings(capture, iterations, ACCURACIES[accuracy]),
        refit=with_changes(REFIT, accuracy=ACCURACIES[accuracy]),
        distil=with_changes(DISTIL, accuracy=ACCURACIES[accuracy]),
        method=method,
    )
    settings = ReplaceSettings(removal, settle=with_changes(SETTLE, accuracy=ACCURACIES[accuracy]))
    stages.check_edit(marking.glance(capture, marks), method.references)
    run = Run(
        out,
        "replace",
        {
            "scene": scene, "prompt": prompt, "exemplar": exemplar, "asset": asset, "masks": masks,
            **marks.settings(), "image_scale": image_scale, "hold_out": hold_out,
            "seed": seed, "iterations": removal.fit.iterations, "accuracy": accuracy,
            "effects": format_overrides(effects), **asdict(choices), **method.summary(),
        },
        resume=resume,
    )  # fmt: skip
    replace(
        capture, prompt or "", run, settings, asset=new, prior=prior, marks=marks, seed=seed,
        effects=effects,
    )  # fmt: skip
    conclude(run, capture)
    return run
