"""Edits by free text on a tiny room and a tiny checkpoint in the real format: random weights, real code.

What appears is noise. What is held to is where it appears, that the rest stays, and that bytes repeat.
"""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from tiny_removal import FILLED, SETTINGS, stage_splat

from diga3d_warp import cli
from diga3d_warp.errors import InputError
from diga3d_warp.files import to_bytes
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.gaussians.surround import render_before
from diga3d_warp.perception.depth import DepthEstimator
from diga3d_warp.pipelines.free_text import FreeText
from diga3d_warp.pipelines.imagining import Imagined, grow
from diga3d_warp.pipelines.method import PAPER, WARPED
from diga3d_warp.pipelines.remove import DISTIL
from diga3d_warp.pipelines.replace import GROW, ReplaceSettings, replace_object
from diga3d_warp.pipelines.retexture import RECOLOUR, RetextureSettings, retexture_object
from diga3d_warp.pipelines.run import Run
from diga3d_warp.pipelines.stages import choose_references, shell_of
from diga3d_warp.pipelines.stages import picture as picture_of
from diga3d_warp.priors.named import load_prior
from diga3d_warp.priors.settings import SamplingSettings
from tiny_diffusion import write_checkpoint

SAMPLED = replace(PAPER, references=2, sampling=SamplingSettings(steps=2, batch=4))
REPAINT = RetextureSettings(
    fit=SETTINGS.fit,
    refit=replace(RECOLOUR, iterations=30),
    distil=replace(DISTIL, iterations=8),
    method=SAMPLED,
)


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    return write_checkpoint(tmp_path_factory.mktemp("checkpoint") / "sd")


@pytest.fixture(scope="module")
def prior(checkpoint):
    return load_prior(str(checkpoint), controls=("edges", "depth"), device="cpu")


def picture(run: Run, name: str) -> np.ndarray:
    return cv2.imread(str(run.folder / name), cv2.IMREAD_COLOR_RGB).astype(np.float64) / 255.0


def views_of(removed):
    return [*removed.scene.views, *removed.scene.test_views]


def stages_of(run: Run) -> list[str]:
    return [stage["name"] for stage in json.loads((run.folder / "manifest.json").read_text())["stages"]]


def begun(removed, folder, command: str, stages: tuple[str, ...]) -> Run:
    """A run that takes stages of the removal up."""
    run = Run(folder, command, {"seed": 0}, resume=True)
    for stage in stages:
        if not (folder / "stages" / stage).exists():
            shutil.copytree(removed.folder / "stages" / stage, folder / "stages" / stage)
    return run


def check_changes(run: Run, removed) -> None:
    """The object's pixels have changed, and the others are as good as before."""
    for view in views_of(removed):
        before, after = (picture(run, f"views/{side}/{view.name}.png") for side in ("before", "after"))
        assert min(before.std(), after.std()) > 0.05, "not blank"
        assert np.abs(after - before)[view.mask].mean() > 0.05
        outside = picture(run, f"masks/{view.name}.png")[..., 0] < 0.5
        photo = view.pixels / 255.0
        errors = [((each - photo)[outside] ** 2).mean() for each in (before, after)]
        assert 10 * np.log10(errors[1] / errors[0]) < 0.3


def check_first_rows(gaussians: Gaussians, kept: Gaussians) -> None:
    """The first gaussians are the kept ones, bit for bit, and there are more."""
    assert len(gaussians) > len(kept) > 0
    for (name, now), (_, then) in zip(gaussians.named(), kept.named(), strict=True):
        assert torch.equal(now[: len(kept)], then), name


def repainted(removed, folder, prior, prompt="a wooden vase", **options):
    run = begun(removed, folder, "retexture", ("fit",))
    return retexture_object(removed.scene, prompt, run, REPAINT, prior=prior, **options)


@pytest.fixture(scope="module")
def wooden(removed, prior, tmp_path_factory):
    return repainted(removed, tmp_path_factory.mktemp("wooden") / "run", prior)


def test_a_repainted_object_changes_and_nothing_else(wooden, removed):
    assert stages_of(wooden.run) == [
        "effects", "fit", "lift", "look", "references", "repaint", "refit", "distil", "views",
    ]  # fmt: skip
    check_changes(wooden.run, removed)
    rows = np.load(wooden.run.folder / "stages" / "lift" / "object.npy")
    check_first_rows(wooden.gaussians, stage_splat(wooden.run, "fit").select(torch.from_numpy(~rows)))


def test_distillation_refines_the_repainted_object(wooden):
    coarse, fine = (stage_splat(wooden.run, name) for name in ("refit", "distil"))
    assert len(coarse) == len(fine)
    assert not torch.equal(coarse.sh, fine.sh)


