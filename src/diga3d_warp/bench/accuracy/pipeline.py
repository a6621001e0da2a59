"""Quality and cost of references, iterations and diffusion steps, on a small synthetic room."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

from diga3d_warp.bench.page import write_page
from diga3d_warp.bench.room import BUDGET, HOLD_OUT, ROOM, against_truth, share_stages
from diga3d_warp.evaluation.metrics import Score
from diga3d_warp.evaluation.record import read_manifest
from diga3d_warp.evaluation.tables import Table
from diga3d_warp.gaussians.fit import FitSettings
from diga3d_warp.pipelines.method import WARPED
from diga3d_warp.pipelines.remove import RemoveSettings, remove_object
from diga3d_warp.pipelines.run import Run
from diga3d_warp.priors.exemplar.prior import ExemplarPrior
from diga3d_warp.priors.exemplar.settings import FillSettings
from diga3d_warp.scene.load import load_scene
from diga3d_warp.scene.scene import Scene
from diga3d_warp.scene.synthetic.generate import generate


@dataclass(frozen=True)
class Trial:
    """A removal.

    Attributes:
        iterations: Of the fit of the capture.
        references: Number K of references.
        steps: Diffusion steps at the coarsest scale; finer ones take half as many.
        seed: Of the edit.
    """

    iterations: int = 600
    references: int = 3
    steps: int = FillSettings.steps_first
    seed: int = 0

    @property
    def settings(self) -> RemoveSettings:
        fit = FitSettings(iterations=self.iterations, budget=BUDGET)
        return RemoveSettings(fit=fit, method=replace(WARPED, references=self.references))

    @property
    def prior(self) -> ExemplarPrior:
        steps = FillSettings(steps_first=self.steps, steps_next=max(1, self.steps // 2))
        return ExemplarPrior(settings=steps)


USUAL = Trial()
KNOBS = {
    "iterations": [replace(USUAL, iterations=count) for count in (150, 300, 600, 1200)],
    "references": [replace(USUAL, references=count) for count in (1, 3, 5)],
    "steps": [replace(USUAL, steps=count) for count in (2, 6, 12, 24)],
    "seed": [replace(USUAL, seed=seed) for seed in (0, 1, 2)],
}
"""Trials by the field that they vary."""


@dataclass(frozen=True)
class Outcome:
    """Times and scores of a removal.

    Attributes:
        fit, fill, refit: Wall times of the stages [s].
        score: Scores against the room without the object by region, mean over held-out views.
    """

    fit: float
    fill: float
    refit: float
    score: dict[str, Score]


def bench_pipeline(out: Path) -> list[Table]:
    """Measure, and write `accuracy_pipeline.md`.

    Args:
        out: Folder of the page.

    Returns:
        The tables of the page.

    Raises:
        InputError: the folder cannot be written.
    """
    with tempfile.TemporaryDirectory() as folder:
        capture = generate(ROOM, Path(folder) / "room")
        scene = load_scene(capture, hold_out=HOLD_OUT)
        outcomes = dict(outcomes_of(scene, Path(folder)))
    tables = [trial_table(outcomes)]
    command = f"diga3d bench accuracy --pipeline --out {out}"
    write_page(out / "accuracy_pipeline.md", "What a removal's settings cost", command, tables, [], NOTES)
    return tables


NOTES = f"""\
One setting of `diga3d remove` is turned at a time, on a synthetic room of {ROOM.width} x {ROOM.height} px
and {ROOM.views} views, every {HOLD_OUT}th held out. PSNR is that of the held-out views against the room
without the object, over the whole image and within the widened masks. Seconds are wall times of single
stages, each run once. Another seed of the edit tells how much of a difference is chance.
"""


def outcomes_of(scene: Scene, folder: Path) -> Iterator[tuple[Trial, Outcome]]:
    """Run each trial once; those that differ from the usual one in the edit alone share its fit."""
    usual: Run | None = None
    for index, trial in enumerate(dict.fromkeys([USUAL, *chain(*KNOBS.values())])):
        run = Run(folder / str(index), "remove", {"scene": scene.path})
        if usual is not None and trial.iterations == USUAL.iterations:
            share_stages(usual.folder, run.folder)
        usual = usual or run
        result = remove_object(scene, run, trial.settings, prior=trial.prior, seed=trial.seed)
        seconds = {stage["name"]: stage["seconds"] for stage in read_manifest(run.folder)["stages"]}
        score = against_truth(scene, result, trial.settings)
        yield trial, Outcome(seconds["fit"], seconds["fill"], seconds["refit"], score)


def trial_table(outcomes: dict[Trial, Outcome]) -> Table:
    """A row for each setting of each knob."""
    rows = []
    for knob, trials in KNOBS.items():
        for trial in trials:
            found = outcomes[trial]
            value = getattr(trial, knob)
            times = [f"{seconds:.1f}" for seconds in (found.fit, found.fill, found.refit)]
            quality = [f"{found.score[region].psnr:.2f}" for region in ("whole", "masked")]
            rows.append((f"{knob} {value}" + (" (usual)" if trial == USUAL else ""), *times, *quality))
    columns = ["", "fit [s]", "fill [s]", "refit [s]", "PSNR whole [dB]", "PSNR masked [dB]"]
    return Table("Settings of a removal", columns, rows)
