"""The fine stage (paper Sec. 3.4): score distillation under texture and depth warped from the references."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from diga3d_warp.config import Effects
from diga3d_warp.gaussians.fit import FitSettings, fit
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.gaussians.representation import Representation
from diga3d_warp.gaussians.surround import render_before
from diga3d_warp.gaussians.target import Target
from diga3d_warp.pipelines import stages
from diga3d_warp.pipelines.method import Method
from diga3d_warp.pipelines.run import Run
from diga3d_warp.priors.conditioning import Guidance
from diga3d_warp.priors.distillation import TextureGeometryGuide
from diga3d_warp.priors.protocol import DiffusionPrior
from diga3d_warp.priors.views import known_part
from diga3d_warp.priors.windows import Windows
from diga3d_warp.propagation.conditions import texture_geometry
from diga3d_warp.propagation.references import References


def distil(
    run: Run,
    source: Representation,
    held: torch.Tensor,
    targets: Sequence[Target],
    masks: Sequence[np.ndarray],
    references: References,
    prior: DiffusionPrior,
    guidance: Guidance,
    method: Method,
    extent: float,
    settings: FitSettings,
    seed: int,
    *,
    known: Sequence[np.ndarray] | None = None,
) -> Representation:
    """Refine an edit by TG-SDS beside its photometric and depth losses.

    Args:
        run: Run folder that receives the stage.
        source: The edited scene, N gaussians or anchors.
        held: Gaussians or anchors that keep their values, shape (N,), bool.
        targets: The edited views, with the depth of the edit.
        masks: Where each view was edited, shape (H, W), bool; only these pixels get the prior's gradient.
        references: Each view is conditioned on texture and depth warped from the reference of its cluster.
        prior: The diffusion prior.
        guidance: Prompts of the edit, and guidance scale.
        method: With `distillation`, and the weights of texture and depth.
        extent: Extent of the scene [scene units].
        settings: Iterations, budget and learning rates of the fit.
        seed: Seed of the fit and of the noise.
        known: Photographs that condition the prior outside the masks, shape (H, W, 3); within them they still
            show the object, which a prior may steer away from. If None, renderings of `source` do.
    """

    def compute(folder: Path) -> None:
        shell = stages.shell_of(run)
        guided = guided_targets(
            source, targets, masks, references, prior, guidance, method, run.effects, known, shell
        )  # fmt: skip
        result = fit(
            source, guided, extent, settings, effects=run.effects, seed=seed, held=held,
            surround=shell,
            checkpoint=folder / "checkpoint.pt", note=run.note, progress=True, label="distil",
        )  # fmt: skip
        stages.keep_fit(run, folder, result)

    return stages.fitted(run, "distil", compute)


def guided_targets(
    source: Representation, targets: Sequence[Target], masks: Sequence[np.ndarray], references: References,
    prior: DiffusionPrior, guidance: Guidance, method: Method, effects: Effects,
    known: Sequence[np.ndarray] | None, shell: Gaussians | None = None,
) -> list[Target]:  # fmt: skip
    """Targets with a TG-SDS guide in each view that has a mask; arguments as `distil`, and the surround.

    The prior is given the windows around the masks in which it filled or edited the views.
    """
    assert method.distillation is not None, "without it there is no fine stage"
    if not any(mask.any() for mask in masks):
        return list(targets)
    windows = Windows.around([torch.from_numpy(mask) for mask in masks], prior)
    places = dict(zip(windows.views, windows.places, strict=True))
    depths = {j: _depth_of(source, targets[j], effects, shell) for j in references.indices}
    guided = []
    for i, (target, seen) in enumerate(zip(targets, masks, strict=True)):
        if i not in places:
            guided.append(target)
            continue
        j = references.indices[int(references.cluster[i])]
        color, depth = _shown(source, target, effects, shell)
        mask, window = torch.from_numpy(seen), places[i]
        size = prior.native_size(*mask[window].shape)
        controls = texture_geometry(
            targets[j].color, depths[j], targets[j].camera, color, depth, mask, target.camera, window, size,
            method.scales,
        )  # fmt: skip
        followed = tuple(control for control in controls if control.kind in prior.control_kinds)
        given = color.clamp(0.0, 1.0) if known is None else torch.from_numpy(known[i])
        cond = known_part(prior, given[window], mask[window], size).rows([0], torch.device("cpu"))
        guide = TextureGeometryGuide(prior, mask, guidance, followed, cond, method.distillation, window)
        guided.append(replace(target, guide=guide))
    return guided


def _shown(
    source: Representation, target: Target, effects: Effects, shell: Gaussians | None
) -> tuple[torch.Tensor, torch.Tensor]:
    """Colour (H, W, 3) and z (H, W) of the edited scene in a view."""
    rendering = render_before(shell, source, target.camera, replace(effects, depth=True))
    return rendering.color, rendering.depth


def _depth_of(
    source: Representation, target: Target, effects: Effects, shell: Gaussians | None
) -> torch.Tensor:
    """z of a reference, shape (H, W): the fill's where there is one, the splat's elsewhere."""
    _, splat = _shown(source, target, effects, shell)
    return splat if target.depth is None else torch.where(target.depth > 0.0, target.depth, splat)
