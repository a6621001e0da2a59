"""Run jobs: those that are done already are skipped, the others go to worker processes or to Ray.

A killed worker is replaced and its job goes on where it was. If the driver is killed, the same command goes
on with what is missing. Jobs that ended with an error are tried again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from diga3d_warp.errors import InputError
from diga3d_warp.experiments.job import JOBS, Job, JobFolder, Outcome, failed
from diga3d_warp.experiments.progress import View
from diga3d_warp.experiments.work import Work, carry_out

if TYPE_CHECKING:
    from filelock import FileLock

ATTEMPTS = 3
"""Processes that may die over a job, as when memory runs out, before it counts as failed."""

TICK = 1.0
"""Seconds between looks at the progress."""

RESULTS = {".md", ".csv", ".tex", ".html"}
"""Endings of what is written beside the jobs."""


@dataclass(frozen=True)
class Ended:
    """A job that no process works on any more.

    Attributes:
        folder: Its folder.
        reason: Why it has no outcome, if it has none.
    """

    folder: JobFolder
    reason: str = ""


Crew = Callable[[Sequence[JobFolder], Work, Callable[[], None]], Iterator[Ended]]
"""Works on jobs in processes. Takes their folders, the work, and what to call about once a second; yields
each job that has ended, in any order."""


def run_jobs(
    jobs: Sequence[Job],
    out: Path,
    crew: Crew,
    work: Work = carry_out,
    outdated: Callable[[Job, Outcome], bool] = lambda job, outcome: False,
) -> dict[str, Outcome]:
    """Run jobs until each has an outcome.

    Args:
        jobs: The jobs; equal ones are run once.
        out: Folder of all jobs; what it holds of them is used.
        crew: Where they run.
        work: What a worker does.
        outdated: Whether a finished job is to be measured again; its run stays.

    Returns:
        The outcome of each job by its name.

    Raises:
        InputError: the folder cannot be used, is in use by another process, or holds a damaged outcome.
    """
    from diga3d_warp.pipelines.machine import package_versions

    folders = [JobFolder(out, job) for job in {job.name: job for job in jobs}.values()]
    lock = hold_out(out)
    try:
        waiting = []
        for folder in folders:
            before = folder.outcome
            if before is None or before["error"] is not None or outdated(folder.job, before):
                folder.describe()
                folder.reopen()
                waiting.append(folder)
        version = package_versions()["diga3d_warp"]
        with View(waiting, len(folders)) as view:
            for ended in crew(waiting, work, view.show):
                outcome = ended.folder.outcome
                if outcome is None:
                    outcome = failed(ended.reason, version)
                    ended.folder.end(outcome)
                view.ended(ended.folder, outcome["error"])
        outcomes = {folder.path.name: _outcome(folder) for folder in folders}
    finally:
        if lock is not None:
            lock.release()
    _note_versions(outcomes, version)
    return outcomes


def hold_out(out: Path) -> FileLock | None:
    """Lock the folder of an experiment; None if its file system has no locks.

    Raises:
        InputError: it cannot be written, is in use by another process, or holds other things.
    """
    from diga3d_warp.pipelines.run_folder import LOCK, hold, make_writable

    make_writable(out)
    names = sorted(entry.name for entry in out.iterdir() if not entry.name.startswith("."))
    foreign = [name for name in names if name != JOBS and Path(name).suffix not in RESULTS]
    if foreign or (names and JOBS not in names):
        raise InputError(
            f"{out} holds no experiment, but other things ({(foreign or names)[0]}): choose a new or empty "
            "folder for --out"
        )
    try:
        return hold(out)
    except (OSError, NotImplementedError):
        from diga3d_warp.pipelines.run import say

        say(f"note: {out / LOCK} cannot be locked: let no second process use {out}")
        return None


def _outcome(folder: JobFolder) -> Outcome:
    outcome = folder.outcome
    assert outcome is not None, "each job was given one"
    return outcome


def _note_versions(outcomes: Mapping[str, Outcome], version: str) -> None:
    other = sum(outcome["version"] != version for outcome in outcomes.values())
    if other:
        from diga3d_warp.pipelines.run import say

        say(
            f"note: {other} of {len(outcomes)} jobs were done by another version of this program: delete "
            "their folders to do them again"
        )
