"""Change the material of an object of a scene; its shape and shading are kept.

effects      choice of the effects to simulate
fit          the splat of the capture; photographs then take its exposure
lift         masks lifted to the object's gaussians, and widened
look         the object rendered in every view: colour, alpha and depth
references   K views by k-means on camera centres
repaint      the new material in every view
refit        the object's gaussians, cut finer, fitted to the repainted views
distil       refined by score distillation, if a diffusion prior repainted

The new material is one of the built-in vocabulary, or free text for a diffusion prior.
"""

from __future__ import annotations

if __name__ == "__main__":  # first of all, because the command tunes the process before torch is imported
    import sys

    from diga3d_warp.cli import main

    sys.exit(main(["retexture", *sys.argv[1:]]))

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import torch

from diga3d_warp.errors import InputError
from diga3d_warp.gaussians.density import DensitySettings
from diga3d_warp.gaussians.fit import FitSettings
from diga3d_warp.gaussians.lift import LiftSettings
from diga3d_warp.gaussians.optimiser import LearningRates
from diga3d_warp.materials.vocabulary import Material
from diga3d_warp.objects.diffusion_repaint import DiffusionRepainter
from diga3d_warp.objects.picture import chosen_material
from diga3d_warp.objects.repaint import MaterialRepainter, Repainter
from diga3d_warp.pipelines import clearing, fine, marking, mask_propagation, recolouring, stages
from diga3d_warp.pipelines.baking import publish_edit
from diga3d_warp.pipelines.contents import everything
from diga3d_warp.pipelines.fit import conclude, requested_fit
from diga3d_warp.pipelines.free_text import FreeText, check_built_in, reads_free_text
from diga3d_warp.pipelines.marking import OWN_MASKS, Marks
from diga3d_warp.pipelines.method import WARPED, Method
from diga3d_warp.pipelines.remove import DISTIL
from diga3d_warp.pipelines.request import EditRequest, EditResult, optional_path
from diga3d_warp.pipelines.run import Run, sampling_bar, say
from diga3d_warp.priors.protocol import DiffusionPrior
from diga3d_warp.scene.scene import Scene

RECOLOUR = FitSettings(
    iterations=300,
    budget=0,  # the object was cut finer before
    depth_weight=0.1,
    coarse_part=0.0,
    sh_steps=(0.0, 0.0, 0.0),
    rates=LearningRates(means=5e-5, log_scales=5e-3, quaternions=1e-3, opacity_logits=1e-2, sh_dc=1e-2),
    density=DensitySettings(begin=0.1, end=0.6),
)
"""The fit of the object's colours. Its shape is right: means learn a tenth as fast as in a fit from points,
and depth holds them."""


@dataclass(frozen=True)
class RetextureSettings:
    """Settings of a retexture.

    Attributes:
        fit: Fit of the capture.
        refit: Fit of the object's colours.
        distil: Fit of the fine stage.
        split: Splitting of the object's gaussians before the fit.
        lift: Thresholds for assigning a gaussian to the object.
        masking: Dilation of the masks.
        method: References, sampling and distillation; None for the default of the prior. A diffusion prior
            propagates by "attention" or "none".
    """

    fit: FitSettings = field(default_factory=FitSettings)
    refit: FitSettings = RECOLOUR
    distil: FitSettings = DISTIL
    split: recolouring.SplitSettings = field(default_factory=recolouring.SplitSettings)
    lift: LiftSettings = field(default_factory=LiftSettings)
    masking: clearing.MaskSettings = field(default_factory=clearing.MaskSettings)
    method: Method | None = None


