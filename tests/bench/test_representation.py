"""Anchors against gaussians: both are fitted and edited, and the page says what each gave."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import pytest

from diga3d_warp.bench import representation
from diga3d_warp.bench.representation import Cell, bench_representation
from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.record import read_manifest
from diga3d_warp.pipelines import baking
from diga3d_warp.pipelines import remove as removal
from diga3d_warp.scene.synthetic.generate import SyntheticScene, generate


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return generate(SyntheticScene(width=48, height=36, views=9), tmp_path_factory.mktemp("capture") / "room")


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr(baking, "BAKE", replace(baking.BAKE, iterations=3))
    monkeypatch.setattr(removal, "REFIT", replace(removal.REFIT, iterations=3))
    without = partial(removal.remove, surfaces=False)
    monkeypatch.setattr(representation, "remove", without)


def test_a_page_compares_both(capture, tmp_path, quick):
    work = tmp_path / "work"
    fits, edits = bench_representation([capture], tmp_path, work, iterations=10)
    assert [row[:2] for row in fits.rows] == [("room", "gaussians"), ("room", "scaffold")]
    assert [row[:2] for row in edits.rows] == [("room", "gaussians"), ("room", "scaffold")]
    for row in fits.rows:
        iterations, seconds, rows, megabytes, psnr, baked, baking_seconds = map(float, row[2:])
        assert iterations >= 1 and rows > 0 and megabytes > 0.0 and seconds >= 0.0
        assert 5.0 < psnr < 60.0 and 5.0 < baked < 60.0
        assert (baking_seconds == 0.0 and psnr == baked) or row[1] == "scaffold"
    for row in edits.rows:
        assert float(row[3]) > 5.0 and float(row[4]) > 1.0, "something was taken out"
    page = (tmp_path / "representation.md").read_text()
    assert "diga3d bench representation" in page and fits.title in page and edits.title in page
    folders = [work / "room" / name for name in ("gaussians/run", "scaffold/run", "pilot")]
    before = [read_manifest(folder)["stages"] for folder in folders]
    assert bench_representation([capture], tmp_path, work, iterations=10) == [fits, edits]
    assert [read_manifest(folder)["stages"] for folder in folders] == before, "nothing runs twice"


def test_a_capture_that_holds_nothing_out_is_refused(capture, tmp_path, monkeypatch):
    load = representation.load_scene
    monkeypatch.setattr(
        representation, "load_scene", lambda path, **options: load(path, **{**options, "hold_out": 0})
    )
    with pytest.raises(InputError, match="nothing to measure on"):
        bench_representation([capture], tmp_path, tmp_path / "work", iterations=3)
    assert not (tmp_path / "work").exists()


def test_tables_hold_what_was_measured():
    plain = Cell("garden", "gaussians", 3000, 61.2, 60000, 14.9, 27.123, 27.123, 0.0)
    anchors = Cell("garden", "scaffold", 2100, 60.8, 9000, 2.6, 27.3, 27.2, 12.0, 30.0, 26.0, 21.5)
    assert representation._fits([plain, anchors]).rows[1] == (
        "garden", "scaffold", "2100", "61", "9000", "2.6", "27.30", "27.20", "12",
    )  # fmt: skip
    assert representation._edits([anchors]).rows == [("garden", "scaffold", "30", "26.00", "21.5")]
