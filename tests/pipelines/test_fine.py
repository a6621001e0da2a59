"""The fine stage: the prior's gradient reaches what was invented, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from tiny_removal import SETTINGS

from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.pipelines import coarse, fine
from diga3d_warp.pipelines.run import Run
from diga3d_warp.pipelines.stages import read_mask
from diga3d_warp.priors.distillation import DistillationSettings
from diga3d_warp.priors.exemplar.prior import ExemplarPrior
from diga3d_warp.propagation.references import References
from diga3d_warp.splatting.render import render


def distilled(removed, tmp_path, weight):
    stages = removed.folder / "stages"
    run = Run(tmp_path / f"run{weight}", "remove", {})
    run.effects = removed.result.run.effects
    source = Gaussians.load_ply(stages / "refit" / "point_cloud.ply")
    free = torch.from_numpy(np.load(stages / "clear" / "free.npy"))
    held = torch.nn.functional.pad(~free, (0, len(source) - len(free)))
    views = removed.scene.views
    fills = coarse._kept(stages / "propagate", views)
    unseen = [read_mask(stages / "look-behind" / f"{view.name}.unseen.png") for view in views]
    cluster = np.arange(len(views)) % 2
    prior = ExemplarPrior()
    targets = coarse.targets_of(views, fills)
    found = fine.distil(
        run, source, held, targets, unseen, References([0, 1], cluster), prior, prior.guidance,
        DistillationSettings(weight=weight), 1.0, replace(SETTINGS.distil, iterations=14), 0,
    )  # fmt: skip
    return source, held, found, unseen


def test_distillation_moves_what_was_invented(removed, tmp_path):
    source, held, without, unseen = distilled(removed, tmp_path, 0.0)
    _, _, found, _ = distilled(removed, tmp_path, 1e-3)
    assert torch.equal(found.means[held], source.means[held])
    assert torch.equal(found.sh[held], source.sh[held])
    changes = []
    for view, mask in zip(removed.scene.views, unseen, strict=True):
        with torch.no_grad():
            a, b = (render(g, view.camera).color.numpy() for g in (without, found))
        change = np.abs(a - b).mean(-1)
        changes.append((change[mask].mean(), change[~mask].mean()))
    inside, outside = np.mean(changes, axis=0)
    assert inside > 2e-3 and inside > 5.0 * outside
