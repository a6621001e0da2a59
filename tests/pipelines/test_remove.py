"""A removal on a tiny room: what it leaves, what it changes, and what it must not touch."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from tiny_removal import FILLED, SETTINGS, Removed, stage_splat

from diga3d_warp.config import Effects
from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.record import read_manifest, run_effects
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.gaussians.working import to_working
from diga3d_warp.pipelines.clearing import lift_object
from diga3d_warp.pipelines.method import PAPER
from diga3d_warp.pipelines.remove import REFIT, RemoveSettings, remove_object
from diga3d_warp.pipelines.run import Run
from diga3d_warp.priors.exemplar.prior import ExemplarPrior
from diga3d_warp.scene.scene import Scene


def psnr(a: np.ndarray, b: np.ndarray, where: np.ndarray) -> float:
    return float(-10 * np.log10(((a - b)[where] ** 2).mean()))


def every_view(removed: Removed):
    return [*removed.scene.views, *removed.scene.test_views]


def test_the_run_folder_holds_what_it_should(removed):
    names = sorted(f"{view.name}.png" for view in every_view(removed))
    assert len(names) == 9
    for folder in ("views/before", "views/after", "masks"):
        assert sorted(file.name for file in (removed.folder / folder).iterdir()) == names
    stages = [*FILLED, "propagate", "refit", "distil", "views"]
    assert sorted(entry.name for entry in (removed.folder / "stages").iterdir()) == sorted(stages)
    manifest = json.loads((removed.folder / "manifest.json").read_text())
    assert [stage["name"] for stage in manifest["stages"]] == stages
    assert manifest["held_to"].keys() >= {"capture", "settings", "seed", "effects", "prior", "method"}
    # Whether seven views tell of a shadow and a mirror image.
    effects = replace(run_effects(manifest), shadow=False, mirror=False)
    assert effects == Effects(sh_degree=3, lens=False, depth=False, background=False, surround=True)
    assert {"fit", "refit", "distil"} <= set(json.loads((removed.folder / "metrics.json").read_text()))
    assert not [path for path in removed.folder.rglob("*") if ".partial" in path.name]
    returned = {"point_cloud.ply": removed.result.gaussians, "source.ply": removed.result.source}
    for name, gaussians in returned.items():
        stored = Gaussians.load_ply(removed.folder / name)
        for (_, mine), (_, theirs) in zip(stored.named(), gaussians.named(), strict=True):
            assert torch.equal(mine, theirs)


def test_the_object_gives_way_to_what_is_behind_it(removed):
    gains = []
    for view in every_view(removed):
        truth = removed.picture(f"ground_truth/without_object/{view.name}.png")
        before, after = (removed.picture(f"views/{side}/{view.name}.png") for side in ("before", "after"))
        assert min(picture.std() for picture in (truth, before, after)) > 0.1, "not blank"
        gains.append(psnr(after, truth, view.mask) - psnr(before, truth, view.mask))
        assert psnr(after, truth, view.mask) > psnr(view.pixels / 255.0, truth, view.mask) + 3.0
    assert min(gains) > 2.5 and np.mean(gains) > 5.0


def test_what_is_unmasked_stays(removed):
    for view in every_view(removed):
        before, after = (removed.picture(f"views/{side}/{view.name}.png") for side in ("before", "after"))
        assert psnr(after, before, ~removed.mask(view.name)) > 28.0
        assert psnr(before, view.pixels / 255.0, ~removed.mask(view.name)) > 17.0


def lifted_mask(folder: Path, name: str) -> np.ndarray:
    picture = cv2.imread(str(folder / "stages" / "lift" / "masks" / f"{name}.png"), cv2.IMREAD_GRAYSCALE)
    return picture > 127


def test_masks_are_widened_not_moved(removed):
    for view in every_view(removed):
        wide = lifted_mask(removed.folder, view.name)
        assert wide[view.mask].all()
        assert view.mask.sum() < wide.sum() < 2 * view.mask.sum()
        assert removed.mask(view.name)[wide].all(), "what was relit is edited, too"


def test_held_gaussians_keep_their_bits(removed):
    stages = removed.folder / "stages"
    free = np.load(stages / "clear" / "free.npy")
    left = stage_splat(removed.result.run, "clear")
    counts = json.loads((stages / "clear" / "counts.json").read_text())
    source = len(stage_splat(removed.result.run, "fit"))
    assert counts == {"object": source - len(left), "left": len(left)}
    assert 20 < counts["object"] < 0.5 * source
    assert 0.2 < (~free).mean() < 1.0
    assert len(removed.result.gaussians) > len(left), "the hole has got gaussians of its own"
    for (name, now), (_, then) in zip(removed.result.gaussians.named(), left.named(), strict=True):
        now = now[: len(left)]
        assert torch.equal(now[~free], then[~free]), name
        assert not torch.equal(now[free], then[free]), name


def test_references_are_distinct_training_views(removed):
    chosen = json.loads((removed.folder / "stages" / "references" / "references.json").read_text())
    names = [view.name for view in removed.scene.views]
    assert len(set(chosen["names"])) == 3
    assert [names[index] for index in chosen["indices"]] == chosen["names"]
    assert len(chosen["cluster"]) == len(names) and set(chosen["cluster"]) == {0, 1, 2}


def test_views_without_a_mask_get_one(room, removed, tmp_path):
    scene = removed.scene
    some = scene.with_masks([view.mask if k % 2 == 0 else None for k, view in enumerate(scene.views)])
    some = replace(some, test_views=[view.with_mask(None) for view in scene.test_views])
    run = Run(tmp_path / "run", "remove", {"seed": 0})
    shutil.copytree(removed.folder / "stages" / "fit", run.folder / "stages" / "fit")
    settings = replace(SETTINGS, refit=replace(REFIT, iterations=1))
    remove_object(some, run, settings, prior=ExemplarPrior(negative="a vase"))
    (note,) = json.loads((run.folder / "manifest.json").read_text())["notes"]
    assert note.startswith("prior exemplar reads no words of the negative prompt")
    for view in every_view(removed):
        found, own = lifted_mask(run.folder, view.name), lifted_mask(removed.folder, view.name)
        overlap = (found & own).sum() / (found | own).sum()
        assert overlap > 0.6, view.name


def refused(scene: Scene, folder: Path, match: str, settings: RemoveSettings = SETTINGS) -> None:
    with pytest.raises(InputError, match=match) as caught:
        remove_object(scene, Run(folder, "remove", {}), settings)
    assert "\n" not in str(caught.value)
    assert not (folder / "point_cloud.ply").exists()


def test_no_masks_are_refused_before_anything_is_fitted(removed, tmp_path):
    bare = removed.scene.with_masks([None] * len(removed.scene.views))
    refused(bare, tmp_path / "run", "no view has a mask; put one for each image into .*masks, white on")
    assert sorted(entry.name for entry in (tmp_path / "run").iterdir()) == [".lock", "manifest.json"]


@pytest.mark.parametrize("count", [0, 8])
def test_too_many_references_are_refused_before_anything_is_fitted(removed, tmp_path, count):
    settings = replace(SETTINGS, method=replace(PAPER, references=count))
    said = f"{count} references cannot be chosen from 7 views: ask for 1 to 7"
    refused(removed.scene, tmp_path / "run", said, settings)
    assert sorted(entry.name for entry in (tmp_path / "run").iterdir()) == [".lock", "manifest.json"]


def test_masks_of_other_photographs_are_noted(removed, tmp_path):
    scene, source = removed.working, stage_splat(removed.result.run, "fit")
    source = to_working(source, removed.result.run.frame)
    masks = {view.name: view.mask for view in scene.views}
    strays = [scene.views[1].name, scene.views[4].name]
    notes = []
    for wrong in ([], strays):
        run = Run(tmp_path / f"run{len(wrong)}", "remove", {})
        run.effects = removed.result.run.effects
        given = {name: np.roll(mask, 40, axis=1) if name in wrong else mask for name, mask in masks.items()}
        lift_object(run, scene, given, source, SETTINGS.lift, SETTINGS.masking)
        notes.append(read_manifest(run.folder)["notes"])
    assert notes[0] == []
    assert len(notes[1]) == 1 and "masks of 2 views do not lie on the object" in notes[1][0]
    assert all(name in notes[1][0] for name in strays)


@pytest.mark.parametrize(("value", "said"), [(False, "to no gaussian"), (True, "to every gaussian seen")])
def test_masks_that_lift_to_nothing_or_everything(removed, tmp_path, value, said):
    """Such masks pass the reader where one view's mask is right, or none of it lies on the scene."""
    quick = replace(SETTINGS, fit=replace(SETTINGS.fit, iterations=2))
    masks = [np.full_like(view.mask, value) for view in removed.scene.views]
    refused(removed.scene.with_masks(masks), tmp_path / "run", f"the masks lift {said}", quick)
    assert (tmp_path / "run" / "stages" / "fit").is_dir(), "the fit is kept for --resume with better masks"
