"""The comparison of fills: what counts as unseen, figures that fit the truth, cells measured once."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from diga3d_warp.bench.captures import Captures
from diga3d_warp.bench.fill import measure, page
from diga3d_warp.bench.fill.cell import Cell, picture_path
from diga3d_warp.bench.fill.figures import Figures
from diga3d_warp.bench.fill.measure import available_priors, measure_all
from diga3d_warp.bench.fill.methods import METHODS, PICTURED, UNCHARTED, Removal
from diga3d_warp.bench.fill.truth import unseen_pixels
from diga3d_warp.cli import main
from diga3d_warp.errors import InputError
from diga3d_warp.gaussians.fit import FitSettings
from diga3d_warp.pipelines.remove import REFIT, RemoveSettings
from diga3d_warp.priors.classical import mean_color_fill
from diga3d_warp.scene.camera import Camera, look_at
from diga3d_warp.state import read_picture

TINY = RemoveSettings(
    fit=FitSettings(iterations=60, budget=2000),
    refit=replace(REFIT, iterations=10),
)
CAPTURES = Captures(("corner",), seeds=1, width=64, height=48, views=7, settings=TINY)
QUICK = replace(UNCHARTED, references=2)
COMPARED = {
    "mean colour": mean_color_fill,
    "classical": Removal("classical", QUICK),
    "true references": Removal("classical", QUICK, given="references"),
    "true views": Removal("classical", QUICK, given="all"),
    "lama": Removal("lama", QUICK),
}


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """The folder of a tiny comparison, its priors, and its figures by method."""
    folder = tmp_path_factory.mktemp("fill")
    priors = {"classical": available_priors(COMPARED)["classical"], "lama": "no weights"}
    return folder, priors, measure_all(CAPTURES, folder, priors, COMPARED)


def test_each_method_is_measured_but_those_without_a_prior(measured):
    _, _, results = measured
    assert list(results) == [("corner", 0)]
    figures = results["corner", 0]
    assert list(figures) == ["mean colour", "classical", "true references", "true views"]
    for found in figures.values():
        numbers = [value for value in found.values() if value is not None]
        assert np.isfinite(numbers).all()
        assert found["psnr"] > 5 and 0 <= found["left"] < 1
    assert figures["mean colour"]["depth_error"] is None and 0 < figures["classical"]["depth_error"] < 0.3


def test_true_images_come_out_ahead(measured):
    figures = measured[2]["corner", 0]
    assert figures["true views"]["unseen"] is None, "no error at all"
    assert figures["true views"]["psnr"] > figures["classical"]["psnr"] - 0.5
    assert figures["true references"]["unseen"] > figures["classical"]["unseen"] + 1
    assert figures["true views"]["contrast"] == pytest.approx(1.0, abs=0.05)
    assert figures["mean colour"]["contrast"] == pytest.approx(0.0, abs=1e-4)


def test_pictures_of_each_cell_are_kept(measured):
    folder, _, _ = measured
    shown = {
        name: read_picture(picture_path(folder, ("corner", 0), name))
        for name in ("photograph", "truth", "classical filled", "classical rendered", "true views filled")
    }
    assert len({image.shape for image in shown.values()}) == 1
    assert all(image.std() > 0.05 for image in shown.values())
    assert np.abs(shown["photograph"] - shown["truth"]).max() > 0.2, "the object"
    assert np.abs(shown["true views filled"] - shown["truth"]).mean() < 0.02


def test_what_was_measured_is_not_measured_again(measured, monkeypatch):
    folder, priors, results = measured
    monkeypatch.setattr(Cell, "_measure", lambda *_: pytest.fail("measured again"))
    assert measure_all(CAPTURES, folder, priors, COMPARED) == results


def test_an_interrupted_comparison_goes_on(measured, monkeypatch):
    folder, priors, results = measured
    done = folder / "corner-0" / "classical.json"
    kept = done.read_bytes()
    done.unlink()
    asked = []
    monkeypatch.setattr(
        Cell, "_measure", lambda self, methods: asked.append(list(methods)) or done.write_bytes(kept)
    )
    assert measure_all(CAPTURES, folder, priors, COMPARED) == results
    assert asked == [["classical"]]


def test_figures_of_other_settings_are_refused(measured):
    folder, priors, _ = measured
    with pytest.raises(InputError, match="figures of other settings"):
        measure_all(replace(CAPTURES, width=80), folder, priors, COMPARED)


def test_priors_that_cannot_be_loaded_say_why(monkeypatch):
    def load(name):
        raise InputError(f"no weights of {name}")

    monkeypatch.setattr(measure, "load_prior", load)
    assert available_priors(COMPARED) == {
        "classical": "no weights of classical",
        "lama": "no weights of lama",
    }


def floor_seen(eyes) -> tuple[list[Camera], list[np.ndarray]]:
    """Cameras above a floor at z = 0, and its depth."""
    cameras, depths = [], []
    for eye in eyes:
        camera = Camera(40, 30, 30.0, 30.0, 20.0, 15.0, torch.from_numpy(look_at(np.array(eye), np.zeros(3))))
        rows, columns = np.mgrid[:30, :40]
        rays = np.stack([(columns + 0.5 - 20) / 30, (rows + 0.5 - 15) / 30, np.ones((30, 40))], -1)
        cameras.append(camera)
        depths.append((-eye[2] / (rays @ camera.pose[:3, :3])[..., 2]).astype(np.float32))
    return cameras, depths


def test_unseen_is_what_every_view_hides():
    cameras, depths = floor_seen([(-1.0, -2.0, 2.0), (1.0, -2.0, 2.0)])
    left, right = np.zeros((30, 40), bool), np.zeros((30, 40), bool)
    left[12:18, 15:25] = True
    only_left = unseen_pixels(cameras, depths, [left, right])
    assert not only_left[0].any(), "the other view shows all of it"
    right[:] = True
    both = unseen_pixels(cameras, depths, [left, right])
    assert (both[0] == left).all()
    assert both[1].any() and not both[1].all(), "the first view shows the rest"


def test_unseen_is_also_what_lies_out_of_every_other_picture():
    cameras, depths = floor_seen([(0.0, -2.0, 2.0), (6.0, -2.0, 2.0)])
    hidden = np.ones((30, 40), bool)
    none = np.zeros((30, 40), bool)
    away = cameras[1].with_pose(
        torch.from_numpy(look_at(np.array((6.0, -2.0, 2.0)), np.array((12.0, 0.0, 0.0))))
    )
    found = unseen_pixels([cameras[0], away], depths, [hidden, none])
    assert found[0].all() and not found[1].any()


def made_up(value: float) -> Figures:
    return Figures(
        psnr=value + 1, ssim=0.8, unseen=value, contrast=0.5, left=0.02, disagreement=9.0, depth_error=None,
        elsewhere=None, seconds=3.0,
    )  # fmt: skip


def test_page(monkeypatch, tmp_path):
    pytest.importorskip("matplotlib")
    captures = Captures(("rug", "tiles"), seeds=2)
    results = {
        place: {
            name: made_up(15.0 + 2 * index + place[1])
            for index, name in enumerate(METHODS)
            if "lama" not in name
        }
        for place in captures.cells
    }
    rng = np.random.default_rng(0)
    monkeypatch.setattr(page, "available_priors", lambda methods: {"exemplar": None, "lama": "no weights"})
    monkeypatch.setattr(page, "measure_all", lambda *_: results)
    monkeypatch.setattr(page, "read_picture", lambda path: rng.random((12, 16, 3), np.float32))
    tables = page.bench_fill(tmp_path / "out", tmp_path / "work", captures)
    assert [len(table.rows) for table in tables] == [len(METHODS) - 2] * 3
    assert tables[1].columns == ["", "rug", "tiles"]
    text = (tmp_path / "out" / "fill.md").read_text()
    assert "**lama** is not measured: no weights." in text
    assert "| mean colour of each view | 15.50 ± 0.71 | 15.50 ± 0.71 |" in text
    assert "--situations rug,tiles --seeds 2 --size 160x120 --views 16" in text
    assert PICTURED in METHODS
    for name in ("fill.png", "fill-pictures.png"):
        assert read_picture(tmp_path / "out" / name).std() > 0.05


def test_an_unknown_situation_is_one_line(capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["bench", "fill", "--situations", "rug,kitchen"])
    error = capsys.readouterr().err
    assert stopped.value.code == 2 and error.count("\n") == 1 and "'kitchen'" in error


def test_too_few_views_are_one_line(capsys):
    assert main(["bench", "fill", "--views", "3"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "use 6 or more" in error
