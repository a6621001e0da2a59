"""More sparse points than a fit may have gaussians."""

from __future__ import annotations

from diga3d_warp.evaluation.record import read_manifest
from diga3d_warp.gaussians.fit import FitSettings
from diga3d_warp.pipelines import stages
from diga3d_warp.pipelines.run import Run
from diga3d_warp.scene.load import load_scene


def test_a_fit_starts_from_no_more_points_than_its_budget(room, tmp_path, monkeypatch):
    scene = load_scene(room)
    count = len(scene.points)
    assert count > 500
    run = Run(tmp_path / "run", "fit", {})
    monkeypatch.setattr(stages, "priced", lambda plan, *_: plan)  # prices take seconds to measure
    begun = stages.begin(run, scene)
    fitted = stages.fit_source(run, begun, FitSettings(iterations=2, budget=500), seed=0)
    assert len(fitted) == 500
    notes = read_manifest(run.folder)["notes"]
    assert any(f"starts from 500 of {count} sparse points, thinned evenly in space" in note for note in notes)
