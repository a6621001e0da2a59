"""The loop of every training: steps, checkpoints, mean of the weights, curve and pictures."""

from __future__ import annotations

import copy
import json
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from tqdm import tqdm

from diga3d_warp.errors import InputError
from training.checkpoint import load_checkpoint, restore, save_checkpoint
from training.recipe import RunRecipe
from training.workers import Workers


class Lesson(Protocol):
    """What one training teaches."""

    @property
    def name(self) -> str:
        """Of the checkpoint."""
        ...

    @property
    def module(self) -> torch.nn.Module:
        """All weights; those that need gradients are trained."""
        ...

    def refresh(self) -> int:
        """See data that was added; the number of records."""
        ...

    def losses(
        self, rng: np.random.Generator, noise: torch.Generator, records: int, batch: int
    ) -> Mapping[str, Any]:
        """Losses of a batch that the generators choose among the first records; "loss" is minimised."""
        ...

    def picture(self, averaged: Any) -> np.ndarray:
        """What the averaged weights can do, RGB, uint8."""
        ...


class Training:
    """A lesson with its state.

    What a step sees depends on its number and on the number of records at the last checkpoint only, so a
    training that was killed repeats the same steps.

    Args:
        lesson: What is taught.
        recipe: How.
        seed: Of the choice of samples and noise.
        folder: Of checkpoints, curves and pictures.
        workers: The processes that train it; this one alone if None.
    """

    def __init__(
        self, lesson: Lesson, recipe: RunRecipe, seed: int, folder: Path, workers: Workers | None = None
    ) -> None:
        self.workers = workers or Workers()
        self.lesson, self.recipe, self.seed, self.folder = lesson, recipe, seed, folder
        self.averaged = copy.deepcopy(lesson.module).requires_grad_(False)
        self.weights: list[torch.Tensor] = [
            weight for weight in lesson.module.parameters() if weight.requires_grad
        ]
        self.optimiser = torch.optim.AdamW(
            self.weights, lr=recipe.rate, betas=(0.9, 0.99), weight_decay=recipe.decay, fused=True
        )
        self.step, self.samples, self.seconds, self.records = 0, 0, 0.0, 0
        self.path = folder / f"{lesson.name}.ckpt"
        if self.path.exists():
            self._resume()
        else:
            self._see_new_data()

    def run(self, steps: int, every: float, shown: float, progress: bool = True) -> list[float]:
        """Train until the step of a number; the losses.

        Args:
            steps: Number of the last step.
            every: Time between two checkpoints [s].
            shown: Processor time between two pictures [s].
            progress: Show a progress bar.

        Raises:
            InputError: there is no data yet, or the loss is no longer finite.
        """
        if self.records == 0:
            raise InputError(f"there is nothing to train the {self.lesson.name} on: make its data first")
        quiet = not progress or self.workers.rank > 0
        bar = tqdm(initial=self.step, total=steps, desc=self.lesson.name, unit="step", disable=quiet)
        saved, pictured = time.monotonic(), time.process_time()
        losses: list[float] = []
        recent: list[Mapping[str, float]] = []
        while self.step < steps:
            start = time.monotonic()
            recent.append(self._step(steps))
            losses.append(recent[-1]["loss"])
            # Whoever stops the process for a while must not count as trained time.
            self.seconds += min(time.monotonic() - start, LONGEST_STEP)
            bar.update()
            if self.workers.agree(time.monotonic() - saved > every or self.step == steps):
                self._see_new_data()
                if self.workers.rank > 0:
                    continue
                means = {key: float(np.mean([row[key] for row in recent])) for key in recent[0]}
                bar.set_postfix({key: f"{value:.4f}" for key, value in means.items()})
                self.save(means)
                saved, recent = time.monotonic(), []
                if time.process_time() - pictured > shown:
                    self._show()
                    pictured = time.process_time()
        bar.close()
        return losses

    def save(self, means: Mapping[str, float]) -> None:
        """Write checkpoint and a line of the curve."""
        state = {
            "module": self.lesson.module.state_dict(),
            "averaged": self.averaged.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "step": self.step,
            "samples": self.samples,
            "seconds": self.seconds,
            "records": self.records,
        }
        save_checkpoint(self.path, state)
        line = {"step": self.step, "samples": self.samples, "seconds": self.seconds}
        with (self.folder / f"{self.lesson.name}.jsonl").open("a") as file:
            file.write(json.dumps({**line, "records": self.records, **means}) + "\n")

    def _see_new_data(self) -> None:
        """Choose among all records that the first process sees; the others look later and see them, too."""
        count = self.lesson.refresh() if self.workers.rank == 0 else 0
        self.records = int(self.workers.agree(count))
        self.lesson.refresh()

    def _show(self) -> None:
        path = self.folder / f"{self.lesson.name}-{self.step:06d}.png"
        _write_picture(path, self.lesson.picture(self.averaged))

    def _step(self, steps: int) -> dict[str, float]:
        for group in self.optimiser.param_groups:
            group["lr"] = self.recipe.rate_at(self.step, steps)
        rng = np.random.default_rng([self.seed, *self.lesson.name.encode(), self.step, self.workers.rank])
        noise = torch.Generator().manual_seed(int(rng.integers(2**62)))
        losses = self.lesson.losses(rng, noise, self.records, self.recipe.batch // self.workers.count)
        loss = losses["loss"]
        if not bool(torch.isfinite(loss)):
            raise InputError(
                f"the loss of the {self.lesson.name} is no longer finite after {self.step} steps: "
                "lower its rate in training/recipe.py and go on from the last checkpoint"
            )
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        self.workers.average([weight.grad for weight in self.weights if weight.grad is not None])
        torch.nn.utils.clip_grad_norm_(self.weights, self.recipe.most)
        self.optimiser.step()
        self.step += 1
        self.samples += self.recipe.batch
        self._average()
        return {key: float(value.detach()) for key, value in losses.items()}

    @torch.no_grad()
    def _average(self) -> None:
        keep = min(self.recipe.average, (1 + self.step) / (10 + self.step))
        pairs = zip(self.averaged.parameters(), self.lesson.module.parameters(), strict=True)
        mean: list[torch.Tensor] = [average for average, weight in pairs if weight.requires_grad]
        torch._foreach_lerp_(mean, self.weights, 1 - keep)

    def _resume(self) -> None:
        state = load_checkpoint(self.path)
        restore(self.lesson.module, state["module"], self.path)
        restore(self.averaged, state["averaged"], self.path)
        self.optimiser.load_state_dict(state["optimiser"])
        self.step, self.samples = state["step"], state["samples"]
        self.seconds, self.records = state["seconds"], state["records"]
        if self.lesson.refresh() < self.records:
            raise InputError(
                f"{self.path} was trained on {self.records} records, fewer are left: bring back the data"
            )


LONGEST_STEP = 20.0
"""More of a step is not counted as training [s]: the process was stopped meanwhile."""


def _write_picture(path: Path, picture: np.ndarray) -> None:
    import cv2

    cv2.imwrite(str(path), np.ascontiguousarray(picture[..., ::-1]))
