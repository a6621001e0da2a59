"""The command that compares runs by people's votes: study."""

from __future__ import annotations

from pathlib import Path

from diga3d_warp.cli.parsing import Commands, path
from diga3d_warp.errors import InputError


def add_study(commands: Commands) -> None:
    """study."""
    study = commands.add(
        "study",
        _study,
        "let people vote between runs, and tally votes",
        "diga3d study run/ours run/warp run/lama --out study.html\n"
        "  diga3d study --names ours lama --question run/ours/bear run/lama/bear "
        "--question run/ours/can run/lama/can\n"
        "  diga3d study --tally votes/*.json",
        "Write a page that opens offline and asks which of two to four runs of one edit is best, with names "
        "hidden and places shuffled; or tally the files that participants send back. A folder of pictures "
        "named as the run's views stands for the result of another method.",
    )
    study.add_argument(
        "runs", type=path, nargs="*", metavar="RUN", help="folders of finished runs of one edit"
    )
    study.add_argument(
        "--question",
        type=path,
        nargs="+",
        action="append",
        default=[],
        metavar="RUN",
        help="the runs of a further question, the methods in the same order (repeatable)",
    )
    study.add_argument(
        "--names",
        nargs="+",
        default=[],
        metavar="NAME",
        help="names of the methods in the tally (default those of the folders)",
    )
    study.add_argument(
        "--video", action="store_true", help="show a rendered flight through each splat in place of its views"
    )
    study.add_argument("--out", type=path, metavar="FILE", help="the page to write (default study.html)")
    study.add_argument(
        "--tally",
        type=path,
        nargs="+",
        metavar="FILE",
        help="count these files of votes, or those in a folder",
    )


def _study(
    runs: list[Path],
    question: list[list[Path]],
    names: list[str],
    video: bool,
    out: Path | None,
    tally: list[Path] | None,
) -> int:
    if tally is not None:
        if runs or question or names or video or out:
            raise InputError("--tally takes files of votes alone: leave the runs and other options out")
        return _tally(tally)
    questions = [runs, *question] if runs else question
    if not questions:
        raise InputError("no run is given: name two to four runs, or files of votes after --tally")
    from diga3d_warp.pipelines.run import say
    from diga3d_warp.study.write import write_study

    study = write_study(questions, out or Path("study.html"), names=names, video=video)
    for note in study.notes:
        say(f"note: {note}")
    if study.folder is not None:
        say(f"note: too large for one mail, so the pictures are in {study.folder}: send it with the page")
    print(study.page)
    return 0


def _tally(files: list[Path]) -> int:
    from diga3d_warp.pipelines.run import say
    from diga3d_warp.study.tally import tally

    result = tally(files)
    for note in result.notes:
        say(f"note: {note}")
    for table in result.tables():
        print(table.text())
    return 0
