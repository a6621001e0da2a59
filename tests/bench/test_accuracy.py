"""What accuracy costs: scenes show what they are meant to, errors and fronts are right, the page is whole."""

from dataclasses import replace

import pytest
import torch

from diga3d_warp.bench.accuracy import measure as measurement
from diga3d_warp.bench.accuracy import page as accuracy_page
from diga3d_warp.bench.accuracy.knobs import KNOBS, PRESETS, STANDARD, Way, ways
from diga3d_warp.bench.accuracy.measure import error, measure, pareto_front, rendered
from diga3d_warp.bench.accuracy.page import bench_accuracy, draw, knob_table
from diga3d_warp.bench.accuracy.reprojection import reprojection_table
from diga3d_warp.bench.accuracy.scenes import SIZE, Subject, captured, middle, subjects
from diga3d_warp.bench.garden import Garden
from diga3d_warp.bench.page import name_points, plot
from diga3d_warp.config import Accuracy
from diga3d_warp.errors import InputError
from diga3d_warp.scene.photographs.images import read_image
from diga3d_warp.splatting.render import render

TINY = Garden(count=60, width=32, height=24, radius=6.0)


@pytest.fixture(scope="module")
def scenes():
    return {subject.name: subject for subject in subjects()}


def drawn(subject: Subject):
    with torch.no_grad():
        found = render(subject.gaussians, subject.camera)
    return found, found.projection.extents[:, 0] > 0.0


def test_scenes_show_what_their_names_say(scenes):
    assert list(scenes) == ["easy", "near-camera", "needles", "wide-angle"]
    for subject in scenes.values():
        found, seen = drawn(subject)
        assert found.color.std() > 0.05, f"{subject.name} is blank"
        assert found.alpha.mean() > 0.5
        assert seen.float().mean() > 0.8
        assert (subject.camera.width, subject.camera.height) == SIZE
    near = scenes["near-camera"].gaussians.means[:, 2]
    assert (near < 0.5).sum() >= 50
    scales = scenes["needles"].gaussians.log_scales.sort(dim=1).values
    assert (scales[:, 2] - scales[:, 1]).min() > 2.9
    wide = scenes["wide-angle"]
    angles = torch.atan2(wide.gaussians.means[:, :2].norm(dim=1), wide.gaussians.means[:, 2]).rad2deg()
    assert angles.max() > 65.0
    again = next(subject for subject in subjects() if subject.name == "needles")
    assert torch.equal(again.gaussians.means, scenes["needles"].gaussians.means)


def test_every_way_has_one_name_and_every_knob_an_exact_end():
    named = ways()
    assert len(set(named.values())) == len(named)
    assert list(named.values())[:3] == ["DRAFT", "STANDARD", "EXACT"]
    for knob in KNOBS:
        assert STANDARD in knob.settings.values(), f"{knob.name}: STANDARD is one of its settings"
        assert knob.exact in named, "the exact end is rendered, too"
    assert {way.accuracy.precision for way in named} == {"float32", "float64"}


def test_errors_of_a_rendering_that_is_off_by_a_known_amount():
    truth = rendered(Subject("tiny", TINY.gaussians(), TINY.camera), STANDARD)
    color = truth.color.clone()
    color[0, 0, 0] += 0.5
    gradients = {name: gradient.clone() for name, gradient in truth.gradients.items()}
    gradients["sh"] *= 1.25
    found = error(truth._replace(color=color, gradients=gradients), truth)
    count = color.numel()
    assert found.largest == pytest.approx(0.5)
    assert found.mean == pytest.approx(0.5 / count)
    assert found.root_mean_square == pytest.approx(0.5 / count**0.5)
    assert found.gradient == pytest.approx(0.25)


def test_turning_a_knob_shows_in_error_and_gradient():
    subject = Subject("tiny", TINY.gaussians(), TINY.camera)
    draft, standard = Way(Accuracy.DRAFT), STANDARD
    coarse = Way(image_scale=0.5)
    found = measure(subject, [standard, draft, coarse], repeats=1)
    assert found[standard].error.gradient < found[draft].error.gradient
    assert found[standard].error.psnr > found[draft].error.psnr > found[coarse].error.psnr > 5.0
    assert found[coarse].color.shape == (24, 32, 3)
    assert all(each.forward > 0.0 and each.backward > 0.0 for each in found.values())


def test_slow_ways_are_timed_once(monkeypatch):
    calls = []
    monkeypatch.setattr(measurement, "rendered", lambda *given: calls.append(given) or rendered(*given))
    subject = Subject("tiny", TINY.gaussians(), TINY.camera)
    for slow, count in ((60.0, 4), (0.0, 2)):
        monkeypatch.setattr(measurement, "SLOW", slow)
        calls.clear()
        measure(subject, [STANDARD], repeats=3)
        assert len(calls) == 1 + count, "the truth, the first run that compiles, and the repeats"


