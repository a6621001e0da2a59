"""Work on a job, in the process of a worker: run it, measure it, and write what came of it."""

from __future__ import annotations

import os
import platform
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Any

from diga3d_warp.errors import InputError, explained, out_of_memory
from diga3d_warp.experiments.job import LOG, Job, JobFolder, Outcome, failed
from diga3d_warp.files import write_json

if TYPE_CHECKING:
    from filelock import FileLock

    from diga3d_warp.scene.scene import Scene

Work = Callable[[JobFolder, int], Outcome]
"""Runs a job and measures it on a number of threads; goes on where an earlier process was killed."""

PATIENCE = 60.0
"""Seconds to wait for the lock of a job's folder: a worker whose driver was killed takes a moment to end."""


def attempt(path: str, work: Work, threads: int) -> None:
    """Work on a job until it is done; an error becomes its outcome.

    Args:
        path: The job's folder.
        work: What to do, `carry_out` but for tests.
        threads: Threads to compute with.
    """
    from diga3d_warp.pipelines.machine import package_versions

    folder = JobFolder.open(Path(path))
    lock = _hold(folder.path)
    try:
        if folder.outcome is not None:
            return
        write_json(folder.path / "worker.json", {"process": os.getpid(), "host": platform.node()})
        with _logged(folder.path / LOG):
            try:
                outcome = work(folder, threads)
            except Exception as error:
                traceback.print_exc()
                outcome = failed(line_about(error), package_versions()["diga3d_warp"])
        folder.end(outcome)
    finally:
        if lock is not None:
            lock.release()


def carry_out(folder: JobFolder, threads: int) -> Outcome:
    """Run the job's command, resuming what an earlier process left, and measure the result.

    Raises:
        InputError: the scene or an option is not usable.
    """
    from diga3d_warp.pipelines.machine import package_versions
    from diga3d_warp.scene.load import load_scene

    use_threads(threads)
    job = folder.job
    reading = {"image_scale", "masks", "mask_ids", "hold_out"}
    options = {name: value for name, value in job.options.items() if name not in reading}
    read = {name: value for name, value in job.options.items() if name in reading}
    scene = load_scene(job.scene, **{**read, **_scale(job)})
    pipeline(job.command)(scene, out=folder.run, resume=True, **options)
    figures, missing, protocol = _measured(folder, scene)
    first = scene.views[0].camera
    return Outcome(
        error=None, figures=figures, missing=missing, protocol=protocol, views=len(scene.test_views),
        size=[first.width, first.height], version=package_versions()["diga3d_warp"],
    )  # fmt: skip


def pipeline(command: str) -> Callable[..., Any]:
    """The function of a subcommand."""
    from importlib import import_module

    function: Callable[..., Any] = getattr(import_module(f"diga3d_warp.pipelines.{command}"), command)
    return function


def use_threads(count: int) -> None:
    """Compute with so many threads."""
    import torch

    from diga3d_warp.kernels.launch import set_thread_count

    set_thread_count(count)
    torch.set_num_threads(count)


def line_about(error: Exception) -> str:
    """An error in one line, for the tables."""
    if isinstance(error, InputError):
        return str(error)
    if lacking := out_of_memory(error):
        return f"{lacking}: run fewer jobs at a time, or use smaller images"
    if isinstance(error, OSError) and error.filename is not None:
        return str(explained(error, lambda path: False, Path()))
    return f"{type(error).__name__}: {error} (a fault of this program; {LOG} in the job's folder tells more)"


def _scale(job: Job) -> Mapping[str, float]:
    """The image scale of a job whose size is not given as one."""
    from diga3d_warp.scene.published import image_size, published_scale

    if job.size is None:
        return {}
    if job.size == "published":
        return {"image_scale": published_scale(job.scene)}
    return {"image_scale": min(job.size / min(image_size(job.scene)), 1.0)}


def _measured(
    folder: JobFolder, scene: Scene
) -> tuple[dict[str, dict[str, float | None]], dict[str, str], str | None]:
    """Figures by metric and region, what was not measured and why, and the protocol."""
    from diga3d_warp.checkpoints import best_device
    from diga3d_warp.evaluation.perceptual import Perceptual, edit_text
    from diga3d_warp.evaluation.protocols import evaluate
    from diga3d_warp.evaluation.record import read_manifest, read_metrics
    from diga3d_warp.evaluation.report import write_report
    from diga3d_warp.experiments.figures import figures_of

    if not scene.test_views:
        return {}, {"every metric": "the scene has no test views"}, None
    job = folder.job
    text = edit_text(read_manifest(folder.run), job.source_prompt, job.edit_prompt)
    weights = None if job.weights is None else Path(job.weights)
    perceptual = Perceptual.load(weights, best_device("auto"), text)
    protocol = "spin-nerf" if scene.ground_truth else "held-out"
    evaluate(folder.run, protocol, scene=scene, perceptual=perceptual)
    write_report(folder.run)
    evaluation = read_metrics(folder.run)["evaluation"]
    return figures_of(evaluation), evaluation["perceptual"]["missing"], protocol


def _hold(path: Path) -> FileLock | None:
    """Lock a job's folder; None if the file system has no locks.

    Raises:
        InputError: another process keeps it for longer than `PATIENCE`.
    """
    from diga3d_warp.pipelines.run_folder import hold

    until = time.monotonic() + PATIENCE
    while True:
        try:
            return hold(path)
        except InputError:
            if time.monotonic() > until:
                raise
            time.sleep(0.2)
        except (OSError, NotImplementedError):
            return None


@contextmanager
def _logged(path: Path) -> Iterator[None]:
    """Append what is printed to a file, by libraries in compiled code, too."""
    with path.open("a", encoding="utf-8", errors="backslashreplace") as log:
        kept = {number: os.dup(number) for number in (1, 2)}
        try:
            for number in kept:
                os.dup2(log.fileno(), number)
            with redirect_stdout(log), redirect_stderr(log):
                yield
        finally:
            for number, copy in kept.items():
                os.dup2(copy, number)
                os.close(copy)
