"""Perceptual metrics of a run: without weights, with random ones, and on damaged input."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from diga3d_warp.cli import main
from diga3d_warp.errors import InputError
from diga3d_warp.evaluation import frames
from diga3d_warp.evaluation.correspondences import SiftMatcher
from diga3d_warp.evaluation.lpips import ALEX, Lpips
from diga3d_warp.evaluation.metrics import bounding_box
from diga3d_warp.evaluation.perceptual import (
    EditText,
    Gathering,
    Pair,
    Perceptual,
    edit_text,
    perceptual_tables,
)
from diga3d_warp.evaluation.protocols import evaluate
from diga3d_warp.evaluation.record import MANIFEST, METRICS, RESULT, SOURCE, read_manifest, read_metrics
from diga3d_warp.evaluation.report import write_report
from diga3d_warp.files import write_image, write_json

LIBRARIES = ("torchmetrics", "torchvision", "torch_fidelity", "transformers")


@pytest.fixture
def no_weights(tmp_path, monkeypatch):
    import huggingface_hub.constants

    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "torch"))
    monkeypatch.setattr(huggingface_hub.constants, "HF_HUB_CACHE", str(tmp_path / "hub"))


@pytest.fixture
def weights(weights_of, no_weights):
    for library in LIBRARIES:
        pytest.importorskip(library, reason="needs the extra [metrics]")
    return weights_of("alex", "clip", "musiq", "inception", "loftr")


class Constant:
    """A metric whose figure is known."""

    title = "MUSIQ"

    def score(self, picture):
        return float(picture.mean())


class Firsts:
    """Features of a picture: its first two values."""

    def features(self, picture):
        return picture.flatten()[:2].double().numpy()


def random(seed, height=24, width=32):
    return torch.rand(height, width, 3, generator=torch.Generator().manual_seed(seed))


def test_without_weights_the_cells_say_so(toy_run, no_weights):
    tables = {
        table.title.split(",")[0].split(":")[0]: table
        for table in evaluate(
            toy_run.folder, scene=toy_run.scene, perceptual=Perceptual.load(text=EditText("a", "b"))
        )
    }
    assert "diga3d eval" not in "".join(tables)
    metrics = tables["Perceptual metrics"]
    assert [row[0] for row in metrics.rows] == ["LPIPS (VGG)", "LPIPS (Alex)", "CLIP_dir", "MUSIQ", "FID"]
    assert {cell for row in metrics.rows for cell in row[1:]} == {"not measured"}
    lines = dict(tables["Not measured"].rows)
    for title, said in (
        ("LPIPS (VGG)", "553 MB"), ("LPIPS (Alex)", "244 MB"), ("CLIP_dir", "1.7 GB"),
        ("MUSIQ", "109 MB"), ("FID", "96 MB"), ("LoFTR matches", "46 MB"),
    ):  # fmt: skip
        assert said in lines[title] and ("curl -L" in lines[title] or "hf download" in lines[title])
    corrs = tables["Corrs"]
    assert corrs.columns == [
        "frames", "pairs", "SIFT matches", "in the mask", "LoFTR matches", "in the mask"
    ]  # fmt: skip
    assert {row[4] for row in corrs.rows} == {"not measured"}
    assert [row[0] for row in corrs.rows] == [
        *("edited, along a path", "source, along a path"),
        *("edited, between views", "source, between views"),
    ]
    assert all(float(row[2]) >= 0 for row in corrs.rows)
    page = write_report(toy_run.folder).read_text()
    assert "not measured" in page and "vgg16-397923af.pth" in page


def test_every_metric_runs_on_random_weights(toy_run, weights, monkeypatch):
    monkeypatch.setattr(frames, "PATH_PAIRS", ((0, 5),))
    monkeypatch.setattr(frames, "VIEW_PAIRS", 1)
    metrics = Perceptual.load(weights, text=EditText("a stone bear", "a gold bear"))
    assert set(metrics.missing) <= {"LPIPS (VGG)"}
    metrics.lpips = metrics.lpips[-1:]  # VGG may be there, too, and runs in test_lpips
    metrics.matchers.pop(0)
    tables = evaluate(toy_run.folder, scene=toy_run.scene, perceptual=metrics)
    figures = read_metrics(toy_run.folder)["evaluation"]["perceptual"]
    means = {title: entry["mean"] for title, entry in figures["comparisons"].items()}
    source, edited, change = means.values()
    assert set(source) == {"LPIPS (Alex)", "MUSIQ", "FID"}
    assert set(edited) == {"LPIPS (Alex)", "MUSIQ"}, "photographs without the object are not there"
    assert set(change) == {"LPIPS (Alex)", "CLIP_dir"}
    assert set(source["LPIPS (Alex)"]) == {"whole", "unmasked"}
    assert source["LPIPS (Alex)"]["whole"] > 0 and source["FID"]["whole"] > 0
    assert edited["LPIPS (Alex)"] == pytest.approx({"unmasked": source["LPIPS (Alex)"]["unmasked"]}, rel=1e-4)
    assert change["LPIPS (Alex)"]["unmasked"] == 0.0, "outside of the mask nothing changed"
    assert source["MUSIQ"] != edited["MUSIQ"] and -1 <= change["CLIP_dir"]["whole"] <= 1
    assert change["CLIP_dir"]["whole"] != 0
    views = figures["comparisons"]["edited against source"]["views"]
    assert change["CLIP_dir"]["whole"] == pytest.approx(
        np.mean([view["CLIP_dir"]["whole"] for view in views.values()])
    )
    assert {title for row in figures["corrs"]["rows"] for title in row["matches"]} == {"LoFTR matches"}
    assert [row[0] for row in tables[1].rows][-3:] == ["CLIP_dir", "MUSIQ", "FID of 2 pictures"]


def test_box_and_mask_against_ground_truth(toy_run, toy_truth, weights):
    metrics = Perceptual(lpips=[Lpips(ALEX, weights)])
    evaluate(toy_run.folder, "spin-nerf", scene=toy_truth, perceptual=metrics)
    (entry,) = read_metrics(toy_run.folder)["evaluation"]["perceptual"]["comparisons"].values()
    scores = entry["mean"]["LPIPS (Alex)"]
    assert list(scores) == ["whole", "masked", "box", "unmasked"]
    assert scores["masked"] > scores["whole"] > scores["unmasked"] > 0, "the mask is what differs"


def test_a_fit_has_no_edit(toy_run):
    (toy_run.folder / SOURCE).replace(toy_run.folder / RESULT)
    metrics = Perceptual(musiq=Constant(), inception=Firsts(), matchers=[SiftMatcher()])
    evaluate(toy_run.folder, scene=toy_run.scene, perceptual=metrics)
    figures = read_metrics(toy_run.folder)["evaluation"]["perceptual"]
    assert set(figures["comparisons"]["fit against photographs"]["mean"]) == {"MUSIQ", "FID"}
    rows = figures["corrs"]["rows"]
    assert [row["title"] for row in rows] == ["fit, along a path", "fit, between views"]
    assert rows[1]["pairs"] == 5, "six views in a row"
    assert rows[1]["matches"]["SIFT matches"]["masked"] is None


def test_telea_stands_beside_removals_only(toy_run):
    for view in toy_run.scene.views:
        write_image(toy_run.folder / "masks" / f"{view.name}.png", view.mask)
    manifest = read_manifest(toy_run.folder)
    for command, expected in (("remove", 5), ("replace", 4)):
        write_json(toy_run.folder / MANIFEST, {**manifest, "command": command})
        evaluate(toy_run.folder, scene=toy_run.scene, perceptual=Perceptual(matchers=[SiftMatcher()]))
        rows = read_metrics(toy_run.folder)["evaluation"]["perceptual"]["corrs"]["rows"]
        assert len(rows) == expected
        assert all(row["matches"]["SIFT matches"]["masked"] is not None for row in rows[2:])


def test_means_over_the_views_that_have_the_figure():
    gathering = Gathering(Perceptual(musiq=Constant(), inception=Firsts()))
    gathering.add("one", Pair(torch.full((4, 5, 3), 0.25), torch.zeros(4, 5, 3)))
    assert gathering.as_json()["mean"] == {"MUSIQ": {"whole": 0.25}}, "one picture is no set"
    gathering.add("two", Pair(torch.full((4, 5, 3), 0.75), torch.zeros(4, 5, 3)))
    mean = gathering.as_json()["mean"]
    assert mean["MUSIQ"] == {"whole": 0.5}
    assert mean["FID"]["whole"] == pytest.approx(2 * 0.25 + 2 * 0.125), "means 0.5 apart, variance 0.125"
    gathering.add("change", Pair(torch.ones(4, 5, 3), torch.zeros(4, 5, 3), edit=True))
    assert gathering.as_json()["mean"] == mean and gathering.views["change"] == {}


def test_values_beyond_a_screens_are_clipped():
    metrics = Perceptual(musiq=Constant())
    assert metrics.view(Pair(torch.full((4, 5, 3), 7.0), torch.zeros(4, 5, 3)))["MUSIQ"]["whole"] == 1.0


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_pictures_that_are_not_finite_are_one_line(value):
    broken = random(0)
    broken[3, 4, 1] = value
    for pair in (Pair(broken, random(1)), Pair(random(1), broken)):
        with pytest.raises(InputError, match=r"^view_7: a picture is not finite in 1 of"):
            Gathering(Perceptual(musiq=Constant())).add("view_7", pair)


def test_pictures_that_do_not_fit_are_one_line():
    metrics = Perceptual()
    with pytest.raises(InputError, match="cannot be compared"):
        metrics.view(Pair(random(0), random(0, 12, 12)))
    with pytest.raises(InputError, match="not RGB"):
        metrics.view(Pair(random(0)[..., 0], random(0)[..., 0]))


def test_too_small_a_picture_has_no_lpips(weights):
    metrics = Perceptual(lpips=[Lpips(ALEX, weights)])
    assert metrics.view(Pair(random(0, 20, 40), random(1, 20, 40))) == {}
    gathering = Gathering(metrics)
    gathering.add("small", Pair(random(0, 20, 40), random(1, 20, 40)))
    figures = {"missing": {}, "comparisons": {"a against b": gathering.as_json()}}
    assert perceptual_tables(figures) == []


def test_boxes_are_grown_inside_the_picture():
    mask = torch.zeros(40, 50, dtype=torch.bool)
    mask[0, 49] = True
    rows, columns = bounding_box(mask, 31)
    assert (rows.start, rows.stop, columns.start, columns.stop) == (0, 31, 19, 50)


def test_text_of_an_edit():
    manifest = {"command": "retexture", "settings": {"prompt": "gold"}}
    assert edit_text(manifest, "stone") == EditText("stone", "gold")
    assert edit_text(manifest, "stone", "a gold bear") == EditText("stone", "a gold bear")
    assert edit_text({**manifest, "settings": {}}) == EditText(None, None)
    removal = {"command": "remove", "settings": {}}
    assert edit_text(removal) is None
    assert edit_text(removal, "a room with a vase", "a room") == EditText("a room with a vase", "a room")
    assert edit_text(removal, "a room with a vase") == EditText("a room with a vase", None)
    assert edit_text({**removal, "command": "fit"}) is None
    with pytest.raises(InputError, match="a fit has no edit"):
        edit_text({**removal, "command": "fit"}, "stone")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (EditText("stone", None), "followed no prompt: give --edit-prompt"),
        (EditText(None, "gold"), "give --source-prompt"),
    ],
)
def test_a_direction_without_texts_is_not_measured(no_weights, text, said):
    metrics = Perceptual.load(text=text)
    assert metrics.clip is None and said in metrics.missing["CLIP_dir"]
    assert "\n" not in metrics.missing["CLIP_dir"]


def test_a_run_without_text_has_no_row_for_it(no_weights):
    assert "CLIP_dir" not in Perceptual.load().missing


def test_missing_libraries_are_named(weights, monkeypatch):
    import diga3d_warp.evaluation.weights as module

    monkeypatch.setattr(module, "find_spec", lambda name: None)
    missing = Perceptual.load(weights, text=EditText("a", "b")).missing
    for title in ("LPIPS (Alex)", "CLIP_dir", "FID"):
        assert missing[title].endswith("not installed: pip install 'diga3d-warp[metrics]'")


def test_weights_that_are_no_folder(tmp_path):
    with pytest.raises(InputError, match="is not a folder: give the one that holds the weights"):
        Perceptual.load(tmp_path / "none")


@pytest.mark.parametrize(
    "change", [{"missing": 3}, {"corrs": {"size": [1, 1]}}, {"comparisons": {"a": {"mean": {"FID": 3}}}}]
)
def test_damaged_figures_are_one_line(toy_run, no_weights, change):
    evaluate(toy_run.folder, scene=toy_run.scene, perceptual=Perceptual.load())
    figures = json.loads((toy_run.folder / METRICS).read_text())
    figures["evaluation"]["perceptual"].update(change)
    write_json(toy_run.folder / METRICS, figures)
    with pytest.raises(InputError, match=r"metrics\.json is damaged .*perceptual"):
        read_metrics(toy_run.folder)


def test_eval_of_a_folder_without_weights(tmp_path, capsys):
    assert main(["eval", str(tmp_path), "--weights", str(tmp_path)]) == 2
    assert "holds no run" in capsys.readouterr().err


def test_a_single_view_has_no_neighbour(toy_run, no_weights):
    from diga3d_warp.evaluation.record import CAMERAS
    from diga3d_warp.scene.layouts.cameras_file import load_cameras, save_cameras

    cameras = load_cameras(toy_run.folder / CAMERAS)
    for count, expected in ((1, ["edited, along a path", "source, along a path"]), (0, [])):
        few = dict(list(cameras.train.items())[:count])
        save_cameras(toy_run.folder / CAMERAS, replace(cameras, train=few))
        evaluate(toy_run.folder, scene=toy_run.scene, perceptual=Perceptual(matchers=[SiftMatcher()]))
        rows = read_metrics(toy_run.folder)["evaluation"]["perceptual"]["corrs"]["rows"]
        assert [row["title"] for row in rows] == expected


def test_damaged_figures_are_refused_before_the_work(toy_run):
    class Never:
        title = "MUSIQ"

        def score(self, picture):
            raise AssertionError("measured")

    (toy_run.folder / METRICS).write_text('{"evaluation": 3}')
    with pytest.raises(InputError, match="is damaged"):
        evaluate(toy_run.folder, scene=toy_run.scene, perceptual=Perceptual(musiq=Never()))
