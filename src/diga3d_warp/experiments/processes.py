"""Worker processes on this machine: a new one for each job, so that each gives its memory back."""

from __future__ import annotations

import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait
from multiprocessing.context import SpawnProcess

from tqdm import tqdm

from diga3d_warp.experiments.job import LOG, JobFolder
from diga3d_warp.experiments.run import ATTEMPTS, TICK, Ended
from diga3d_warp.experiments.work import Work, attempt
from diga3d_warp.process import tune_process


@dataclass
class _Running:
    """A process, its job, and the slot that it takes."""

    process: SpawnProcess
    folder: JobFolder
    attempts: int
    slot: int


@dataclass(frozen=True)
class LocalCrew:
    """Processes on this machine.

    Attributes:
        workers: Jobs at a time.
        threads: Threads of each.
        gpus: GPUs that they share; each job sees one of them. 0 leaves to each what it finds.
    """

    workers: int = 1
    threads: int = 1
    gpus: int = 0

    def __call__(self, folders: Sequence[JobFolder], work: Work, tick: Callable[[], None]) -> Iterator[Ended]:
        """Work on jobs; see `run.Crew`."""
        waiting = deque((folder, 1) for folder in folders)
        running: list[_Running] = []
        try:
            while waiting or running:
                while waiting and len(running) < self.workers:
                    folder, count = waiting.popleft()
                    slot = min(set(range(self.workers)) - {each.slot for each in running})
                    running.append(_Running(self._start(folder, work, slot), folder, count, slot))
                tick()
                wait([each.process.sentinel for each in running], timeout=TICK)
                for each in [each for each in running if not each.process.is_alive()]:
                    running.remove(each)
                    each.process.join()
                    if each.folder.outcome is None and each.attempts < ATTEMPTS:
                        waiting.appendleft((each.folder, each.attempts + 1))
                    else:
                        yield Ended(each.folder, _cause(each.process.exitcode))
        finally:
            for each in running:
                each.process.kill()  # a run folder is whole at any moment
            for each in running:
                each.process.join()

    def _start(self, folder: JobFolder, work: Work, slot: int) -> SpawnProcess:
        gpu = slot % self.gpus if self.gpus else None
        process = get_context("spawn").Process(
            target=_worker, args=(str(folder.path), work, self.threads, gpu), name=folder.path.name
        )
        process.start()
        return process


def _worker(path: str, work: Work, threads: int, gpu: int | None) -> None:
    """Main function of a worker."""
    signal.signal(
        signal.SIGINT, signal.SIG_IGN
    )  # the driver, which a terminal interrupts, too, ends this one
    threading.Thread(target=_end_with_driver, daemon=True).start()
    tune_process()
    tqdm.set_lock(threading.RLock())  # its own is of all processes: when this one is killed, Python complains
    os.environ["OMP_NUM_THREADS"] = str(threads)
    if gpu is not None:
        os.environ["CUDA_VISIBLE_DEVICES"] = str(gpu)
    attempt(path, work, threads)


def _end_with_driver() -> None:
    """End this process when the driver has died: else the resumed one would find its jobs locked."""
    driver = parent_process()
    assert driver is not None
    driver.join()
    os._exit(1)


def _cause(code: int | None) -> str:
    """What ended the last process of a job, of its exit code."""
    ending = f"exit code {code}"
    if code is not None and code < 0:
        with suppress(ValueError):
            ending = signal.Signals(-code).name
    if ending == "SIGKILL":
        ending += ", as when memory runs out"
    return f"its process ended {ATTEMPTS} times ({ending}): see its {LOG}, or run fewer jobs at a time"