def test_a_repainting_resumes_with_the_same_bytes_and_tells_its_plan(wooden, removed, prior, tmp_path, capfd):
    folder = tmp_path / "run"
    shutil.copytree(wooden.run.folder, folder)
    for stage in ("repaint", "refit", "distil"):
        shutil.rmtree(folder / "stages" / stage)
    again = repainted(removed, folder, prior)
    told = capfd.readouterr().err
    assert "views, 2 of them references, 2 steps" in told and "views on the host" in told
    for name in ("point_cloud.ply", "source.ply"):
        assert (folder / name).read_bytes() == (wooden.run.folder / name).read_bytes()
    for view in removed.scene.views:
        name = f"stages/repaint/{view.name}.png"
        assert (folder / name).read_bytes() == (wooden.run.folder / name).read_bytes()
    assert again.run.folder == folder


def test_without_propagation_views_are_edited_alone(prior):
    alone = FreeText.of(prior, "a vase", "", "retexture", replace(SAMPLED, propagation="none"))
    together = FreeText.of(prior, "a vase", "", "retexture", SAMPLED)
    assert (alone.sampling.afp_weight, together.sampling.afp_weight) == (0.0, 0.6)
    with pytest.raises(InputError, match="cannot be warped by depth"):
        FreeText.of(prior, "a vase", "", "retexture", WARPED)


REMOVAL = (*FILLED, "propagate", "refit")
IMAGINE = ReplaceSettings(
    removal=replace(SETTINGS, distil=replace(DISTIL, iterations=8), method=SAMPLED),
    grow=replace(GROW, iterations=40),
)


def imagined(removed, folder, prior, settings=IMAGINE, **options):
    run = begun(removed, folder, "replace", REMOVAL)
    return replace_object(
        removed.scene, "a wooden cube", run, settings, prior=prior, free_text=True, **options
    )


@pytest.fixture(scope="module")
def cube(removed, prior, tmp_path_factory):
    return imagined(removed, tmp_path_factory.mktemp("cube") / "run", prior)


def test_an_imagined_object_appears_in_the_old_ones_place_only(cube, removed):
    assert stages_of(cube.run) == [*REMOVAL, "look", "imagine", "measure", "grow", "distil", "views"]
    check_changes(cube.run, removed)
    cleared, grown = (stage_splat(cube.run, name) for name in ("refit", "grow"))
    check_first_rows(grown, cleared)
    check_first_rows(cube.gaussians, cleared)
    assert not torch.equal(cube.gaussians.sh, grown.sh), "refined"


def test_around_the_masks_the_coarse_images_show_the_cleared_scene(cube, removed):
    """Anything else there, and the new gaussians would be fitted to the difference."""
    cleared = Gaussians.load_ply(cube.run.folder / "stages" / "refit" / "point_cloud.ply")
    for view in removed.working.views:
        image = picture(cube.run, f"stages/imagine/{view.name}.png")
        over = render_before(shell_of(cube.run), cleared, view.camera, cube.run.effects)
        before = to_bytes(over.color) / 255.0
        mask = picture(cube.run, f"masks/{view.name}.png")[..., 0] > 0.5
        assert np.array_equal(image[~mask], before[~mask])
        assert np.abs(image - before)[mask].mean() > 0.05 and image[mask].std() > 0.02


def test_no_gaussian_of_the_new_object_is_there_for_the_scene_around(cube, removed):
    """Beyond the masks and their seam the views with and without the new object hardly differ."""
    cleared, final = stage_splat(cube.run, "refit"), stage_splat(cube.run, "distil")
    for view in removed.scene.views:
        mask = picture(cube.run, f"masks/{view.name}.png")[..., 0] > 0.5
        beyond = cv2.dilate(mask.astype(np.uint8), np.ones((9, 9), np.uint8)) == 0
        pair = [picture_of(g, view.camera, cube.run.effects) / 255.0 for g in (cleared, final)]
        assert beyond.mean() > 0.5
        assert np.abs(pair[0] - pair[1])[beyond].mean() < 0.003


def test_the_new_object_starts_on_the_old_ones_surface(cube, removed):
    for view in removed.scene.views:
        depth = np.load(cube.run.folder / "stages" / "measure" / f"{view.name}.npy")
        with np.load(cube.run.folder / "stages" / "look" / f"{view.name}.npz") as look:
            solid = look["share"] > 0.5
            assert solid.any() and np.array_equal(depth[solid], look["depth"][solid])


def test_an_object_that_one_view_shows_grows_there(removed, tmp_path):
    """References are chosen among the views that show it; without seeds it would be in no view."""
    cleared = Gaussians.load_ply(removed.folder / "stages" / "refit" / "point_cloud.ply")
    views = [view.with_mask(np.zeros_like(view.mask)) for view in removed.working.views]
    views[4] = removed.working.views[4]
    run = Run(tmp_path / "run", "replace", {})
    references = choose_references(run, views, [view.mask for view in views], SAMPLED, 0)
    assert references.indices == [4] and not references.cluster.any()
    notes = json.loads((run.folder / "manifest.json").read_text())["notes"]
    assert notes == ["1 of 7 views show enough of the object to be references; 2 were asked for"]
    imagined = [
        Imagined(
            view,
            view.mask,
            view.pixels.astype(np.float32) / 255.0,
            np.full(view.mask.shape, 2.0, np.float32),
            False,
        )
        for view in views
    ]
    settings = replace(GROW, iterations=2)
    grown = grow(run, cleared, imagined, references, removed.working.extent, settings, 0)
    check_first_rows(grown, cleared)


