"""A change of material on a tiny room: the object follows the prompt, and nothing else changes."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from tiny_removal import SETTINGS, stage_splat

from diga3d_warp.errors import InputError
from diga3d_warp.gaussians.lift import object_share
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.pipelines.retexture import RECOLOUR, RetextureSettings, retexture_object
from diga3d_warp.pipelines.run import Run

QUICK = RetextureSettings(fit=SETTINGS.fit, refit=replace(RECOLOUR, iterations=40))

STAGES = ["effects", "fit", "lift", "look", "references", "repaint", "refit", "views"]


def begun(removed, folder) -> Run:
    """A run that takes the fit of the removal up."""
    run = Run(folder, "retexture", {"seed": 0}, resume=True)
    if not (folder / "stages" / "fit").exists():
        shutil.copytree(removed.folder / "stages" / "fit", folder / "stages" / "fit")
    return run


@pytest.fixture(scope="module")
def golden(removed, tmp_path_factory):
    run = begun(removed, tmp_path_factory.mktemp("golden") / "run")
    return retexture_object(removed.scene, "a golden vase", run, QUICK)


def picture(run: Run, name: str) -> np.ndarray:
    return cv2.imread(str(run.folder / name), cv2.IMREAD_COLOR_RGB).astype(np.float64) / 255.0


def views_of(removed):
    return [*removed.scene.views, *removed.scene.test_views]


def test_the_object_is_looked_at_in_what_the_run_shows(golden, removed):
    """The surround behind the splat, too: the short fit lets it through nearly everywhere."""
    for view in removed.scene.views:
        looked_at = picture(golden.run, f"stages/look/{view.name}.png")
        assert np.abs(looked_at - picture(golden.run, f"views/before/{view.name}.png")).max() < 0.01


def test_the_run_folder_holds_what_it_should(golden, removed):
    folder = golden.run.folder
    manifest = json.loads((folder / "manifest.json").read_text())
    assert [stage["name"] for stage in manifest["stages"]] == STAGES
    assert manifest["held_to"].keys() >= {"capture", "settings", "seed", "effects", "prior", "method"}
    assert manifest["notes"] == ["not used of the prompt: 'vase'"]
    names = sorted(f"{view.name}.png" for view in views_of(removed))
    for place in ("views/before", "views/after", "masks"):
        assert sorted(file.name for file in (folder / place).iterdir()) == names
    assert (folder / "source.ply").is_file() and (folder / "point_cloud.ply").is_file()


def test_the_object_turns_to_gold_in_every_view(golden, removed):
    for view in views_of(removed):
        before, after = (picture(golden.run, f"views/{side}/{view.name}.png") for side in ("before", "after"))
        inside = cv2.erode(view.mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        assert min(before.std(), after.std()) > 0.1, "not blank"
        red, green, blue = after[inside].mean(axis=0)
        assert red > green > 1.6 * blue, "gold is yellow"
        assert before[inside].mean(axis=0)[2] > 1.3 * blue, "the vase was not"


def test_what_is_unmasked_stays(golden, removed):
    for view in views_of(removed):
        before, after = (picture(golden.run, f"views/{side}/{view.name}.png") for side in ("before", "after"))
        outside = picture(golden.run, f"masks/{view.name}.png")[..., 0] < 0.5
        photo = view.pixels / 255.0
        loss = 10 * np.log10(((after - photo)[outside] ** 2).mean() / ((before - photo)[outside] ** 2).mean())
        assert loss < 0.3


def test_other_gaussians_keep_their_bits_and_the_object_its_shape(golden, removed):
    rows = np.load(golden.run.folder / "stages" / "lift" / "object.npy")
    source, final = (stage_splat(golden.run, name) for name in ("fit", "refit"))
    rest = source.select(torch.from_numpy(~rows))
    assert 0 < rows.sum() < len(rows)
    for (name, now), (_, then) in zip(final.named(), rest.named(), strict=True):
        assert torch.equal(now[: len(rest)], then), name
    count = len(final) - len(rest)
    assert count >= rows.sum()
    new = torch.arange(len(final)) >= len(rest)
    for view in removed.scene.views:
        shapes = [
            object_share(gaussians, view.camera, each).numpy() > 0.5
            for gaussians, each in ((source, torch.from_numpy(rows)), (final, new))
        ]
        assert (shapes[0] & shapes[1]).sum() > 0.75 * (shapes[0] | shapes[1]).sum()


def test_resume_gives_the_same_bytes(golden, removed, tmp_path):
    """Each stage again from the ones before it, as after a kill between them."""
    run = begun(removed, tmp_path / "run")
    for stage in ("repaint", "refit"):
        shutil.rmtree(run.folder / "stages" / stage, ignore_errors=True)
        again = retexture_object(removed.scene, "a golden vase", begun(removed, run.folder), QUICK)
    for name in ("point_cloud.ply", "source.ply"):
        assert (again.run.folder / name).read_bytes() == (golden.run.folder / name).read_bytes()
    again = Gaussians.load_ply(run.folder / "point_cloud.ply")
    assert torch.equal(again.sh, golden.gaussians.sh)


def test_masks_that_lift_to_nothing(removed, tmp_path):
    nothing = removed.scene.with_masks([np.zeros_like(view.mask) for view in removed.scene.views])
    with pytest.raises(InputError, match="lift to no gaussian"):
        retexture_object(nothing, "gold", begun(removed, tmp_path / "run"), QUICK)


def test_an_object_takes_the_material_of_a_picture(removed, tmp_path):
    rng = np.random.default_rng(0)
    cv2.imwrite(str(tmp_path / "blue.png"), np.clip(rng.normal((200, 60, 20), 20, (80, 90, 3)), 0, 255))
    run = begun(removed, tmp_path / "run")
    retexture_object(removed.scene, "", run, QUICK, exemplar=tmp_path / "blue.png")
    for view in views_of(removed):
        inside = cv2.erode(view.mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        red, green, blue = picture(run, f"views/after/{view.name}.png")[inside].mean(axis=0)
        assert blue > 1.5 * green > 1.5 * red
