"""Edits by text against the truth, on a tiny random network: what is compared, and that it is kept."""

from dataclasses import replace

import pytest

from diga3d_warp.bench.captures import Captures
from diga3d_warp.bench.prompts import measure, page
from diga3d_warp.bench.prompts.edits import BUILT_IN, UNEDITED, Prompts, knows, methods_of, settings_of
from diga3d_warp.errors import InputError
from diga3d_warp.files import write_json
from diga3d_warp.gaussians.fit import FitSettings
from diga3d_warp.pipelines.remove import DISTIL, REFIT, RemoveSettings
from diga3d_warp.priors.named import load_prior
from diga3d_warp.priors.settings import SamplingSettings
from diga3d_warp.scene.photographs.images import read_image
from tiny_diffusion import write_checkpoint

TINY = RemoveSettings(
    fit=FitSettings(iterations=60, budget=2000),
    refit=replace(REFIT, iterations=8),
    distil=replace(DISTIL, iterations=4),
)
CAPTURES = Captures(("rug",), seeds=1, width=64, height=48, views=8, settings=TINY)


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """A tiny comparison: its page's folder, its cell and its tables."""
    pytest.importorskip("matplotlib")
    folder = tmp_path_factory.mktemp("prompts")
    prior = load_prior(str(write_checkpoint(folder / "sd")), controls=("edges", "depth"))
    full, *_ = (method for name, method in methods_of("sd").items() if name == "sd")
    method = replace(full, references=2, sampling=SamplingSettings(steps=2))
    with pytest.MonkeyPatch.context() as patch:
        built_in = replace(methods_of("sd")[BUILT_IN], surfaces=False)
        patch.setattr(page, "methods_of", lambda name: {BUILT_IN: built_in, name: method})
        patch.setattr(page, "load_prior", lambda *_, **__: prior)
        tables = page.bench_prompts(folder / "out", folder / "work", CAPTURES, str(folder / "sd"))
    return folder, measure.Cell(CAPTURES, "rug", 0, folder / "work", prior), tables


def test_each_task_is_compared_with_the_truth_of_its_prompt(measured):
    _, cell, tables = measured
    assert [table.title for table in tables] == ["retexture", "replace"]
    for table in tables:
        assert [row[0].split(" (")[0] for row in table.rows] == [UNEDITED, BUILT_IN, "sd"]
        assert all(len(row) == len(table.columns) for row in table.rows)
        unedited, _, network = table.rows
        assert unedited[0].endswith("(1)") and network[0].endswith("(1)")
        assert unedited[3] == "–" and unedited[4] == "0", "photographs are nearest to themselves"
        assert 3.0 < float(network[1]) < 40.0 and network[1] != unedited[1]
    assert not (cell.folder / "runs").exists()


def test_the_page_names_the_prompts_and_shows_the_edits(measured):
    folder, cell, _ = measured
    text = (folder / "out" / "prompts_sd.md").read_text()
    assert f"| rug 0 | {cell.prompts.retexture} | {cell.prompts.replace} |" in text
    assert "diga3d bench prompts --prior" in text
    assert read_image(folder / "out" / "prompts_sd.png").std() > 20, "not blank"


def test_what_was_measured_is_not_measured_again(measured, monkeypatch):
    _, cell, _ = measured
    monkeypatch.setattr(cell, "_measure", None)
    found = cell.figures("replace", {"sd": None})
    assert list(found) == [UNEDITED, "sd"] and found["sd"]["psnr"] > 0


def test_prompts_are_the_captions_without_their_surroundings(tmp_path):
    captions = {
        "object": "a copper bucket",
        "images": "a copper bucket in front of a bench, a wall behind",
        "other_object": "a cork parcel in front of a bench, a wall behind",
        "other_material": "a steel bucket in front of a bench, a wall behind",
    }
    write_json(tmp_path / "captions.json", captions)
    assert Prompts.of(tmp_path) == Prompts("a steel bucket", "a cork parcel")


def test_built_in_words_are_tried_where_they_are_known():
    assert knows("retexture", "white marble") and not knows("retexture", "a slice of toast")
    assert knows("replace", "a golden sphere") and not knows("replace", "a teapot")


def test_fits_are_as_long_as_those_of_the_removal():
    method = methods_of("sd")["sd"]
    assert settings_of("retexture", method, TINY).refit.iterations == 8
    assert settings_of("replace", method, TINY).grow.iterations == 8
    assert settings_of("replace", method, TINY).removal.method == method


def test_a_prior_that_reads_no_prompts_is_refused(tmp_path):
    pytest.importorskip("matplotlib")
    with pytest.raises(InputError, match="prior exemplar reads no prompts: give a network"):
        page.bench_prompts(tmp_path, tmp_path / "work", CAPTURES, "exemplar")
