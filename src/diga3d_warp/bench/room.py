"""The small synthetic room from which benchmarks remove a vase: shared stages and ground truth."""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import torch

from diga3d_warp.evaluation.metrics import Score, compare, mean_scores
from diga3d_warp.gaussians.fit import FitSettings
from diga3d_warp.pipelines.clearing import widened
from diga3d_warp.pipelines.demo import TRUTH
from diga3d_warp.pipelines.remove import DISTIL, REFIT, RemoveSettings
from diga3d_warp.pipelines.request import EditResult
from diga3d_warp.scene.photographs.images import read_image
from diga3d_warp.scene.scene import Scene, View
from diga3d_warp.scene.synthetic.generate import SyntheticScene
from diga3d_warp.splatting.render import render

ROOM = SyntheticScene(width=160, height=120, views=16, shadows=False, seed=0)
"""A quarter of the demo's pixels."""

HOLD_OUT = 4
BUDGET = 12_000
"""Gaussians of the fit: as many a pixel as in the demo."""

SETTINGS = RemoveSettings(
    fit=FitSettings(iterations=600, budget=BUDGET),
    refit=replace(REFIT, iterations=300),
    distil=replace(DISTIL, iterations=100),
)
"""Fewer iterations than a removal takes by default: a quarter of the pixels, and the gaussians of the hole
start on the filled surface."""

CAPTURED = ("effects", "fit", "lift", "mirror", "shadow", "clear", "look-behind")
"""Stages of a removal that depend on the capture and its masks only, not on how the hole is filled."""


def share_stages(source: Path, target: Path, names: Iterable[str] = CAPTURED) -> None:
    """Give a run folder the finished stages of another: those of the given names that it lacks."""
    for name in names:
        stage, copy = source / "stages" / name, target / "stages" / name
        if stage.is_dir() and not copy.exists():
            partial = copy.with_name(f".{name}.copy")
            shutil.copytree(stage, partial, dirs_exist_ok=True)
            partial.rename(copy)


def true_picture(scene: Scene, view: View) -> torch.Tensor:
    """What a view shows without the object, RGB in [0, 1], shape (H, W, 3), float32."""
    return torch.from_numpy(read_image(scene.path / TRUTH / f"{view.name}.png")).float() / 255.0


def against_truth(scene: Scene, result: EditResult, settings: RemoveSettings) -> dict[str, Score]:
    """Scores by region against the room without the object, mean over the held-out views."""
    scores, effects = [], replace(result.run.effects, depth=False)
    for view in scene.test_views:
        assert view.mask is not None, "the generator writes a mask for each view"
        with torch.no_grad():
            color = render(result.gaussians, view.camera, effects=effects).color
        scores.append(compare(color, true_picture(scene, view), widened(view.mask, settings.masking)))
    return mean_scores(scores)
