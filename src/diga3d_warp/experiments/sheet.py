"""Sheet: what an experiment compares, and its tables once the jobs are done."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from diga3d_warp.evaluation.perceptual import NOT_MEASURED
from diga3d_warp.evaluation.tables import Table
from diga3d_warp.experiments.job import Command, Job, Outcome
from diga3d_warp.experiments.published import Published

MEASURED = "measured"
"""Source of figures that the experiment measured itself."""

SIZE, COSTS = "size", "costs.md"
"""In place of a metric: the image size; the file of what jobs cost, which differs from run to run."""

NONE = "–"


@dataclass(frozen=True)
class Column:
    """A column of a sheet.

    Attributes:
        head: Its head, with an arrow to where better figures are.
        metric, region: What stands in it, see `figures.Figures`; or `SIZE` or `COSTS`.
        digits: Digits behind the point.
        command: Only jobs of this subcommand count; None for all.
    """

    head: str
    metric: str
    region: str = "whole"
    digits: int = 2
    command: Command | None = None


@dataclass(frozen=True)
class Row:
    """A row of a sheet.

    Attributes:
        method: What is measured.
        jobs: Its jobs, a scene or an edit each.
        given: Cells that are no figures of the jobs, by head.
    """

    method: str
    jobs: Sequence[Job]
    given: Mapping[str, str] | None = None


@dataclass(frozen=True)
class Sheet:
    """What an experiment compares.

    Attributes:
        name: Name of its files.
        title: Its title.
        columns, rows: What is measured.
        published: Rows that stand above ours.
        notes: What a reader must know, one line each.
        further: Tables that follow as they are.
    """

    name: str
    title: str
    columns: Sequence[Column]
    rows: Sequence[Row]
    published: Sequence[Published] = ()
    notes: Sequence[str] = ()
    further: Sequence[Table] = ()

    @property
    def jobs(self) -> list[Job]:
        """The jobs of all rows, scene by scene, so that few workers finish scenes early."""
        longest = max((len(row.jobs) for row in self.rows), default=0)
        return [row.jobs[index] for index in range(longest) for row in self.rows if index < len(row.jobs)]

    def main(self, outcomes: Mapping[str, Outcome]) -> Table:
        """Published rows, then ours: means over the scenes that have a figure."""
        heads = [column.head for column in self.columns]
        rows = [
            [row.method, row.source, *(row.cells.get(head, NONE) for head in heads), NONE]
            for row in self.published
        ]
        for row in self.rows:
            found = [(job, outcomes[job.name]) for job in row.jobs]
            done = sum(outcome["error"] is None for _, outcome in found)
            cells = [(row.given or {}).get(column.head) or _mean(column, found) for column in self.columns]
            rows.append([row.method, MEASURED, *cells, f"{done} of {len(found)}"])
        return Table(self.title, ["method", "source", *heads, "jobs done"], rows)

    def single(self, outcomes: Mapping[str, Outcome]) -> Table:
        """A line for each job, failed ones with their error."""
        rows = []
        for row in self.rows:
            for job in row.jobs:
                outcome = outcomes[job.name]
                cells = [_mean(column, [(job, outcome)]) for column in self.columns]
                rows.append([row.method, _subject(job), *cells, outcome["error"] or "done"])
        return Table("Each job", ["method", "scene", *(c.head for c in self.columns), "outcome"], rows)

    def missing(self, outcomes: Mapping[str, Outcome]) -> Table | None:
        """Metrics that were not measured, and what each lacks; None if all were."""
        found: dict[str, str] = {}
        for job in self.jobs:
            for metric, line in outcomes[job.name]["missing"].items():
                found.setdefault(metric, line)
        return (
            Table("Not measured", ["metric", "what it lacks"], [list(p) for p in found.items()])
            if found
            else None
        )

    def tables(self, outcomes: Mapping[str, Outcome]) -> list[Table]:
        """All tables in order."""
        missing = self.missing(outcomes)
        return [
            self.main(outcomes), *self.further, self.single(outcomes), *([] if missing is None else [missing])
        ]  # fmt: skip


def _subject(job: Job) -> str:
    prompt = job.options.get("prompt")
    return f"{job.scene_name}: {prompt}" if prompt else job.scene_name


def _mean(column: Column, found: Sequence[tuple[Job, Outcome]]) -> str:
    """A cell: the mean over jobs that have the figure, of how many if not all; else why there is none."""
    if column.metric == COSTS:
        return COSTS
    counted = [outcome for job, outcome in found if column.command in (None, job.command)]
    done = [outcome for outcome in counted if outcome["error"] is None]
    if not done:
        return "failed" if counted else NONE
    if column.metric == SIZE:
        sizes = dict.fromkeys(f"{width} x {height}" for width, height in (each["size"] for each in done))
        return ", ".join(sizes)
    values = [
        outcome["figures"][column.metric][column.region]
        for outcome in done
        if column.region in outcome["figures"].get(column.metric, {})
    ]
    if not values:
        return NOT_MEASURED
    mean = sum(math.inf if value is None else value for value in values) / len(values)
    part = "" if len(values) == len(done) else f" ({len(values)} of {len(done)})"
    return f"{mean:.{column.digits}f}{part}"
