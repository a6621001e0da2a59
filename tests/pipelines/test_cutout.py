"""Captures of cut-out things: what is nowhere stays nowhere, through a fit, its page, and each edit."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from tiny_removal import SETTINGS

from cutout import Cutout, truth
from diga3d_warp import cli
from diga3d_warp.evaluation.protocols import evaluate
from diga3d_warp.evaluation.record import RESULT, read_manifest, run_effects
from diga3d_warp.gaussians.fit import FitSettings
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.pipelines.method import WARPED
from diga3d_warp.pipelines.remove import REFIT, remove_object
from diga3d_warp.pipelines.render import render_path
from diga3d_warp.pipelines.replace import SETTLE, ReplaceSettings, replace_object
from diga3d_warp.pipelines.request import EditResult
from diga3d_warp.pipelines.retexture import RECOLOUR, RetextureSettings, retexture_object
from diga3d_warp.pipelines.run import Run
from diga3d_warp.scene.load import load_scene
from diga3d_warp.splatting.render import render
from diga3d_warp.state import read_mask


@pytest.fixture(scope="session")
def cutout(tmp_path_factory) -> Path:
    """Nine RGBA photographs of a vase on a block; not to be changed."""
    return Cutout().write(tmp_path_factory.mktemp("cutout") / "capture")


def opacities(gaussians, scene) -> list[tuple[np.ndarray, np.ndarray]]:
    """Alpha of held-out renderings and of their photographs, in [0, 1]."""
    pairs = []
    for view in scene.test_views:
        with torch.no_grad():
            pairs.append((render(gaussians, view.camera).alpha.numpy(), view.opacity / 255.0))
    return pairs


@pytest.fixture(scope="module")
def fitted(cutout, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("fitted") / "run"
    assert cli.main(["fit", str(cutout), "--iterations", "300", "--out", str(out)]) == 0
    return out


def test_a_fit_of_cut_out_things_is_opaque_inside_and_empty_outside(fitted, cutout):
    for found, wanted in opacities(Gaussians.load_ply(fitted / RESULT), load_scene(cutout)):
        assert 0.1 < wanted.mean() < 0.5
        assert found[wanted == 1].mean() > 0.95
        assert found[wanted == 0].mean() < 0.02
        assert np.abs(found - wanted).mean() < 0.025


def test_the_run_keeps_the_choice_and_its_pictures_are_over_white(fitted, cutout, tmp_path):
    choices = {choice["effect"]: choice for choice in read_manifest(fitted)["effects"]["choices"]}
    assert choices["background"]["value"] is True and "transparent" in choices["background"]["evidence"]
    assert run_effects(read_manifest(fitted)).background
    render_path(fitted, tmp_path / "frames", path="views")
    frames = sorted((tmp_path / "frames").glob("*.png"))
    view = load_scene(cutout).test_views[0]
    pictures = [*frames, fitted / "views" / "before" / f"{view.name}.png"]
    for file in [*pictures, fitted / "views" / "after" / f"{view.name}.png"]:
        picture = cv2.imread(str(file))
        assert picture.std() > 20, "not blank"
        assert (picture[:8, :8] > 250).all(), "the corner shows nothing: white"


def test_evaluation_compares_over_white(fitted):
    evaluate(fitted)
    (comparison,) = json.loads((fitted / "metrics.json").read_text())["evaluation"]["comparisons"]
    assert comparison["mean"]["whole"]["psnr"] > 22.0


def test_a_finished_fit_is_resumed_to_the_same_bytes(fitted, cutout):
    before = (fitted / RESULT).read_bytes()
    words = ["fit", str(cutout), "--iterations", "300", "--out", str(fitted), "--resume"]
    assert cli.main(words) == 0
    assert (fitted / RESULT).read_bytes() == before
    with_off = [*words, "--effects", "background=off"]
    assert cli.main(with_off) == 2, "begun with another choice"


FEW = FitSettings(iterations=300, budget=4000)
REMOVAL = replace(SETTINGS, fit=FEW, refit=replace(REFIT, iterations=100), method=WARPED)


@pytest.fixture(scope="module")
def removed(cutout, tmp_path_factory) -> EditResult:
    """The vase taken off its block."""
    run = Run(tmp_path_factory.mktemp("removed") / "run", "remove", {})
    return remove_object(load_scene(cutout), run, REMOVAL)


def mask_of(result, view) -> np.ndarray:
    return read_mask(result.run.folder / "masks" / f"{view.name}.png")


def test_behind_a_removed_object_nothing_stays_nothing_and_the_block_is_filled(removed, cutout):
    scene = load_scene(cutout)
    for view, (found, _) in zip(scene.test_views, opacities(removed.gaussians, scene), strict=True):
        wanted, mask = truth(cutout, view.name), mask_of(removed, view)
        assert (mask & (wanted == 0)).sum() > 100 and (mask & (wanted == 1)).sum() > 100
        assert found[mask & (wanted == 0)].mean() < 0.03
        assert found[mask & (wanted == 1)].mean() > 0.95


def test_a_fill_is_none_of_the_white_around_things(removed, cutout):
    """The rug under the vase: white has a brightness of 1, what surrounds the hole one of 0.35."""
    for view in load_scene(cutout).test_views:
        picture = cv2.imread(str(removed.run.folder / "views" / "after" / f"{view.name}.png")) / 255.0
        inside = cv2.erode((truth(cutout, view.name) == 1).astype(np.uint8), np.ones((5, 5))) > 0
        hole = inside & mask_of(removed, view)
        assert hole.sum() > 30 and picture[hole].mean() < 0.6


def test_a_retextured_object_is_as_opaque_as_it_was(cutout, tmp_path):
    """White marble, over white: what the background's colour could stand in for."""
    scene, run = load_scene(cutout), Run(tmp_path / "run", "retexture", {})
    settings = RetextureSettings(fit=FEW, refit=replace(RECOLOUR, iterations=60))
    result = retexture_object(scene, "white marble", run, settings)
    for found, wanted in opacities(result.gaussians, scene):
        assert found[wanted == 1].mean() > 0.95 and found[wanted == 0].mean() < 0.02


def test_a_new_object_is_opaque_and_alone(cutout, tmp_path):
    scene, run = load_scene(cutout), Run(tmp_path / "run", "replace", {})
    settings = ReplaceSettings(REMOVAL, settle=replace(SETTLE, iterations=60))
    result = replace_object(scene, "a white marble sphere", run, settings)
    for view, (found, _) in zip(scene.test_views, opacities(result.gaussians, scene), strict=True):
        alone, mask = truth(cutout, view.name), mask_of(result, view)
        assert found[alone == 1].mean() > 0.95, "the block"
        assert found[(alone == 0) & ~mask].mean() < 0.02, "beside block and sphere"
        above = found[mask & (alone == 0)]
        assert (above > 0.9).sum() > 50 and (above < 0.1).sum() > 50, "the sphere has a rim"


def test_without_the_effect_photographs_are_opaque_and_the_white_is_painted(cutout, tmp_path):
    run, scene = Run(tmp_path / "run", "remove", {}), load_scene(cutout)
    result = remove_object(scene, run, REMOVAL, effects={"background": False})
    for found, wanted in opacities(result.source, scene):
        assert found[wanted == 0].mean() > 0.5
    assert not list((run.folder / "stages").rglob("*.alpha.png"))
