"""One training by its name, in one process or several."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from diga3d_warp.priors.conditioning import ControlKind
from training.loop import Lesson, Training
from training.recipe import RECIPE, RunRecipe
from training.workers import Workers, run_workers

Network = Literal["autoencoder", "decoder", "denoiser", "edges", "depth"]
KINDS: tuple[ControlKind, ...] = ("edges", "depth")


@dataclass(frozen=True)
class Task:
    """A training to run; other processes are given a copy.

    Attributes:
        network: Which; "edges" and "depth" are ControlNets.
        work: Folder of data and checkpoints.
        steps: Number of the last step.
        threads: Of the processor, for each process.
    """

    network: Network
    work: Path
    steps: int
    threads: int

    def __call__(self, workers: Workers) -> None:
        """Train until the last step."""
        import torch

        torch.set_num_threads(self.threads)
        lesson, run = self._lesson()
        Training(lesson, run, RECIPE.seed, self.work, workers).run(self.steps, RECIPE.every, RECIPE.shown)

    def _lesson(self) -> tuple[Lesson, RunRecipe]:
        from training.autoencoder import AutoencoderLesson, DecoderLesson, Encoder
        from training.controls import open_controls
        from training.denoiser import open_denoiser
        from training.windows import open_windows

        if self.network == "denoiser":
            return open_denoiser(self.work, RECIPE), RECIPE.denoiser.run
        if self.network == "edges" or self.network == "depth":
            return open_controls(self.network, self.work, RECIPE), RECIPE.control.run
        windows = open_windows(self.work, RECIPE.data)
        if self.network == "decoder":
            encoder = Encoder.frozen(self.work, RECIPE)
            return DecoderLesson(RECIPE, windows, encoder), RECIPE.autoencoder.run
        return AutoencoderLesson(RECIPE, windows), RECIPE.autoencoder.run


def train_all(work: Path, folder: Path, threads: int, workers: int) -> None:
    """All stages as far as the schedule says, each from where it stopped; then export.

    Args:
        work: Folder of data and checkpoints.
        folder: Where to export.
        threads: Of the processor, for each process.
        workers: Processes that share each batch.
    """
    from training.export import export
    from training.latents import encode_samples
    from training.windows import render_rooms

    goal = RECIPE.schedule
    render_rooms(work, RECIPE.data, goal.held_out_rooms, "held_out")
    render_rooms(work, RECIPE.data, goal.rooms)
    run_workers(workers, Task("autoencoder", work, goal.autoencoder, threads))
    encode_samples(work, RECIPE, goal.samples)
    run_workers(workers, Task("denoiser", work, goal.denoiser, threads))
    for kind in KINDS:
        run_workers(workers, Task(kind, work, goal.controls, threads))
    for line in export(work, RECIPE, folder):
        print(line)
