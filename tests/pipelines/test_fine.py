"""The fine stage: the prior's gradient reaches what was invented, and nothing else."""

from __future__ import annotations

import weakref
from dataclasses import replace

import numpy as np
import torch
from tiny_removal import SETTINGS

from diga3d_warp.config import Effects
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.gaussians.surround import render_before
from diga3d_warp.gaussians.target import Target
from diga3d_warp.pipelines import coarse, fine
from diga3d_warp.pipelines.method import PAPER
from diga3d_warp.pipelines.run import Run
from diga3d_warp.priors.distillation import DistillationSettings
from diga3d_warp.priors.exemplar.prior import ExemplarPrior
from diga3d_warp.priors.windows import Windows
from diga3d_warp.propagation.references import References
from diga3d_warp.propagation.unseen import Background
from diga3d_warp.splatting.render import render
from diga3d_warp.state import read_mask
from scenes import camera_at, random_gaussians


def distilled(removed, tmp_path, weight):
    stages = removed.folder / "stages"
    run = Run(tmp_path / f"run{weight}", "remove", {})
    run.effects = removed.result.run.effects
    source = Gaussians.load_ply(stages / "refit" / "point_cloud.ply")
    free = torch.from_numpy(np.load(stages / "clear" / "free.npy"))
    held = torch.nn.functional.pad(~free, (0, len(source) - len(free)))
    views = removed.working.views
    fills = coarse.read_fills(stages / "propagate", views)
    unseen = [read_mask(stages / "look-behind" / f"{view.name}.unseen.png") for view in views]
    cluster = np.arange(len(views)) % 2
    prior = ExemplarPrior()
    backgrounds = [Background(seen, fill.image, ~seen) for seen, fill in zip(unseen, fills, strict=True)]
    targets = coarse.targets_of(views, backgrounds, fills)
    method = replace(PAPER, distillation=DistillationSettings(weight=weight))
    found = fine.distil(
        run, source, held, targets, unseen, References([0, 1], cluster), prior, prior.guidance, method,
        1.0, replace(SETTINGS.distil, iterations=14), 0,
    )  # fmt: skip
    return source, held, found, unseen


def test_the_fine_stage_shakes_no_gaussian(removed, tmp_path):
    """It has no density control: one too faint to be drawn stays where it is, to the bit."""
    source = Gaussians.load_ply(removed.folder / "stages" / "refit" / "point_cloud.ply")
    source.opacity_logits[:50] = -8.0
    run = Run(tmp_path / "run", "remove", {})
    run.effects = removed.result.run.effects
    targets = [Target(view.camera, torch.from_numpy(view.pixels)) for view in removed.working.views]
    nowhere = [np.zeros(view.pixels.shape[:2], bool) for view in removed.scene.views]
    prior, cluster = ExemplarPrior(), np.zeros(len(targets), int)
    found = fine.distil(
        run, source, torch.zeros(len(source), dtype=torch.bool), targets, nowhere, References([0], cluster),
        prior, prior.guidance, PAPER, 1.0, replace(SETTINGS.distil, iterations=3), 0,
    )  # fmt: skip
    assert torch.equal(found.means[:50], source.means[:50])
    assert not torch.equal(found.means[50:], source.means[50:])


def test_guides_hold_no_renderings(monkeypatch):
    """A rendering keeps all projected gaussians: of the views, only one at a time may be there."""
    alive, most = weakref.WeakSet(), []

    def watched(*arguments, **options):
        rendering = render_before(*arguments, **options)
        alive.add(rendering.alpha)
        most.append(len(alive))
        return rendering

    monkeypatch.setattr(fine, "render_before", watched)
    camera = camera_at(width=32, height=24)
    targets = [Target(camera, torch.zeros(24, 32, 3, dtype=torch.uint8)) for _ in range(8)]
    masks = [np.ones((24, 32), bool) for _ in targets]
    prior, cluster = ExemplarPrior(), np.arange(8) % 2
    guided = fine.guided_targets(
        random_gaussians(50), targets, masks, References([0, 1], cluster), prior, prior.guidance,
        PAPER, Effects(), None,
    )  # fmt: skip
    assert len(guided) == 8 and all(target.guide is not None for target in guided)
    assert max(most) <= 2


def test_distillation_moves_what_was_invented(removed, tmp_path):
    source, held, without, unseen = distilled(removed, tmp_path, 0.0)
    _, _, found, _ = distilled(removed, tmp_path, 1e-3)
    assert torch.equal(found.means[held], source.means[held])
    assert torch.equal(found.sh[held], source.sh[held])
    changes = []
    for view, mask in zip(removed.working.views, unseen, strict=True):
        with torch.no_grad():
            a, b = (render(g, view.camera).color.numpy() for g in (without, found))
        change = np.abs(a - b).mean(-1)
        changes.append((change[mask].mean(), change[~mask].mean()))
    inside, outside = np.mean(changes, axis=0)
    assert inside > 2e-3 and inside > 5.0 * outside


class Short(ExemplarPrior):
    """A prior that is shown images at a short side of 32 px."""

    def native_size(self, height, width):
        scale = 32 / min(height, width)
        return round(height * scale), round(width * scale)


def test_an_edit_is_distilled_in_the_windows_it_was_edited_in():
    """A small object is shown to the prior as large as `edit_views` shows it."""
    camera = camera_at(width=64, height=48)
    targets = [Target(camera, torch.full((48, 64, 3), 90, dtype=torch.uint8)) for _ in range(3)]
    masks = [np.zeros((48, 64), bool) for _ in targets]
    masks[0][20:30, 40:50] = masks[1][0:6, 0:8] = True
    prior, cluster = Short(), np.zeros(3, int)
    options = (prior, prior.guidance, PAPER, Effects(), None)
    guided = fine.guided_targets(random_gaussians(50), targets, masks, References([0], cluster), *options)
    windows = Windows.around([torch.from_numpy(mask) for mask in masks], prior)
    guides = [target.guide for target in guided]
    assert guides[2] is None, "no mask, no window"
    assert [guide.window for guide in guides[:2]] == windows.places
    for guide in guides[:2]:
        assert guide.mask[guide.window].sum() == guide.mask.sum()
        assert {tuple(control.image.shape) for control in guide.controls} == {(1, 32, 32)}
        loss = guide(torch.rand(48, 64, 3), 0.5, torch.Generator().manual_seed(0))
        assert loss.isfinite() and loss > 0.0
