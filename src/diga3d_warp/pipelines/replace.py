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

if __name__ == "__main__":  # first of all, because the command tunes the process before torch is imported
    import sys

    from diga3d_warp.cli import main

    sys.exit(main(["replace", *sys.argv[1:]]))

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from dataclasses import replace as with_changes
from pathlib import Path
from typing import Any

import torch

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
from diga3d_warp.pipelines.contents import everything
from diga3d_warp.pipelines.fit import conclude
from diga3d_warp.pipelines.free_text import FreeText, reads_free_text
from diga3d_warp.pipelines.marking import OWN_MASKS, Marks
from diga3d_warp.pipelines.remove import REFIT, RemoveSettings, TakenOut, remove_settings, take_out
from diga3d_warp.pipelines.request import EditRequest, EditResult, optional_path
from diga3d_warp.pipelines.run import Run
from diga3d_warp.priors.exemplar.prior import ExemplarPrior
from diga3d_warp.priors.protocol import Prior
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


def replace_object(
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
) -> EditResult:
    """Run the stages of a replacement in an open run folder; `replace` also reads, checks and measures.

    Args:
        scene: With masks in at least one training view.
        prompt: A built-in solid and material, such as "a wooden cube", or free text; not read if an asset is
            given.
        run: Run folder that receives stages and results; finished stages of an interrupted run are reused.
        settings: Removal of the old object, and fits of the new one.
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
    run.hold_to(**everything(scene, settings, seed, effects, prior, method))
    scene = marking.mark(run, scene, marks)
    stages.check_edit(scene, method.references)
    taken = take_out(scene, run, removal, prior, marks, seed, effects)
    sights = recolouring.look_at_object(run, taken.scene.views, taken.source, taken.rows)
    if asset is not None:
        edited = _placed(run, taken, sights, asset, settings, seed)
        made = "settle", "place"
    else:
        assert words is not None
        edited = _imagined(run, taken, sights, words, estimator, settings, seed)
        made = "distil" if method.distillation else "grow", stages.LIFT
    stages.show_views(run, taken.scene, taken.source, edited)
    edited, source = stages.finish(run, *made)
    return EditResult(edited, run, source)


def _placed(
    run: Run, taken: TakenOut, sights: Sequence[Sight], asset: Asset, settings: ReplaceSettings, seed: int
) -> Gaussians:
    """The scene with an asset in the old object's place."""
    staged = placing.place_object(
        run, taken.scene.views, taken.scene.test_views, taken.edit_masks, sights, taken.gaussians, asset,
        settings.placing,
    )  # fmt: skip
    return placing.settle(run, staged, taken.scene.extent, settings.settle, seed)


def _imagined(
    run: Run, taken: TakenOut, sights: Sequence[Sight], words: FreeText, estimator: DepthEstimator | None,
    settings: ReplaceSettings, seed: int,
) -> Gaussians:  # fmt: skip
    """The scene with what a prior imagines in the old object's place."""
    extent, references, views = taken.scene.extent, taken.references, taken.scene.views
    masks = [taken.edit_masks[view.name] for view in views]
    images = imagining.imagine(run, views, masks, sights, taken.gaussians, references, words)
    imagined = imagining.measure(run, views, masks, sights, images, taken.gaussians, estimator)
    grown = imagining.grow(run, taken.gaussians, imagined, references, extent, settings.grow, seed)
    if words.method.distillation is None:
        return grown
    held = torch.arange(len(grown)) < len(taken.gaussians)
    return fine.distil(
        run, grown, held, [each.target for each in imagined], masks, references, words.prior,
        words.guidance, words.method.distillation, extent, settings.removal.distil, seed, windowed=True,
    )  # fmt: skip


def replace(
    scene: str | Path | Scene,
    prompt: str | None = None,
    *,
    out: str | Path,
    settings: ReplaceSettings | None = None,
    **options: Any,
) -> EditResult:
    """Put another object in place of the masked one of a capture, and measure the result.

    Args:
        scene: Folder or file of a capture, or a scene from `load_scene`.
        prompt: The new object: a built-in solid and material, such as "a wooden cube"; any text with a Stable
            Diffusion prior; None with an asset.
        out: Run folder, a new one unless `resume=True`.
        settings: Removal of the old object, and fits of the new one; chosen by the scene and the options if
            None.
        options: Further attributes of `EditRequest`, such as `asset`, `exemplar`, `prior`, `seed`, `resume`.

    Raises:
        InputError: the input or the run folder is not usable.
        TypeError: an option is unknown.
    """
    request = EditRequest(scene=scene, prompt=prompt, out=out, **options)
    words, exemplar = prompt or "", optional_path(request.exemplar)
    free_text = request.asset is None and reads_free_text(request)
    asset = _new_object(request, words, exemplar, free_text)
    # The negative prompt of free text is the new object's, not that of the hole behind it.
    prior = request.load_prior("remove", negative="" if free_text else None)
    method = request.choose_method(prior)
    estimator = None
    if free_text:
        FreeText.of(prior, words, request.negative, "replace", method)  # refuses before a long fit
        estimator = DepthEstimator.if_downloaded()
    marks = request.marks()
    capture = request.load()
    settings = settings or ReplaceSettings(
        remove_settings(capture, request, method),
        settle=with_changes(SETTLE, accuracy=request.knobs),
        grow=with_changes(GROW, accuracy=request.knobs),
    )
    method = settings.removal.method_for(prior)
    stages.check_edit(marking.glance(capture, marks), method.references)
    run = request.open_edit(
        "replace", capture, settings.removal.fit.iterations, marks, method, prompt=prompt, exemplar=exemplar,
        asset=optional_path(request.asset), depth_estimated=estimator is not None,
    )  # fmt: skip
    if free_text and estimator is None:
        run.note(f"the new object starts on the old one's surface; to estimate its depth: {DPT.command}")
    result = replace_object(
        capture, words, run, settings, asset=asset, prior=prior, free_text=free_text,
        negative=request.negative, estimator=estimator, marks=marks, seed=request.seed,
        effects=request.effects,
    )  # fmt: skip
    conclude(run, capture)
    return result


def _new_object(request: EditRequest, prompt: str, exemplar: Path | None, free_text: bool) -> Asset | None:
    """The asset or built-in solid that a request names; None if free text describes it.

    Raises:
        InputError: it is not usable, or a material is given that nothing would take.
    """
    if exemplar is not None and (request.asset is not None or free_text):
        raise InputError(
            "--exemplar is the material of a built-in solid: give --prompt with --prior exemplar or classical"
        )
    if request.asset is not None:
        return read_asset(Path(request.asset))
    return None if free_text else solid_of(prompt, request.seed, exemplar)
