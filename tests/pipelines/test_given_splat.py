"""A capture that comes with a splat: drawn as its file says, and kept as it is."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import torch

from diga3d_warp.evaluation.record import read_manifest
from diga3d_warp.gaussians.fit import FitSettings
from diga3d_warp.gaussians.lift import LiftSettings
from diga3d_warp.pipelines import clearing, stages
from diga3d_warp.pipelines.run import Run
from diga3d_warp.scene.formats.read import read_splat
from diga3d_warp.scene.layouts.cameras_file import CameraSet, save_cameras
from diga3d_warp.scene.load import load_scene
from scenes import random_gaussians


def test_an_antialiased_splat_is_drawn_and_published_so(room, tmp_path, monkeypatch):
    scene = tmp_path / "scene"
    shutil.copytree(room, scene, ignore=shutil.ignore_patterns("ground_truth", "masks"))
    capture = load_scene(room)
    save_cameras(scene / "cameras.json", CameraSet.of(capture))
    shutil.rmtree(scene / "sparse")
    gaussians = random_gaussians(60)
    chosen = np.linspace(0, len(capture.points) - 1, 60).astype(int)
    gaussians.means = torch.from_numpy(capture.points.positions[chosen].astype(np.float32))
    gaussians.opacity_logits[:5] = float("inf")
    gaussians.save_ply(scene / "splat.ply", antialiased=True)

    run = Run(tmp_path / "run", "fit", {})
    monkeypatch.setattr(stages, "priced", lambda plan, *_: plan)  # prices take seconds to measure
    given = stages.begin(run, load_scene(scene))
    kept = stages.fit_source(run, given, FitSettings(), seed=0)
    manifest = read_manifest(run.folder)
    (choice,) = [c for c in manifest["effects"]["choices"] if c["effect"] == "antialias"]
    assert choice["value"] is True and choice["by"] == "splat"
    assert "the splat was fitted with anti-aliasing, and is drawn with it" in manifest["notes"]
    assert "splat.ply: 5 gaussians of infinite opacity logit are opaque" in manifest["notes"]
    content = read_splat(run.folder / "stages" / "fit" / "point_cloud.ply")
    assert content.antialiased and content.notes == []
    assert len(kept) == 60 and (kept.opacities[:5] == 1.0).all()
    published, _ = stages.finish(run, "fit")
    torch.testing.assert_close(published.means, gaussians.means, rtol=1e-6, atol=1e-6)


def test_stages_read_back_every_row_that_they_wrote(room, tmp_path):
    """`free` goes by row: a row dropped on the way would shift all that follow."""
    views = [replace(view, mask=np.zeros(view.pixels.shape[:2], bool)) for view in load_scene(room).views[:2]]
    source = random_gaussians(40)
    source.quaternions[5] = 0.0
    source.opacity_logits[9] = -float("inf")
    rows = torch.zeros(40, dtype=torch.bool)
    rows[:3] = True
    run = Run(tmp_path / "run", "remove", {})
    masks = {view.name: view.mask for view in views}
    cleared = clearing.clear_object(run, views, masks, source, rows, LiftSettings())
    assert len(cleared.gaussians) == len(cleared.free) == 37
    for (name, mine), (_, theirs) in zip(
        cleared.gaussians.named(), source.select(~rows).named(), strict=True
    ):
        torch.testing.assert_close(mine, theirs, rtol=0, atol=0, msg=name)