def test_names_of_points_do_not_cover_each_other(tmp_path):
    with plot(tmp_path / "names.png", 2) as (axes, _):
        axes.plot([0.0, 1.0], [0.0, 1.0])
        name_points(axes, [(f"point {k}", (0.5, 0.5)) for k in range(6)])
        boxes = [text.get_window_extent() for text in axes.texts]
        assert len(boxes) == 6
        assert not any(one.overlaps(other) for k, one in enumerate(boxes) for other in boxes[:k])


def test_the_front_holds_what_nothing_beats():
    points = [(1.0, 1.0), (0.5, 2.0), (0.6, 3.0), (2.0, 0.1), (1.5, 1.0), (1.01, 1.0), (2.0, 0.0)]
    assert pareto_front(points) == [True, True, False, False, False, True, True]


def test_page_and_plot(monkeypatch, tmp_path):
    few = {way: name for way, name in ways().items() if name in (*PRESETS, "image scale 0.5")}
    knobs = [knob for knob in KNOBS if knob.name == "image scale"]
    monkeypatch.setattr(accuracy_page, "subjects", lambda: [Subject("tiny", TINY.gaussians(), TINY.camera)])
    monkeypatch.setattr(accuracy_page, "ways", lambda: few)
    monkeypatch.setattr(accuracy_page, "KNOBS", knobs)
    tables = bench_accuracy(tmp_path, 1, None)
    assert len(tables) == 5
    text = (tmp_path / "accuracy.md").read_text()
    assert f"`diga3d bench accuracy --repeats 1 --out {tmp_path}`" in text
    assert all(f"**{table.title}**" in text for table in tables)
    assert "- **image scale** (`--image-scale`):" in text
    assert "| image scale 1 (standard) | – | – | – | – | 1.00 | 1.00 | 1.00 |" in text
    assert "Scene “tiny” against the truth: 60 gaussians, 32 x 24 px" in text
    plot = read_image(tmp_path / "accuracy.png")
    assert plot.shape[1] > 800
    assert plot.std() > 15
    assert sorted(path.name for path in tmp_path.iterdir()) == ["accuracy.md", "accuracy.png"]


def test_own_errors_are_those_against_the_exact_end(monkeypatch):
    subject = Subject("tiny", TINY.gaussians(), TINY.camera)
    coarse = Way(image_scale=0.5)
    found = measure(subject, [STANDARD, coarse], repeats=1)
    monkeypatch.setattr(accuracy_page, "KNOBS", [knob for knob in KNOBS if knob.name == "image scale"])
    half, whole = knob_table({"tiny": found}).rows
    own = error(found[coarse], found[STANDARD])
    assert half[:3] == ("image scale 0.5", f"{own.psnr:.1f}", f"{own.largest:.1e}")
    assert whole[1] == "–"


def test_a_run_is_measured_in_the_middle_of_a_view(toy_run, tmp_path):
    subject = captured(toy_run.folder)
    assert subject.name == "run"
    assert len(subject.gaussians) == 260
    assert (subject.camera.width, subject.camera.height) == (48, 36), "as large as it is"
    large = replace(subject.camera, width=1000, height=800, cx=510.0, cy=390.0)
    cut = middle(large)
    assert (cut.width, cut.height) == SIZE
    assert (cut.cx, cut.cy) == (510.0 - 340.0, 390.0 - 280.0)
    assert cut.fx == large.fx
    with pytest.raises(InputError, match="empty"):
        captured(tmp_path / "empty")


def test_samplings_of_a_reprojection():
    rows = {row[0]: row[1:] for row in reprojection_table(1).rows}
    quality = {name: float(cells[0]) for name, cells in rows.items()}
    gradient = {name: float(cells[3]) for name, cells in rows.items()}
    missing = {name: float(cells[4]) for name, cells in rows.items()}
    assert quality["nearest"] < quality["bilinear"] < quality["bilinear, 2 x 2 samples"]
    assert gradient["nearest"] > gradient["bilinear"] > gradient["bilinear, 2 x 2 samples"]
    assert missing["nearest"] > 10.0 > missing["bilinear"], "points part where the camera comes nearer"
    assert all(float(cells[5]) > 20.0 for cells in rows.values()), "like the view itself"
    assert rows["bilinear"][8] == "1.00"


def test_a_knob_that_makes_no_difference_is_drawn_all_the_same(tmp_path):
    """As the degree of the harmonics on a matte splat, which has none above 0."""
    gaussians = TINY.gaussians()
    matte = replace(gaussians, sh=gaussians.sh[:, :1])
    results = {"matte": measure(Subject("matte", matte, TINY.camera), ways(), 1)}
    draw(tmp_path / "accuracy.png", results)
    assert read_image(tmp_path / "accuracy.png").std() > 15
