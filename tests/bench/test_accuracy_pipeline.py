"""Settings of a removal: runs that differ in the edit alone share their fit; the page shows each setting."""

from types import SimpleNamespace

from diga3d_warp.bench.accuracy import pipeline
from diga3d_warp.bench.accuracy.pipeline import KNOBS, USUAL, Outcome, Trial, bench_pipeline, outcomes_of
from diga3d_warp.evaluation.metrics import Score


def test_trials_become_settings():
    trial = Trial(iterations=7, references=5, steps=1)
    assert trial.settings.fit.iterations == 7
    assert trial.settings.method.references == 5
    assert (trial.prior.settings.steps_first, trial.prior.settings.steps_next) == (1, 1)
    assert Trial().prior.settings == type(trial.prior)().settings, "usual steps are the prior's own"
    assert all(USUAL in trials for trials in KNOBS.values())


def test_only_what_a_setting_changes_runs_again(monkeypatch, tmp_path):
    ran = []

    def remove(scene, run, settings, *, prior, seed):
        for name in ("fit", "clear", "references", "fill", "refit"):
            run.stage(name, lambda folder, name=name: ran.append(name))
        return SimpleNamespace(run=run)

    monkeypatch.setattr(pipeline, "remove_object", remove)
    monkeypatch.setattr(pipeline, "against_truth", lambda *_: {})
    knobs = {"iterations": [USUAL, Trial(iterations=9)], "references": [Trial(references=1), USUAL]}
    monkeypatch.setattr(pipeline, "KNOBS", knobs)
    outcomes = dict(outcomes_of(SimpleNamespace(path=tmp_path), tmp_path))
    assert list(outcomes) == [USUAL, Trial(iterations=9), Trial(references=1)]
    everything, edit = ["fit", "clear", "references", "fill", "refit"], ["references", "fill", "refit"]
    assert ran == everything + everything + edit
    assert outcomes[Trial(references=1)].fit == outcomes[USUAL].fit


def test_page(monkeypatch, tmp_path):
    trials = [trial for group in KNOBS.values() for trial in group]
    score = {"whole": Score(30.0, 0.9), "masked": Score(20.0, 0.8)}
    made_up = {trial: Outcome(2.0, 3.0, 4.0, score) for trial in trials}
    monkeypatch.setattr(pipeline, "generate", lambda room, folder: folder)
    monkeypatch.setattr(pipeline, "load_scene", lambda folder, hold_out: None)
    monkeypatch.setattr(pipeline, "outcomes_of", lambda scene, folder: made_up.items())
    (table,) = bench_pipeline(tmp_path)
    assert len(table.rows) == 14
    text = (tmp_path / "accuracy_pipeline.md").read_text()
    assert "| references 3 (usual) | 2.0 | 3.0 | 4.0 | 30.00 | 20.00 |" in text
    assert f"`diga3d bench accuracy --pipeline --out {tmp_path}`" in text
