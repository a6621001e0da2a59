"""Edits on anchors: masks lift to them, only they change, and the result is a standard splat."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from tiny_removal import SETTINGS

from cutout import Cutout
from diga3d_warp import cli
from diga3d_warp.errors import InputError
from diga3d_warp.gaussians.fit import FitSettings
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.gaussians.scaffold.anchors import ANCHORS, Scaffold
from diga3d_warp.gaussians.scaffold.same import same_anchors
from diga3d_warp.gaussians.scaffold.settings import SCAFFOLD
from diga3d_warp.gaussians.storage import load
from diga3d_warp.pipelines import baking
from diga3d_warp.pipelines.export import export_splat
from diga3d_warp.pipelines.fit import fit
from diga3d_warp.pipelines.remove import remove_object
from diga3d_warp.pipelines.replace import SETTLE, ReplaceSettings, replace_object
from diga3d_warp.pipelines.request import FitRequest
from diga3d_warp.pipelines.retexture import RECOLOUR, RetextureSettings, retexture_object
from diga3d_warp.pipelines.run import Run
from diga3d_warp.scene.load import load_scene
from diga3d_warp.scene.scene import View
from diga3d_warp.splatting.render import render

GROWTH = replace(SCAFFOLD.growth, interval=25)
QUICK = replace(
    SETTINGS,
    fit=replace(SETTINGS.fit, iterations=100, scaffold=replace(SCAFFOLD, growth=GROWTH)),
    refit=replace(SETTINGS.refit, iterations=40),
    distil=replace(SETTINGS.distil, iterations=5),
    method=replace(SETTINGS.method, surfaces=False),
)
REMOVAL = [
    "effects", "fit", "lift", "mirror", "shadow", "clear", "look-behind", "references", "fill", "propagate",
    "refit", "distil", "bake-fit",
]  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def quick_bake():
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(baking, "BAKE", replace(baking.BAKE, iterations=20))
        yield


@pytest.fixture(scope="module")
def scene(room):
    return load_scene(room)


@pytest.fixture(scope="module")
def removed(scene, tmp_path_factory):
    run = Run(tmp_path_factory.mktemp("anchors") / "run", "remove", {"seed": 0})
    return remove_object(scene, run, QUICK)


def taken_up(removed, folder, command: str, *stages: str) -> Run:
    """A run that has stages of the removal."""
    run = Run(folder, command, {"seed": 0}, resume=True)
    for stage in stages:
        if not (folder / "stages" / stage).exists():
            shutil.copytree(removed.run.folder / "stages" / stage, folder / "stages" / stage)
    return run


def picture(run: Run, name: str) -> np.ndarray:
    return cv2.imread(str(run.folder / name), cv2.IMREAD_COLOR_RGB).astype(np.float64)


def anchors_of(run: Run, stage: str) -> Scaffold:
    found = load(run.folder / "stages" / stage)
    assert isinstance(found, Scaffold)
    return found


def changes(run: Run, view: View) -> tuple[float, float]:
    """Mean change of a view where it was edited [levels of 255], and what it lost elsewhere [dB]."""
    before, after = (picture(run, f"views/{side}/{view.name}.png") for side in ("before", "after"))
    assert min(before.std(), after.std()) > 10.0, "not blank"
    inside = picture(run, f"masks/{view.name}.png")[..., 0] > 127
    errors = [((each - view.pixels)[~inside] ** 2).mean() for each in (before, after)]
    return float(np.abs(before - after)[inside].mean()), float(10 * np.log10(errors[1] / errors[0]))


def test_masked_pixels_change_and_others_stay(removed, scene):
    for view in scene.views:
        inside, lost = changes(removed.run, view)
        assert inside > 8.0 and lost < 0.3


def test_anchors_outside_the_hole_keep_their_bits(removed):
    run = removed.run
    source, cleared, edited = (anchors_of(run, name) for name in ("lift", "clear", "distil"))
    rows = torch.from_numpy(np.load(run.folder / "stages" / "lift" / "object.npy"))
    free = torch.from_numpy(np.load(run.folder / "stages" / "clear" / "free.npy"))
    assert len(rows) == len(source) and 0 < rows.sum() < len(rows) and len(cleared) < len(source)
    kept = same_anchors(cleared, edited)
    assert (kept[~free] >= 0).all() and (~free).any()
    assert (kept[free] == -1).all(), "those that may have learned something"
    assert len(edited) > len(cleared), "the hole has anchors of its own"


def test_score_distillation_reaches_anchors(removed):
    before, after = (anchors_of(removed.run, name) for name in ("refit", "distil"))
    assert (same_anchors(before, after) == -1).any()
    assert len(before) == len(after) and (before.features != after.features).any()


def test_the_result_is_a_standard_splat(removed, tmp_path):
    run = removed.run
    assert not (run.folder / ANCHORS).exists()
    splat = Gaussians.load_ply(run.folder / "point_cloud.ply")
    assert len(splat) == len(removed.gaussians) > len(anchors_of(run, "distil"))
    exported = export_splat(run.folder, "splat", tmp_path / "it.splat")
    assert exported.path.stat().st_size == 32 * len(splat)


def test_what_baking_loses_is_small_and_said(removed):
    metrics = json.loads((removed.run.folder / "metrics.json").read_text())
    for stage, name in (("bake-fit", "source.ply"), ("bake-distil", "point_cloud.ply")):
        loss = metrics[stage]["loss"]
        assert loss == pytest.approx(metrics[stage]["anchors"] - metrics[stage]["baked"])
        assert loss < 0.2 and metrics[stage]["agreement"] > 35.0
        notes = [n for n in removed.run.recorded("notes") if n.startswith(name)]
        assert len(notes) == 1 and f"loses {loss:.2f} dB" in notes[0]


def test_baked_gaussians_of_unchanged_anchors_are_the_same(removed):
    """So a view beside the hole shows the same pixels before and after."""
    folder = removed.run.folder / "stages"
    before, after = (
        Gaussians.load_ply(folder / f"bake-{name}" / "point_cloud.ply") for name in ("fit", "distil")
    )
    kept = same_anchors(anchors_of(removed.run, "fit"), anchors_of(removed.run, "distil")) >= 0
    rows = kept[torch.from_numpy(np.load(folder / "bake-fit" / "owners.npy"))]
    count = int(rows.sum())
    assert 0 < count < len(after)
    for (name, now), (_, then) in zip(after.named(), before.named(), strict=True):
        assert torch.equal(now[:count], then[rows]), name


def test_resume_gives_the_same_bytes(removed, scene, tmp_path):
    run = taken_up(removed, tmp_path / "run", "remove", *REMOVAL[:-3])
    again = remove_object(scene, run, QUICK)
    for name in ("point_cloud.ply", "source.ply"):
        assert (again.run.folder / name).read_bytes() == (removed.run.folder / name).read_bytes()


def test_the_object_turns_to_gold(removed, scene, tmp_path):
    run = taken_up(removed, tmp_path / "run", "retexture", "fit", "bake-fit")
    settings = RetextureSettings(fit=QUICK.fit, refit=replace(RECOLOUR, iterations=40))
    retexture_object(scene, "a golden vase", run, settings)
    for view in scene.views:
        inside, lost = changes(run, view)
        assert inside > 8.0 and lost < 0.5
        core = cv2.erode(view.mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        red, green, blue = picture(run, f"views/after/{view.name}.png")[core].mean(axis=0)
        assert red > green > 1.3 * blue, "gold is yellow"


def test_a_solid_takes_the_place(removed, scene, tmp_path):
    run = taken_up(removed, tmp_path / "run", "replace", *REMOVAL)
    settings = ReplaceSettings(removal=QUICK, settle=replace(SETTLE, iterations=25))
    result = replace_object(scene, "a golden sphere", run, settings)
    assert isinstance(anchors_of(run, "settle"), Scaffold) and len(result.gaussians) > 1000
    for view in scene.views:
        inside, lost = changes(run, view)
        assert inside > 5.0 and lost < 0.5, lost


def test_a_fit_of_the_command_line(room, tmp_path, capsys):
    words = ["fit", str(room), "--out", str(tmp_path / "run"), "--representation", "scaffold"]
    assert cli.main([*words, "--iterations", "12", "--effects", "exposure=on,surround=off"]) == 0
    folder = tmp_path / "run"
    assert load(folder / "stages" / "fit").coefficients == 1
    assert (folder / "stages" / "fit" / "exposures.npy").is_file()
    manifest = json.loads((folder / "manifest.json").read_text())
    assert manifest["settings"]["representation"] == "scaffold"
    assert (folder / "point_cloud.ply").is_file() and (folder / "report.html").is_file()
    capsys.readouterr()
    # Resumed as something else it would mix both.
    assert cli.main([*words[:4], "--iterations", "12", "--resume"]) == 2
    assert "representation = 'scaffold' (now None)" in capsys.readouterr().err


def test_what_is_nowhere_stays_nowhere(tmp_path):
    """Photographs with alpha, of a thing that was cut out."""
    capture = Cutout().write(tmp_path / "capture")
    settings = FitSettings(iterations=80, budget=2000, scaffold=SCAFFOLD)
    result = fit(capture, tmp_path / "run", settings=settings)
    cutout = load_scene(capture)
    for view in cutout.test_views:
        alpha = render(result.gaussians, view.camera).alpha.detach().numpy()
        opaque = view.opacity > 127
        assert alpha[opaque].mean() > 0.7 and alpha[~opaque].mean() < 0.15


def test_a_capture_with_a_splat_is_refused(removed, scene, tmp_path):
    given = replace(scene, splat=removed.run.folder / "point_cloud.ply")
    for command in ("fit", "remove"):
        module = __import__(f"diga3d_warp.pipelines.{command}", fromlist=[command])
        with pytest.raises(InputError, match=r"point_cloud\.ply is taken as it is.*--representation"):
            getattr(module, command)(given, tmp_path / command, representation="scaffold")
        assert not (tmp_path / command).exists()


def test_a_representation_that_is_unknown(scene, tmp_path):
    with pytest.raises(
        InputError, match=r"representation 'octree' is unknown: use one of gaussians, scaffold"
    ):
        FitRequest(scene=scene, out=tmp_path, representation="octree")
