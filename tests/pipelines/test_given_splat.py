"""A capture that comes with a splat: drawn as its file says, and kept as it is."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import torch

from diga3d_warp.evaluation.record import read_manifest
from diga3d_warp.gaussians.fit import FitSettings
from diga3d_warp.gaussians.initialise import initialise
from diga3d_warp.gaussians.lift import LiftSettings
from diga3d_warp.gaussians.surround import SURROUND
from diga3d_warp.pipelines import clearing, stages
from diga3d_warp.pipelines.given_splat import left_empty, what_is_missing
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


def test_a_surround_is_published_behind_the_splat_and_taken_back(room, tmp_path, monkeypatch):
    """Stages do without it: a fit that comes back as a given splat has as many gaussians as before."""
    monkeypatch.setattr(stages, "priced", lambda plan, *_: plan)
    first = Run(tmp_path / "first", "fit", {})
    working = stages.begin(first, load_scene(room))
    kept = stages.fit_source(first, working, FitSettings(iterations=3, budget=0), seed=0)
    published, _ = stages.finish(first, "fit")
    assert len(published) == len(kept) + SURROUND.count
    content = read_splat(first.folder / "point_cloud.ply")
    assert content.surround == SURROUND.count and len(content.scene) == len(kept)
    distances = np.linalg.norm(content.shell.means - content.scene.means.mean(axis=0), axis=1)
    assert distances.min() > np.linalg.norm(content.scene.means, axis=1).max()

    again = Run(tmp_path / "again", "fit", {})
    given = stages.begin(again, replace(load_scene(room), splat=first.folder / "point_cloud.ply"))
    assert len(stages.fit_source(again, given, FitSettings(), seed=0)) == len(kept)
    republished, _ = stages.finish(again, "fit")
    torch.testing.assert_close(republished.means, published.means, rtol=1e-5, atol=1e-5)

    without = Run(tmp_path / "without", "fit", {})
    plain = stages.begin(without, load_scene(room), {"surround": False})
    fitted = stages.fit_source(without, plain, FitSettings(iterations=3, budget=0), seed=0)
    assert len(stages.finish(without, "fit")[0]) == len(fitted)


def test_a_splat_that_leaves_photographs_empty_is_noted(room):
    """A .splat that was cut between two gaussians cannot be told by itself."""
    scene = load_scene(room)
    whole = initialise(scene.points)
    whole.opacity_logits[:] = 6.0
    whole.log_scales += 1.0
    assert left_empty(scene, whole) < 0.05 and what_is_missing(scene, "a.splat", whole) is None
    left = whole.select(whole.means[:, 0] < whole.means[:, 0].median())
    assert "a.splat leaves" in what_is_missing(scene, "a.splat", left)
    clear = [replace(view, alpha=np.zeros(view.pixels.shape[:2], np.uint8)) for view in scene.views]
    assert left_empty(replace(scene, views=clear), left) == 0.0, "nothing is there to be shown"