def retexture_object(
    scene: Scene,
    prompt: str,
    run: Run,
    settings: RetextureSettings | None = None,
    *,
    exemplar: Path | None = None,
    negative: str = "",
    prior: DiffusionPrior | None = None,
    marks: Marks = OWN_MASKS,
    seed: int = 0,
    effects: Mapping[str, bool | int] | None = None,
) -> EditResult:
    """Run the stages of a change of material in an open run folder; `retexture` also reads and measures.

    Args:
        scene: With masks in at least one training view.
        prompt: Such as "white marble"; without a prior, a word of the built-in vocabulary.
        run: Run folder that receives stages and results; finished stages of an interrupted run are reused.
        settings: Fits, masks and method.
        exemplar: A picture of the material, if no prior is given; the prompt is not read then.
        negative: Negative prompt.
        prior: Diffusion prior that repaints the object from free text; the built-in materials if None.
        marks: Boxes or a prompt that mark the object; empty uses the masks of the scene.
        seed: The same scene, prompt, settings and seed give the same bytes.
        effects: Effects forced on or off by the user, by name; the others are chosen from the scene.

    Raises:
        InputError: no view has a mask, the masks lift to nothing, there are fewer views than references, or
            the prompt names no built-in material, or none that the prior understands, or the picture is not
            usable.
    """
    settings = settings or RetextureSettings()
    words = None if prior is None else FreeText.of(prior, prompt, negative, "retexture", settings.method)
    method = words.method if words else settings.method or WARPED
    repainter = _repainter(words) if words else _painter(run, chosen_material(prompt, exemplar))
    run.hold_to(**everything(scene, settings, seed, effects, prior, method))
    scene = marking.mark(run, scene, marks)
    stages.check_edit(scene, method.references)
    scene = stages.begin(run, scene, effects)
    source = stages.fit_source(run, scene, settings.fit, seed)
    scene = stages.correct_exposure(run, scene)
    object_masks = mask_propagation.propagate_masks(run, scene, source, marks, settings.lift)
    source, rows, _ = clearing.lift_object(run, scene, object_masks, source, settings.lift, settings.masking)
    views = scene.views
    sights = recolouring.look_at_object(run, views, source, rows)
    references = stages.choose_references(run, views, [sight.touched for sight in sights], method, seed)
    images = recolouring.repaint(run, views, sights, references, repainter, seed)
    edited = recolouring.recolour(
        run, source, rows, sights, images, scene.extent, settings.refit, settings.split, seed
    )
    last = "refit"
    if words and method.distillation:
        held = torch.arange(len(edited)) < int((~rows).sum())
        edited = fine.distil(
            run, edited, held, recolouring.targets_of(sights, images), [sight.touched for sight in sights],
            references, words.prior, words.guidance, method, scene.extent, settings.distil, seed,
        )  # fmt: skip
        last = "distil"
    after, before = publish_edit(run, scene, last, stages.LIFT, seed)
    return EditResult(after, run, before)


def _repainter(words: FreeText) -> Repainter:
    bar = sampling_bar("repaint")
    return DiffusionRepainter(
        words.prior, words.guidance, words.sampling, scales=words.method.scales, inverted=words.inverted,
        say=say, progress=bar,
    )  # fmt: skip


def _painter(run: Run, material: Material) -> Repainter:
    for note in material.notes:
        run.note(note)
    return MaterialRepainter(material)


def retexture(
    scene: str | Path | Scene,
    prompt: str | None = None,
    *,
    out: str | Path,
    settings: RetextureSettings | None = None,
    **options: Any,
) -> EditResult:
    """Give the masked object of a capture the material of a prompt or a picture, and measure the result.

    Args:
        scene: Folder or file of a capture, or a scene from `load_scene`.
        prompt: The material, such as "white marble"; any text with a Stable Diffusion prior.
        out: Run folder, a new one unless `resume=True`.
        settings: Fits, masks and method; chosen by the scene and the options if None.
        options: Further attributes of `EditRequest`, such as `exemplar`, `prior`, `masks`, `seed`, `resume`.

    Raises:
        InputError: the input or the run folder is not usable.
        TypeError: an option is unknown.
    """
    request = EditRequest(scene=scene, prompt=prompt, out=out, **options)
    request.refuse("retexture", "asset", "fill")
    words, exemplar = prompt or "", optional_path(request.exemplar)
    prior = _prior(request, words, exemplar)
    method = replace(WARPED, references=request.references, selection=request.selection)
    if prior is not None:
        method = request.choose_method(prior, controlled=True)
        FreeText.of(prior, words, request.negative, "retexture", method)  # refuses before a long fit
    marks = request.marks()
    capture = request.load()
    settings = settings or RetextureSettings(
        fit=requested_fit(capture, request),
        refit=replace(RECOLOUR, accuracy=request.knobs),
        distil=replace(DISTIL, accuracy=request.knobs),
        method=method,
    )
    method = settings.method or method
    stages.check_edit(marking.quick_masks(capture, marks), method.references)
    run = request.open_edit(
        "retexture", capture, settings.fit.iterations, marks, method, prompt=prompt, exemplar=exemplar
    )
    result = retexture_object(
        capture, words, run, settings, exemplar=exemplar, negative=request.negative, prior=prior,
        marks=marks, seed=request.seed, effects=request.effects,
    )  # fmt: skip
    conclude(run, capture)
    return result


def _prior(request: EditRequest, prompt: str, exemplar: Path | None) -> DiffusionPrior | None:
    """The prior that reads the prompt; None for the built-in materials.

    Raises:
        InputError: no such prior, weights are missing, it does not understand the prompt, or the picture is
            not usable.
    """
    if reads_free_text(request):
        if exemplar is not None:
            raise InputError("--exemplar is painted without a prior: leave --prior out, or give --prompt")
        # The repainted views follow edges and depth, whether or not score distillation does later.
        prior = request.load_prior("retexture", prompt, controls=("edges", "depth"))
        assert isinstance(prior, DiffusionPrior), "all that read free text are"
        return prior
    if request.prior_name != "exemplar":
        raise InputError(
            f"prior {request.prior_name} has no materials: use exemplar, sd-inpainting or powerpaint"
        )
    chosen_material(prompt, exemplar)
    check_built_in(request)
    return None
