"""A replacement on a tiny room: the new object stands where the old one did, and nothing else changes."""

from __future__ import annotations

import shutil
from dataclasses import replace as with_changes

import cv2
import numpy as np
import pytest
import torch
from tiny_removal import FILLED, SETTINGS, stage_splat

from diga3d_warp.evaluation.record import read_manifest
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.pipelines.replace import GROW, SETTLE, ReplaceSettings, replace_object
from diga3d_warp.pipelines.run import Run

QUICK = ReplaceSettings(
    removal=SETTINGS, settle=with_changes(SETTLE, iterations=30), grow=with_changes(GROW, iterations=30)
)

REMOVAL = [*FILLED, "propagate", "refit", "distil"]


def replaced(removed, folder, prompt="a big golden sphere", **options):
    """A replacement that takes the removal's stages up."""
    run = Run(folder, "replace", {"seed": 0}, resume=True)
    for stage in REMOVAL:
        if not (folder / "stages" / stage).exists():
            shutil.copytree(removed.folder / "stages" / stage, folder / "stages" / stage)
    return replace_object(removed.scene, prompt, run, QUICK, **options)


@pytest.fixture(scope="module")
def golden(removed, tmp_path_factory):
    return replaced(removed, tmp_path_factory.mktemp("golden") / "run")


def picture(folder, name: str) -> np.ndarray:
    return cv2.imread(str(folder / name), cv2.IMREAD_COLOR_RGB).astype(np.float64) / 255.0


def views_of(removed):
    return [*removed.scene.views, *removed.scene.test_views]


def test_the_run_folder_holds_what_it_should(golden, removed):
    manifest = read_manifest(golden.run.folder)
    stages = [stage["name"] for stage in manifest["stages"]]
    assert manifest["held_to"].keys() >= {"capture", "settings", "seed", "effects", "prior", "method"}
    assert manifest["notes"] == ["not used of the prompt: 'big'"]
    assert stages == [*REMOVAL, "look", "place", "settle", "views"]
    names = sorted(f"{view.name}.png" for view in views_of(removed))
    for place in ("views/before", "views/after", "masks"):
        assert sorted(file.name for file in (golden.run.folder / place).iterdir()) == names


def test_a_golden_ball_stands_where_the_vase_stood(golden, removed):
    nearer = []
    for view in views_of(removed):
        after = picture(golden.run.folder, f"views/after/{view.name}.png")
        truth = removed.picture(f"ground_truth/other_object/{view.name}.png")
        cleared = removed.picture(f"ground_truth/without_object/{view.name}.png")
        ball = np.abs(truth - cleared).max(axis=2) > 0.1
        ball = cv2.erode(ball.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
        assert ball.sum() > 40 and after.std() > 0.1
        red, _, blue = after[ball].mean(axis=0)
        assert red > 1.5 * blue, "gold is yellow"
        misses = [np.abs(each - truth)[ball].mean() for each in (after, view.pixels / 255.0)]
        nearer.append(misses[0] / misses[1])
    assert np.mean(nearer) < 0.9, "gold of another painter, yet nearer to the truth than the vase was"


def test_what_is_unmasked_stays(golden, removed):
    losses = []
    for view in removed.scene.test_views:
        folder = golden.run.folder
        before, after = (picture(folder, f"views/{side}/{view.name}.png") for side in ("before", "after"))
        outside = picture(golden.run.folder, f"masks/{view.name}.png")[..., 0] < 0.5
        assert outside.mean() > 0.5
        photo = view.pixels / 255.0
        errors = [((each - photo)[outside] ** 2).mean() for each in (before, after)]
        losses.append(10 * np.log10(errors[1] / errors[0]))
    assert np.mean(losses) < 0.3


def test_the_new_object_is_composed_into_what_the_run_shows(golden, removed):
    """The surround behind the splat, too: the short fit lets it through nearly everywhere."""
    for view in views_of(removed):
        cleared = picture(removed.folder, f"views/after/{view.name}.png")
        composed = picture(golden.run.folder, f"stages/place/{view.name}.png")
        untouched = picture(golden.run.folder, f"stages/place/masks/{view.name}.png")[..., 0] < 0.5
        assert untouched.mean() > 0.5
        off = np.abs(composed - cleared).max(axis=2)[untouched]
        assert np.quantile(off, 0.97) < 0.02


def test_only_the_object_and_what_it_shades_change(golden):
    folder = golden.run.folder / "stages"
    held = np.load(folder / "place" / "held.npy")
    blocking = torch.from_numpy(np.load(folder / "place" / "blocking.npy"))
    assert blocking.float().mean() < 0.1
    cleared = stage_splat(golden.run, "distil").select(~blocking)
    kept = torch.from_numpy(held[: len(cleared)])
    assert 0.3 < kept.float().mean() < 1.0 and not held[len(cleared) :].any() and len(held) > len(cleared)
    for (name, now), (_, then) in zip(golden.gaussians.named(), cleared.named(), strict=True):
        assert torch.equal(now[: len(cleared)][kept], then[kept]), name


def test_resume_gives_the_same_bytes(golden, removed, tmp_path):
    replaced(removed, tmp_path / "run")
    for stage in ("settle", "views"):
        shutil.rmtree(tmp_path / "run" / "stages" / stage)
    replaced(removed, tmp_path / "run")
    for name in ("point_cloud.ply", "source.ply"):
        assert (tmp_path / "run" / name).read_bytes() == (golden.run.folder / name).read_bytes()


def test_a_splat_takes_the_place(removed, tmp_path):
    from diga3d_warp.objects.asset import splat_asset

    rng = torch.Generator().manual_seed(0)
    means = torch.randn(3000, 3, generator=rng)
    means = means / means.norm(dim=1, keepdim=True)
    blue = torch.tensor([-1.2, -0.6, 1.2]).expand(3000, 1, 3).contiguous()
    quaternions = torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(3000, 1)
    splat = Gaussians(means, torch.full((3000, 3), -3.0), quaternions, torch.full((3000,), 3.0), blue)
    result = replaced(removed, tmp_path / "run", prompt="", asset=splat_asset(splat))
    for view in removed.scene.test_views:
        after = picture(result.run.folder, f"views/after/{view.name}.png")
        assert ((after[..., 2] - after[..., 0]) > 0.3).mean() > 0.01


def test_views_that_the_user_filled_show_the_new_object_and_decide_on_the_shadow(removed, tmp_path):
    own = {}
    for view in removed.scene.views[::3]:
        truth = removed.picture(f"ground_truth/other_object/{view.name}.png")
        own[view.name] = (truth * 255.0).round().astype(np.uint8)
    result = replaced(removed, tmp_path / "run", "", own=own)
    (choice,) = [
        each for each in read_manifest(result.run.folder)["effects"]["choices"] if each["effect"] == "shadow"
    ]
    assert (choice["value"], choice["by"]) == (False, "task")
    assert "fills are given" in choice["evidence"]
    for name in own:
        truth = removed.picture(f"ground_truth/other_object/{name}.png")
        after, before = (
            picture(result.run.folder, f"views/{side}/{name}.png") for side in ("after", "before")
        )
        changed = np.abs(truth - before).max(axis=2) > 0.2
        assert changed.sum() > 40 and after.std() > 0.1
        assert np.abs(after - truth)[changed].mean() < 0.8 * np.abs(before - truth)[changed].mean()
