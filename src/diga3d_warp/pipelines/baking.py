"""The result of a run as a standard splat: gaussians as they are, anchors baked to gaussians."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypedDict

import numpy as np
import torch

from diga3d_warp.evaluation.record import RESULT, SOURCE
from diga3d_warp.files import to_bytes, write_array, write_json
from diga3d_warp.gaussians.density import DensitySettings
from diga3d_warp.gaussians.fit import FitSettings, fit
from diga3d_warp.gaussians.optimiser import LearningRates
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.gaussians.representation import Representation
from diga3d_warp.gaussians.scaffold.anchors import Scaffold
from diga3d_warp.gaussians.scaffold.bake import bake
from diga3d_warp.gaussians.scaffold.same import same_anchors
from diga3d_warp.gaussians.storage import load
from diga3d_warp.gaussians.target import Target
from diga3d_warp.pipelines import stages
from diga3d_warp.pipelines.clearing import Masks, read_masks
from diga3d_warp.pipelines.run import Run
from diga3d_warp.scene.scene import Scene, View
from diga3d_warp.splatting.render import render
from diga3d_warp.splatting.shade import coefficient_count
from diga3d_warp.state import read_array, read_state

BAKE = FitSettings(
    iterations=300,
    budget=0,
    opacity_weight=0.0,
    scale_weight=0.0,
    coarse_part=0.0,
    sh_steps=(0.0, 0.0, 0.0),
    rates=LearningRates(means=2e-5, log_scales=5e-3, quaternions=1e-3, opacity_logits=2e-2, sh_dc=2.5e-3),
    density=DensitySettings(end=0.0),
)
"""The fit of baked gaussians to renderings of the anchors: they lie where they should, so means hardly move,
and none is relocated or perturbed by noise."""

VIEWS_MOST = 80
"""Views whose directions are baked, spread over the capture: their renderings are held in memory."""

OWNERS, LOSS = "owners.npy", "loss.json"


class LossRecord(TypedDict):
    """What baking loses, over the training views and outside the edit.

    Attributes:
        anchors, baked: PSNR of the anchors and of the baked gaussians against the photographs [dB].
        loss: Their difference [dB].
        agreement: PSNR of the baked gaussians against renderings of the anchors [dB].
        gaussians: Their number.
    """

    anchors: float
    baked: float
    loss: float
    agreement: float
    gaussians: int


@dataclass(frozen=True, eq=False)
class Plain:
    """A splat of standard gaussians.

    Attributes:
        gaussians: In working units, without the surround.
        stage: The stage whose folder holds them.
    """

    gaussians: Gaussians
    stage: str


def baked(
    run: Run, stage: str, views: Sequence[View], seed: int, name: str,
    masks: Masks | None = None, before: Plain | None = None,
) -> Plain:  # fmt: skip
    """Standard gaussians of a splat, by a stage of their own if it has anchors.

    Args:
        run: Run folder that receives the stage, and a note of what baking lost.
        stage: The stage that made gaussians, which are taken as they are, or anchors.
        views: Training views; photographs as the splat shows them, without their exposure.
        seed: Seed of the fit.
        name: File that they will be published in.
        masks: Where the splat no longer shows the photographs, by name; None for nowhere.
        before: The splat before an edit, baked: anchors that are still the same keep its gaussians.
    """
    splat = load(run.folder / "stages" / stage)
    if not isinstance(splat, Scaffold):
        assert isinstance(splat, Gaussians)
        return Plain(splat, stage)
    chosen = [views[row] for row in _spread(len(views))]

    def compute(folder: Path) -> None:
        gaussians, owners, held = _start(run, splat, chosen, before)
        pictures = [_picture(run, splat, view) for view in chosen]
        targets = [
            Target(view.camera, torch.from_numpy(to_bytes(picture)))
            for view, picture in zip(chosen, pictures, strict=True)
        ]
        result = fit(
            gaussians, targets, 1.0, BAKE, effects=replace(run.effects, exposure=False), seed=seed,
            held=held, checkpoint=folder / "checkpoint.pt", note=run.note, progress=True, label="bake",
        )  # fmt: skip
        stages.keep_fit(run, folder, result)
        write_array(folder / OWNERS, owners)
        write_json(folder / LOSS, _loss(run, splat, result.gaussians, chosen, masks or {}))

    made = f"bake-{stage}"
    folder = run.stage(made, compute)
    loss = read_state(folder / LOSS, LossRecord)
    run.add_metrics(made, dict(loss))
    run.note(
        f"{name}: {len(splat)} anchors baked to {loss['gaussians']} gaussians, which loses "
        f"{loss['loss']:.2f} dB of {loss['anchors']:.2f} dB on the training views"
    )
    gaussians = load(folder)
    assert isinstance(gaussians, Gaussians)
    return Plain(gaussians, made)


def publish_edit(run: Run, scene: Scene, stage: str, masks: str, seed: int) -> tuple[Gaussians, Gaussians]:
    """Pictures, splats and masks of an edit, in the user's world.

    Args:
        run: The run.
        scene: The capture, with the cameras in use.
        stage: The stage that made the edited splat.
        masks: The stage that made the masks of all that was edited.
        seed: Seed of the fits of baked gaussians.

    Returns:
        The final splat and the one before the edit.
    """
    before = baked(run, "fit", scene.views, seed, SOURCE)
    changed = read_masks(run.folder / "stages" / masks / "masks", scene.views)
    after = baked(run, stage, scene.views, seed, RESULT, changed, before)
    stages.show_views(run, scene, before.gaussians, after.gaussians)
    return stages.finish(run, after.stage, masks, before.stage)


def _spread(count: int) -> np.ndarray:
    return np.linspace(0, count - 1, min(VIEWS_MOST, count)).round().astype(int)


def _start(
    run: Run, splat: Scaffold, views: Sequence[View], before: Plain | None
) -> tuple[Gaussians, torch.Tensor, torch.Tensor | None]:
    """Baked gaussians to start from, the anchor of each, and which are those of the splat before an edit."""
    cameras, coefficients = [view.camera for view in views], coefficient_count(run.effects.sh_degree)
    if before is None:
        fresh = bake(splat, cameras, coefficients, run.effects)
        return fresh.gaussians, fresh.owners, None
    earlier = load(run.folder / "stages" / before.stage.removeprefix("bake-"))
    assert isinstance(earlier, Scaffold)
    owners = torch.from_numpy(read_array(run.folder / "stages" / before.stage / OWNERS))
    now = same_anchors(earlier, splat)[owners]
    kept, fresh = now >= 0, bake(splat, cameras, coefficients, run.effects)
    others = ~torch.isin(fresh.owners, now[kept])
    gaussians = before.gaussians.select(kept).joined(fresh.gaussians.select(others))
    held = torch.arange(len(gaussians)) < int(kept.sum())
    return gaussians, torch.cat([now[kept], fresh.owners[others]]), held


@torch.no_grad()
def _picture(run: Run, splat: Representation, view: View) -> torch.Tensor:
    """A rendering over black, shape (H, W, 3)."""
    return render(splat, view.camera, effects=replace(run.effects, depth=False)).color.clamp(0.0, 1.0)


def _loss(
    run: Run, anchors: Scaffold, gaussians: Representation, views: Sequence[View],
    masks: Masks,
) -> LossRecord:  # fmt: skip
    """PSNR of both against the photographs outside the masks, and of one against the other."""
    shell, sums, count = stages.shell_of(run), np.zeros(3), 0
    for view in views:
        first, second = (stages.shown(each, shell, view.camera, run.effects) for each in (anchors, gaussians))
        outside = ~masks[view.name] if view.name in masks else np.ones(first.shape[:2], bool)
        pairs = ((first, view.pixels), (second, view.pixels), (first, second))
        sums += [float(((a[outside].astype(np.float64) - b[outside]) ** 2).sum()) for a, b in pairs]
        count += 3 * int(outside.sum())
    errors = np.maximum(sums / max(count, 1) / 255.0**2, 1e-12)
    of_anchors, of_baked, between = (-10.0 * np.log10(errors)).tolist()
    return {
        "anchors": of_anchors, "baked": of_baked, "loss": of_anchors - of_baked, "agreement": between,
        "gaussians": len(gaussians),
    }  # fmt: skip
