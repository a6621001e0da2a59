"""Captures of cut-out things: what is nowhere stays nowhere, through a fit, its page, and each edit."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from cutout import Cutout
from diga3d_warp import cli
from diga3d_warp.evaluation.protocols import evaluate
from diga3d_warp.evaluation.record import RESULT, read_manifest, run_effects
from diga3d_warp.gaussians.fit import FitSettings
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.pipelines import stages
from diga3d_warp.pipelines.render import render_path
from diga3d_warp.pipelines.run import Run
from diga3d_warp.scene.load import load_scene
from diga3d_warp.splatting.render import render


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


def test_without_the_effect_the_background_is_painted(cutout, tmp_path):
    scene = load_scene(cutout)
    run = Run(tmp_path / "run", "fit", {})
    stages.begin(run, scene, {"background": False})
    gaussians = stages.fit_source(run, scene, FitSettings(iterations=300, budget=4000), seed=0)
    for found, wanted in opacities(gaussians, scene):
        assert found[wanted == 0].mean() > 0.5


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
