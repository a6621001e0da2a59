"""The state of all jobs in one view: a bar on a terminal, else a line for each job that starts or ends."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from itertools import islice
from types import TracebackType

from tqdm import tqdm

from diga3d_warp.experiments.job import JobFolder

SHOWN = 4
"""Most running jobs that the bar names."""

LOOKED_AT = 200
"""Jobs whose folders are looked at each time. They start in order, so the running ones are among the first
that are left; thousands of folders on a network's file system would take longer than a second."""


class View:
    """Shows the state of jobs on stderr.

    Args:
        folders: Of the jobs that are to be done.
        total: Number of all jobs.
    """

    def __init__(self, folders: Sequence[JobFolder], total: int) -> None:
        self._left = {folder.path.name: folder for folder in folders}
        self._total = total
        self._started: dict[str, int] = {}
        self._failed = 0
        self._bar: tqdm | None = None

    def __enter__(self) -> View:
        earlier = self._total - len(self._left)
        _say(f"{self._total} jobs" + (f", {earlier} of them done earlier" if earlier else ""))
        if sys.stderr.isatty():
            self._bar = tqdm(total=self._total, initial=earlier, unit="job", dynamic_ncols=True, desc="jobs")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.close()

    def show(self) -> None:
        """Look at the folders, and show which jobs have started and what they are at."""
        running = []
        for name, folder in islice(self._left.items(), LOOKED_AT):
            worker = folder.worker
            if worker is None:
                continue
            running.append(f"{name}: {folder.stage or 'reading'}")
            again = " again" if name in self._started else ""
            if self._started.get(name) != worker["process"]:
                self._started[name] = worker["process"]
                if again or self._bar is None:
                    self._line(f"{name}: started{again}, process {worker['process']} on {worker['host']}")
        if self._bar is not None:
            more = f" and {len(running) - SHOWN} more" if len(running) > SHOWN else ""
            failed = f"{self._failed} failed; " if self._failed else ""
            self._bar.set_postfix_str(f"{failed}{', '.join(running[:SHOWN])}{more}")

    def ended(self, folder: JobFolder, error: str | None) -> None:
        """Show that a job has ended, and with which error if with one."""
        name = folder.path.name
        self._left.pop(name, None)
        self._failed += error is not None
        if self._bar is not None:
            self._bar.update(1)
        if error is not None or self._bar is None:
            self._line(f"{name}: {error or 'done'} ({self._total - len(self._left)} of {self._total})")

    def _line(self, text: str) -> None:
        """Write a line, above the bar if there is one."""
        if self._bar is not None:
            self._bar.clear()
        _say(text)
        if self._bar is not None:
            self._bar.refresh()


def _say(line: str) -> None:
    print(f"diga3d: {line}", file=sys.stderr, flush=True)
