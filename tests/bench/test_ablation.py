"""The ablation: a switch changes what it should and nothing before it; the page tells what was measured."""

import re
from dataclasses import replace

import numpy as np
import pytest

from diga3d_warp.bench.ablation import measure, page
from diga3d_warp.bench.ablation.measure import Outcome, priors_of
from diga3d_warp.bench.ablation.trials import FULL, GROUPS, Trial
from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.metrics import Score
from diga3d_warp.gaussians.fit import FitSettings
from diga3d_warp.pipelines.method import PAPER, WARPED
from diga3d_warp.pipelines.remove import DISTIL, REFIT, RemoveSettings
from diga3d_warp.priors.classical import ClassicalPrior
from diga3d_warp.priors.exemplar.prior import ExemplarPrior
from diga3d_warp.priors.settings import SamplingSettings
from diga3d_warp.scene.load import load_scene
from diga3d_warp.scene.photographs.images import read_image
from diga3d_warp.scene.synthetic.generate import SyntheticScene, generate

TINY = RemoveSettings(
    fit=FitSettings(iterations=60, budget=2000),
    refit=replace(REFIT, iterations=10),
    distil=replace(DISTIL, iterations=5),
)
QUICK = replace(PAPER, references=2, sampling=SamplingSettings(steps=2))
TRIALS = {
    "full": Trial(QUICK),
    "without TG-SDS": Trial(replace(QUICK, distillation=None)),
    "weight 0": Trial(replace(QUICK, afp_weight=0.0)),
    "classical": Trial(replace(WARPED, references=2), prior="classical"),
    "missing": Trial(QUICK, prior="sd-inpainting"),
}


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """A tiny ablation: its scene, its folder, its truth and its outcomes."""
    folder = tmp_path_factory.mktemp("ablation")
    room = SyntheticScene(width=64, height=48, views=7, shadows=False)
    scene = load_scene(generate(room, folder / "room"), hold_out=3)
    priors = {"exemplar": ExemplarPrior(), "classical": ClassicalPrior(), "sd-inpainting": "no weights"}
    return scene, folder, *measure.measure(scene, TRIALS.values(), 1, folder, priors, TINY)


def outcome(outcomes, name):
    return outcomes[TRIALS[name], 0]


def test_each_trial_is_measured_but_those_without_a_prior(measured):
    scene, _, truth, outcomes = measured
    assert list(outcomes) == [
        (TRIALS[name], 0) for name in ("full", "without TG-SDS", "weight 0", "classical")
    ]
    assert sum(unseen.sum() for unseen in truth.unseen) > 100
    for found in outcomes.values():
        figures = [of(found) for of, _ in page.COLUMNS.values()]
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
    assert with_it.rendered != without.rendered and with_it.seconds > without.seconds
    first, second = (folder / f"{index}-0" / "stages" for index in (0, 1))
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
    assert 0 < outcome(outcomes, "full").depth_error < 0.5


def test_the_table_has_a_row_for_each_trial(measured):
    *_, outcomes = measured
    priors = {"exemplar": ExemplarPrior(), "classical": ClassicalPrior(), "sd-inpainting": "no weights"}
    table = page.table("title", TRIALS, outcomes, 1, priors)
    assert [row[0] for row in table.rows] == [*list(TRIALS)[:-1], "missing: not measured"]
    assert all(len(row) == len(table.columns) == 1 + len(page.COLUMNS) for row in table.rows)
    assert set(table.rows[-1][1:]) == {"–"}
    assert all(re.fullmatch(r"\d+\.?\d*", cell) for row in table.rows[:-1] for cell in row[1:])


def test_the_picture_shows_every_trial(measured, monkeypatch, tmp_path):
    pytest.importorskip("matplotlib")
    scene, _, truth, outcomes = measured
    monkeypatch.setattr(page, "GROUPS", {"all": TRIALS})
    page.draw(tmp_path / "ablation.png", scene, truth, outcomes)
    assert read_image(tmp_path / "ablation.png").std() > 20, "not blank"


def test_mean_and_deviation_over_seeds():
    assert page.cell([1.0, 2.0, 3.0], ".2f") == "2.00 ± 1.00"
    assert page.cell([1.234], ".1f") == "1.2"


def test_groups_compare_with_the_full_method():
    for group in GROUPS.values():
        assert FULL in group.values()
        assert len(set(group.values())) == len(group), "no trial twice in a table"
    components = GROUPS["Key components (paper, Table 3)"]
    assert components["without TG-SDS"] == FULL.coarse != FULL
    assert components["without both"] == components["without AFP"].coarse


def test_priors_without_weights_are_a_reason(monkeypatch):
    def load(name, **_):
        if name == "powerpaint":
            raise InputError("the weights are not on this machine")
        return ClassicalPrior()

    monkeypatch.setattr(measure, "load_prior", load)
    trials = [FULL, Trial(prior="powerpaint"), Trial(WARPED, prior="classical")]
    for cuda, reason in ((False, "CUDA"), (True, "not on this machine")):
        monkeypatch.setattr(measure.torch.cuda, "is_available", lambda cuda=cuda: cuda)
        found = priors_of(trials)
        assert list(found) == ["exemplar", "powerpaint", "classical"]
        assert [name for name, prior in found.items() if isinstance(prior, str)] == ["powerpaint"]
        assert reason in found["powerpaint"]


def test_page(monkeypatch, tmp_path):
    pytest.importorskip("matplotlib")
    score = {"whole": Score(30.0, 0.9), "masked": Score(20.0, 0.8)}

    def made_up(scene, trials, seeds, folder, priors):
        image = np.zeros((4, 4, 3), np.float32)
        truth = type("Made up", (), {"images": [], "disagreement": lambda *_: 5.0})()
        return truth, {
            (trial, seed): Outcome(score, 18.0, 0.5, 9.0 + seed, 4.0, 0.01, 12.0, 900, {}, image)
            for trial in trials
            for seed in range(seeds)
        }

    found = {"exemplar": None, "classical": None, "sd-inpainting": "no disk", "powerpaint": "no weights"}
    monkeypatch.setattr(page, "priors_of", lambda trials: found)
    monkeypatch.setattr(page, "generate", lambda room, folder: folder)
    monkeypatch.setattr(page, "load_scene", lambda folder, hold_out: None)
    monkeypatch.setattr(page, "measure", made_up)
    monkeypatch.setattr(page, "draw", lambda *_: None)
    tables = page.bench_ablation(tmp_path, 2)
    assert [table.title for table in tables] == list(GROUPS)
    text = (tmp_path / "ablation.md").read_text()
    assert "| without AFP | 30.00 ± 0.00 | 0.900 ± 0.000 | 20.00 ± 0.00 |" in text
    assert "| 18.00 ± 0.00 | 50 ± 0 | 9.50 ± 0.71 | 4.00 ± 0.00 | 1.00 ± 0.00 | 12.0 ± 0.0 |" in text
    assert "| powerpaint: not measured | – |" in text
    assert "**powerpaint** is not measured: no weights." in text
    assert f"`diga3d bench ablation --seeds 2 --out {tmp_path}`" in text