def test_an_imagining_resumes_with_the_same_bytes(cube, removed, prior, tmp_path, capfd):
    folder = tmp_path / "run"
    shutil.copytree(cube.run.folder, folder)
    for stage in ("imagine", "grow", "distil"):
        shutil.rmtree(folder / "stages" / stage)
    imagined(removed, folder, prior)
    assert "of them references, 2 steps" in capfd.readouterr().err
    assert (folder / "point_cloud.ply").read_bytes() == (cube.run.folder / "point_cloud.ply").read_bytes()


class Planar(DepthEstimator):
    """Estimates the depth of a slanted plane, or nonsense."""

    def __init__(self, sense=1.0):
        self.sense = sense

    def disparity(self, image):
        return self.sense * torch.linspace(0.2, 0.9, len(image))[:, None].expand(image.shape[:2])


def test_estimated_depth_is_aligned_and_nonsense_left_out(cube, removed, prior, tmp_path):
    """The floor is nearer below: a plane that is, too, can be aligned to it, and one that is not cannot."""
    settings = replace(
        IMAGINE,
        removal=replace(IMAGINE.removal, method=replace(SAMPLED, distillation=None)),
        grow=replace(GROW, iterations=2),
    )
    measured = []
    for sense in (1.0, -1.0):
        folder = tmp_path / f"run{sense}"
        shutil.copytree(cube.run.folder, folder)
        for stage in ("measure", "grow", "distil"):
            shutil.rmtree(folder / "stages" / stage)
        manifest = json.loads((folder / "manifest.json").read_text())
        del manifest["held_to"]  # what is measured does not depend on the settings that differ
        (folder / "manifest.json").write_text(json.dumps(manifest))
        result = imagined(removed, folder, prior, settings, estimator=Planar(sense))
        measured.append(json.loads((folder / "stages" / "measure" / "measured.json").read_text())["measured"])
        notes = json.loads((folder / "manifest.json").read_text())["notes"]
        assert sum("stands in" in note for note in notes) == measured[-1].count(False)
        assert stages_of(result.run)[-2:] == ["grow", "views"], "without distillation"
    assert all(measured[0]) and not any(measured[1])
    depth = np.load(tmp_path / "run1.0" / "stages" / "measure" / f"{removed.scene.views[0].name}.npy")
    assert np.isfinite(depth).all() and (depth > 0).all()
    assert np.allclose(depth[:, 0], depth[:, -1]) and (np.diff(depth[:, 0]) < 0).all(), "the plane"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--prompt", "a teapot on stilts"], "for free text use --prior sd-inpainting"),
        (["--prompt", "", "--prior", "TINY"], "needs a prompt"),
        (["--prompt", "x" * 10_000, "--prior", "TINY"], "shorten it"),
        (["--prompt", "a cube", "--prior", "TINY", "--propagation", "warp"], "cannot be warped by depth"),
    ],
)
def test_replacements_that_cannot_begin_leave_nothing(room, checkpoint, tmp_path, capfd, words, said):
    words = [str(checkpoint) if word == "TINY" else word for word in words]
    assert cli.main(["replace", str(room), "--out", str(tmp_path / "run"), *words]) == 2
    error = capfd.readouterr().err
    assert said in error and error.count("\n") == 1
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--prompt", "gold", "--prior", "classical"], "classical has no materials"),
        (["--prompt", "gold", "--negative", "a vase"], "--negative: the built-in materials"),
        (["--prompt", "gold", "--tg-sds"], "--tg-sds: the built-in materials"),
        (["--prompt", "kryptonite"], "for free text use --prior sd-inpainting"),
        (["--prompt", "gold", "--prior", "nowhere"], "there is no prior or folder nowhere"),
        (["--prompt", "", "--prior", "TINY"], "needs a prompt"),
        (["--prompt", "x" * 10_000, "--prior", "TINY"], "shorten it"),
        (["--prompt", "gold", "--prior", "TINY", "--propagation", "warp"], "cannot be warped by depth"),
        (["--exemplar", "gold.jpg", "--prior", "TINY"], "--exemplar is painted without a prior"),
    ],
)
def test_retextures_that_cannot_begin_leave_nothing(room, checkpoint, tmp_path, capfd, words, said):
    words = [str(checkpoint) if word == "TINY" else word for word in words]
    assert cli.main(["retexture", str(room), "--out", str(tmp_path / "run"), *words]) == 2
    error = capfd.readouterr().err
    assert said in error and error.count("\n") == 1
    assert not (tmp_path / "run").exists()
