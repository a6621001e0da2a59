"""The ablation: a switch changes what it should and nothing before it; the page tells what was measured."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from diga3d_warp.bench.ablation import cell, measure, page
from diga3d_warp.bench.ablation.measure import Figures, _seen, priors_of
from diga3d_warp.bench.ablation.trials import UNCHARTED, USUAL, Trial, groups_of
from diga3d_warp.bench.captures import Captures
from diga3d_warp.config import Effects
from diga3d_warp.errors import InputError
from diga3d_warp.gaussians.fit import FitSettings
from diga3d_warp.pipelines.method import WARPED
from diga3d_warp.pipelines.remove import DISTIL, REFIT, RemoveSettings
from diga3d_warp.pipelines.run import Run
from diga3d_warp.priors.classical import ClassicalPrior, telea_fill
from diga3d_warp.priors.exemplar.prior import ExemplarPrior
from diga3d_warp.priors.settings import SamplingSettings
from diga3d_warp.scene.photographs.images import read_image
from scenes import camera_at, random_gaussians

TINY = RemoveSettings(
    fit=FitSettings(iterations=60, budget=2000),
    refit=replace(REFIT, iterations=10),
    distil=replace(DISTIL, iterations=5),
)
QUICK = replace(USUAL, references=2, sampling=SamplingSettings(steps=2))
TRIALS = {
    "full": Trial(QUICK),
    "without TG-SDS": Trial(replace(QUICK, distillation=None)),
    "weight 0": Trial(replace(QUICK, afp_weight=0.0)),
    "classical": Trial(replace(UNCHARTED, references=2), prior="classical"),
    "missing": Trial(QUICK, prior="sd-inpainting"),
}


class Quick(ClassicalPrior):
    """A fill that takes milliseconds."""

    def fill(self, image, mask, *, seed=0, depth=None):
        return telea_fill(image, mask)


PRIORS = {"exemplar": ExemplarPrior(), "classical": Quick(), "sd-inpainting": "no weights"}
CAPTURES = Captures(("rug",), seeds=1, width=64, height=48, views=8, settings=TINY)


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """A tiny ablation: its scene, the folder of its runs, its truth and its outcomes."""
    folder = tmp_path_factory.mktemp("ablation") / "rug-0"
    scene = CAPTURES.load("rug", 0, folder / "capture")
    outcomes = dict(measure.measure(scene, TRIALS.values(), 0, folder / "runs", PRIORS, TINY))
    run = outcomes and folder / "runs" / TRIALS["full"].key
    truth = measure.Truth.of(scene, Run(run, "remove", {"scene": scene.path}, resume=True))
    return scene, folder / "runs", truth, outcomes


def outcome(outcomes, name):
    return outcomes[TRIALS[name]]


def test_each_trial_is_measured_but_those_without_a_prior(measured):
    scene, _, truth, outcomes = measured
    assert list(outcomes) == [TRIALS[name] for name in ("full", "without TG-SDS", "weight 0", "classical")]
    assert sum(unseen.sum() for unseen in truth.unseen) > 50
    for found in outcomes.values():
        figures = [of(found.figures) for of, _ in page.COLUMNS.values()]
        assert np.isfinite(figures).all() and min(figures) > 0
        assert list(found.fills) == [view.name for view in scene.views]
        assert min(image.std() for image in [*found.fills.values(), found.shown]) > 0.05, "not blank"


def test_propagation_changes_what_no_view_saw_and_no_more(measured):
    scene, _, truth, outcomes = measured
    with_it, without = outcome(outcomes, "full").fills, outcome(outcomes, "weight 0").fills
    changed = 0
    for view, unseen in zip(scene.views, truth.unseen, strict=True):
        difference = np.abs(with_it[view.name] - without[view.name]).max(-1)
        assert not difference[~unseen].any()
        changed += bool(difference.any())
    assert changed == len(scene.views) - 2, "all but the references"


def test_distillation_changes_the_splat_and_no_coarse_image(measured):
    _, folder, _, outcomes = measured
    with_it, without = outcome(outcomes, "full"), outcome(outcomes, "without TG-SDS")
    for name, image in with_it.fills.items():
        assert np.array_equal(image, without.fills[name])
    assert np.abs(with_it.shown - without.shown).max() > 1 / 255
    assert with_it.figures["rendered"] != without.figures["rendered"]
    assert with_it.figures["seconds"] > without.figures["seconds"]
    first, second = (folder / TRIALS[name].key / "stages" for name in ("full", "without TG-SDS"))
    for stage in ("fit", "propagate", "refit"):
        timings = [(stages / stage / "stage.json").read_bytes() for stages in (first, second)]
        assert timings[0] == timings[1], "taken over, not computed again"
    assert (first / "distil").is_dir() and not (second / "distil").is_dir()


def test_the_true_images_disagree_by_resampling_alone(measured):
    scene, _, truth, _ = measured
    floor = truth.disagreement(scene, truth.images)
    rng = np.random.default_rng(0)
    noise = [rng.random(image.shape, np.float32) for image in truth.images]
    assert 0 < floor < 0.5 * truth.disagreement(scene, noise)


def test_figures_of_filled_views_look_at_their_regions_alone(measured):
    scene, _, truth, _ = measured
    assert truth.contrast(truth.images, truth.unseen) == pytest.approx(1.0)
    faded = [0.5 * image + 0.2 for image in truth.images]
    assert truth.contrast(faded, truth.unseen) == pytest.approx(0.5, abs=1e-3)
    regions = [unseen & (np.arange(64) < 32) for unseen in truth.unseen]
    wrong = [np.where(at[..., None], im + 0.1, 0.0) for im, at in zip(truth.images, regions, strict=True)]
    assert truth.psnr(wrong, regions) == pytest.approx(20.0, abs=1e-3)
    assert truth.contrast(wrong, regions) == pytest.approx(1.0, abs=1e-3)
    empty = [np.where((u & ~at)[..., None], 9.0, im).astype(np.float32)
             for im, u, at in zip(truth.images, truth.unseen, regions, strict=True)]  # fmt: skip
    spoiled, left = truth.disagreement(scene, empty), truth.disagreement(scene, empty, regions)
    assert 0 < left < 0.1 * spoiled, "pixels without a fill are not compared, neither here nor there"


def test_the_truth_is_of_the_room_behind_the_vase(measured):
    scene, _, truth, outcomes = measured
    for view, image, depth, unseen in zip(scene.views, truth.images, truth.depths, truth.unseen, strict=True):
        assert (depth > 0).all()
        assert np.abs(image - view.image.numpy())[view.mask].mean() > 0.1, "the vase is gone"
        assert np.abs(image - view.image.numpy())[~view.mask].max() < 2 / 255
        assert unseen.any() and not unseen.all()
    assert 0 < outcome(outcomes, "full").figures["depth_error"] < 0.5


def test_the_table_has_a_row_for_each_trial(measured):
    *_, outcomes = measured
    figures = {trial: found.figures for trial, found in outcomes.items()}
    better = {
        trial: Figures(**{**found, "psnr_masked": found["psnr_masked"] + 1})
        for trial, found in figures.items()
    }
    table = page.table("title", TRIALS, {("rug", 0): figures, ("rug", 1): better}, TRIALS["full"])
    assert [row[0] for row in table.rows] == [*list(TRIALS)[:-1], "missing: not measured"]
    assert all(
        len(row) == len(table.columns) == 1 + len(page.COLUMNS) + len(page.PAIRED) for row in table.rows
    )
    assert set(table.rows[-1][1:]) == {"–"}
    assert table.rows[0][-3:] == ["0", "0", "0"]
    change = figures[TRIALS["classical"]]["psnr_masked"] - figures[TRIALS["full"]]["psnr_masked"]
    assert table.rows[3][-3] == f"{change:+.2f} ± 0.00", "the captures differ, the difference does not"
    assert all(re.fullmatch(r"\d+\.?\d* ± \d+\.?\d*", cell) for row in table.rows[:-1] for cell in row[1:-3])


def test_what_was_measured_is_not_measured_again(measured, tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    _, runs, *_ = measured
    trials = {name: TRIALS[name] for name in ("full", "without TG-SDS", "missing")}
    here = cell.Cell(CAPTURES, "rug", 0, runs.parents[1], PRIORS)  # whose runs are finished
    deleted = []
    monkeypatch.setattr(cell.shutil, "rmtree", deleted.append)
    found = here.figures(trials.values())
    assert list(found) == [TRIALS["full"], TRIALS["without TG-SDS"]]
    assert deleted == [runs] and here.floor > 0
    monkeypatch.setattr(cell, "measure", None)
    assert here.figures(trials.values()) == found
    page.draw(tmp_path / "ablation.png", {"all": trials}, here, PRIORS)
    assert read_image(tmp_path / "ablation.png").std() > 20, "not blank"
    shown = here.pictures(TRIALS["full"])
    assert len(shown) == 4 and all(image.std() > 0.05 for image in shown)


def test_figures_belong_to_the_weights_of_a_network(tmp_path):
    """Trained further, a prior of the same name is measured again."""
    priors = [SimpleNamespace(name="room", weights=digest) for digest in ("a1", "b2")]
    trial = Trial(prior="room")
    first, second = (
        cell.Cell(CAPTURES, "rug", 0, tmp_path, {"room": each})._path(trial, "json") for each in priors
    )
    assert first != second and first.name == f"{trial.key}-a1.json"


def test_mean_and_deviation_over_seeds():
    assert page.cell([1.0, 2.0, 3.0], ".2f") == "2.00 ± 1.00"
    assert page.cell([1.234], ".1f") == "1.2"


def test_differences_have_a_sign_and_a_standard_error():
    assert page.difference([1.0, 2.0, 3.0], ".2f") == "+2.00 ± 0.58"
    assert page.difference([-0.5], ".1f") == "-0.5"


@pytest.mark.parametrize("prior", ["exemplar", "sd-inpainting"])
def test_groups_compare_with_the_full_method(prior):
    for title, group in groups_of(prior).items():
        assert Trial(prior=prior) in group.values()
        assert len(set(group.values())) == len(group), "no trial twice in a table"
        assert not title.startswith("Start") or prior != "exemplar", "patches have no inversion to compare"
    components = groups_of(prior)["Key components (paper, Table 3)"]
    assert components["without TG-SDS"] == Trial(prior=prior).coarse != Trial(prior=prior)
    assert components["without both"] == components["without AFP"].coarse


def test_priors_without_weights_are_a_reason(monkeypatch):
    def load(name, **_):
        if name == "powerpaint":
            raise InputError("the weights are not on this machine")
        return ClassicalPrior()

    monkeypatch.setattr(measure, "load_prior", load)
    trials = [Trial(), Trial(prior="powerpaint"), Trial(WARPED, prior="classical")]
    found = priors_of(trials)
    assert list(found) == ["exemplar", "powerpaint", "classical"]
    assert found["powerpaint"] == "the weights are not on this machine"
    assert [name for name, prior in found.items() if isinstance(prior, str)] == ["powerpaint"]


def test_page(monkeypatch, tmp_path):
    pytest.importorskip("matplotlib")

    class MadeUp:
        floor = 5.0

        def __init__(self, captures, situation, seed, folder, priors):
            self.seed = seed

        def figures(self, trials):
            found = Figures(
                psnr=30.0, ssim=0.9, psnr_masked=20.0, ssim_masked=0.8, coarse_psnr=18.0, coarse_contrast=0.5,
                coarse=9.0 + self.seed, rendered=4.0, depth_error=0.01, seconds=12.0, peak_mib=900.0,
            )  # fmt: skip
            return {trial: found for trial in trials if trial.prior != "classical"}

    found = {"exemplar": None, "classical": "no OpenCV"}
    monkeypatch.setattr(page, "priors_of", lambda trials: found)
    monkeypatch.setattr(page, "Cell", MadeUp)
    monkeypatch.setattr(page, "draw", lambda *_: None)
    captures = Captures(("rug",), seeds=2)
    tables = page.bench_ablation(tmp_path, tmp_path / "work", captures, "exemplar")
    assert [table.title for table in tables] == list(groups_of("exemplar"))
    text = (tmp_path / "ablation.md").read_text()
    assert "| without AFP | 30.00 ± 0.00 | 0.900 ± 0.000 | 20.00 ± 0.00 |" in text
    assert "| 18.00 ± 0.00 | 50 ± 0 | 9.50 ± 0.71 | 4.00 ± 0.00 | 1.00 ± 0.00 | 12.0 ± 0.0 |" in text
    assert "| classical, warped by DIBR: not measured | – |" in text
    assert "**classical** is not measured: no OpenCV." in text
    assert f"`diga3d bench ablation --prior exemplar --situations rug --seeds 2 --out {tmp_path}`" in text
    with pytest.raises(InputError, match="figures of other settings"):
        page.bench_ablation(tmp_path, tmp_path / "work", replace(captures, width=80), "exemplar")


def test_depth_is_that_of_the_scene_without_its_surround(tmp_path):
    """A thing that lets some of a far shell through: mean depth over both would be many times as large."""
    camera = camera_at()
    scene, shell = random_gaussians(60, seed=0, degree=0), random_gaussians(60, seed=1, degree=0)
    shell.means.mul_(100.0).sub_(torch.from_numpy(200.0 * camera.center).float())
    shell.log_scales.add_(float(np.log(200.0)))
    run = SimpleNamespace(folder=tmp_path, effects=Effects())
    path = tmp_path / "stages" / "fit"
    path.mkdir(parents=True)
    alone = _seen(SimpleNamespace(run=run, gaussians=scene), camera)
    shell.save_ply(path / "surround.ply")
    both = _seen(SimpleNamespace(run=run, gaussians=scene.joined(shell)), camera)
    assert (alone[1] > 0.0).any() and np.abs(alone[0] - both[0]).max() > 0.01, "the shell is seen"
    np.testing.assert_array_equal(alone[1], both[1])
