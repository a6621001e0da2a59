"""What an experiment leaves beside its jobs: tables in Markdown, CSV and LaTeX, costs, a page of pictures."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from diga3d_warp.evaluation.tables import Table
from diga3d_warp.experiments.job import Job, JobFolder, Outcome
from diga3d_warp.experiments.sheet import COSTS, MEASURED, Sheet
from diga3d_warp.files import write_text

if TYPE_CHECKING:
    from collections.abc import Iterator

TEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{",
    "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "↑": r"$\uparrow$",
    "↓": r"$\downarrow$", "–": "--",
}  # fmt: skip
"""What LaTeX would not take as it is."""


def write_results(out: Path, sheets: Sequence[Sheet], outcomes: Mapping[str, Outcome]) -> list[Path]:
    """Write the results of experiments; the same outcomes give the same bytes, but for costs.md.

    Args:
        out: Folder of the jobs.
        sheets: What was compared.
        outcomes: Of all jobs, by name.

    Returns:
        The files written.
    """
    from diga3d_warp.experiments.pictures import write_pictures

    written = []
    for sheet in sheets:
        files = {
            f"{sheet.name}.md": _markdown(sheet, outcomes),
            f"{sheet.name}.csv": _csv(sheet, outcomes),
            f"{sheet.name}.tex": _latex(sheet.main(outcomes)),
        }
        for name, text in files.items():
            write_text(out / name, text)
            written.append(out / name)
    jobs = {job.name: job for sheet in sheets for job in sheet.jobs}
    write_text(out / COSTS, _costs(out, list(jobs.values())).markdown())
    return [*written, out / COSTS, write_pictures(out, sheets)]


def _markdown(sheet: Sheet, outcomes: Mapping[str, Outcome]) -> str:
    tables = (_escaped(table).markdown() for table in sheet.tables(outcomes))
    return "\n".join([f"# {sheet.title}\n", *(f"{note}\n" for note in sheet.notes), *tables])


def _escaped(table: Table) -> Table:
    """A table whose cells break no row of Markdown."""
    rows = [[" ".join(cell.split()).replace("|", "\\|") for cell in row] for row in table.rows]
    return Table(table.title, table.columns, rows)


def _csv(sheet: Sheet, outcomes: Mapping[str, Outcome]) -> str:
    """A line for each published row, each job and each mean."""
    main, single = sheet.main(outcomes), sheet.single(outcomes)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["method", "scene", *(column.head for column in sheet.columns), "outcome", "source"])
    for row in main.rows:
        writer.writerow([row[0], "mean", *row[2:-1], row[-1] if row[1] == MEASURED else "", row[1]])
    for row in single.rows:
        writer.writerow([*row, MEASURED])
    return text.getvalue()


def _latex(table: Table) -> str:
    """The table in booktabs' form; published rows stand above a rule."""

    def line(cells: Sequence[str]) -> str:
        return "  " + " & ".join("".join(TEX.get(sign, sign) for sign in cell) for cell in cells) + r" \\"

    published = [row for row in table.rows if row[1] != MEASURED]
    measured = [row for row in table.rows if row[1] == MEASURED]
    rule = ["  \\midrule"] if published else []
    return "\n".join([
        f"\\begin{{tabular}}{{ll{'c' * (len(table.columns) - 2)}}}", "  \\toprule", line(table.columns),
        "  \\midrule", *map(line, published), *rule, *map(line, measured), "  \\bottomrule", "\\end{tabular}",
        "",
    ])  # fmt: skip


def _costs(out: Path, jobs: Sequence[Job]) -> Table:
    """Seconds and memory of each job's run."""
    return Table(
        "What the jobs cost", ["job", "time [s]", "peak memory [MiB]", "cores", "processor"],
        [row for job in jobs for row in _cost(JobFolder(out, job))],
    )  # fmt: skip


def _cost(folder: JobFolder) -> Iterator[list[str]]:
    from diga3d_warp.errors import InputError
    from diga3d_warp.evaluation.record import read_manifest

    try:
        manifest = read_manifest(folder.run)
    except InputError:  # it failed before there was one
        return
    peak = max([manifest.get("peak_mib", 0), *(stage["peak_mib"] for stage in manifest["stages"])])
    machine = manifest["machine"]
    yield [
        folder.path.name, f"{manifest['seconds']:.0f}", f"{peak:.0f}", str(machine.get("cores", "–")),
        str(machine.get("processor", "–")).replace("|", "\\|"),
    ]  # fmt: skip
