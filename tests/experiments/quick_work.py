"""Work of no time in place of an edit: steps on files, which tests let die at chosen moments."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

from diga3d_warp.errors import InputError
from diga3d_warp.experiments.job import Job, JobFolder, Outcome

STEPS = 3


def quick_job(scene: str, **options) -> Job:
    return Job("remove", f"/scenes/{scene}", options)


def quick_work(folder: JobFolder, threads: int) -> Outcome:
    """Write a file for each step, unless an earlier process did; the options of the job say where it dies.

    Options: `fails` raises an error; `breaks` raises one of no known kind; `dies` is a step after which the
    first process is killed, `always` every process; `waits` is a file whose absence is waited for.
    """
    options = folder.job.options
    if "fails" in options:
        raise InputError(f"{folder.job.scene}: {options['fails']}")
    if "breaks" in options:
        raise ZeroDivisionError("a | b\nand more")
    folder.run.mkdir(exist_ok=True)
    for step in range(STEPS):
        path = folder.run / f"step_{step}"
        if path.exists():
            continue
        path.write_text(f"{folder.job.scene} {step}")
        while "waits" in options and not Path(options["waits"]).exists():
            time.sleep(0.01)
        if step == options.get("dies") or options.get("always"):
            os.kill(os.getpid(), signal.SIGKILL)
    value = float(len(folder.job.scene) + options.get("more", 0))
    return Outcome(
        error=None, figures={"PSNR": {"whole": value, "masked": None}}, missing={}, protocol="spin-nerf",
        views=2, size=[9, 8], version="1",
    )  # fmt: skip


def files_of(out: Path) -> dict[str, bytes]:
    """What jobs have made, by its path: all but who worked on it, and what it said."""
    return {
        path.relative_to(out).as_posix(): path.read_bytes()
        for path in sorted(out.rglob("*"))
        if path.is_file() and path.name not in (".lock", "worker.json", "log.txt")
    }
