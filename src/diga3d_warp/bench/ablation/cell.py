"""The trials on one capture: figures and pictures are kept in a folder, and not measured again."""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TypedDict

import numpy as np

from diga3d_warp.bench.ablation.measure import Figures, Outcome, Truth, measure
from diga3d_warp.bench.ablation.trials import Trial
from diga3d_warp.bench.captures import CaptureFolder, Captures
from diga3d_warp.bench.fill.truth import truth_of
from diga3d_warp.bench.room import true_picture
from diga3d_warp.files import write_image, write_json
from diga3d_warp.pipelines.run import say
from diga3d_warp.priors.protocol import Prior
from diga3d_warp.scene.scene import Scene
from diga3d_warp.state import read_picture, read_state

NEIGHBOURS = 3
"""Fitted views of a picture, side by side on the path of the cameras."""

MARGIN = 8
"""Around the masks of the pictures [px]."""

FLOOR = "floor.json"
"""Disagreement of the true images."""


class Floor(TypedDict):
    """disagreement: of the true images, since warping resamples their texture [levels of 255]."""

    disagreement: float


class Cell(CaptureFolder):
    """One capture.

    Args:
        captures: What is edited.
        situation, seed: Which of them.
        folder: Of all cells.
        priors: By name.
    """

    def __init__(
        self, captures: Captures, situation: str, seed: int, folder: Path, priors: Mapping[str, Prior | str]
    ) -> None:
        super().__init__(captures, situation, seed, folder)
        self.priors = priors

    def figures(self, trials: Iterable[Trial]) -> dict[Trial, Figures]:
        """Figures of the trials that can be measured; those that are missing are measured."""
        wanted = [trial for trial in dict.fromkeys(trials) if not isinstance(self.priors[trial.prior], str)]
        missing = [trial for trial in wanted if not self._path(trial, "json").exists()]
        if missing:
            scene = self.scene
            self._show_truth(scene)
            settings, runs = self.captures.settings, self.folder / "runs"
            measured = measure(scene, missing, self.seed, runs, self.priors, settings)
            for done, (trial, outcome) in enumerate(measured, start=1):
                self._show(scene, trial, outcome)
                write_json(self._path(trial, "json"), outcome.figures)
                say(f"{self.situation}, seed {self.seed}: {done} of {len(missing)} variants")
            shutil.rmtree(runs)
        return {trial: read_state(self._path(trial, "json"), Figures) for trial in wanted}

    @property
    def floor(self) -> float:
        """Disagreement of the true images [levels of 255]."""
        return read_state(self.folder / FLOOR, Floor)["disagreement"]

    def pictures(self, trial: Trial | None) -> list[np.ndarray]:
        """Filled views of neighbours and a held-out view of the splat; of the truth if None."""
        path = self.folder / "truth.png" if trial is None else self._path(trial, "png")
        return np.split(read_picture(path), NEIGHBOURS + 1, axis=1)

    def _path(self, trial: Trial, ending: str) -> Path:
        weights = getattr(self.priors[trial.prior], "weights", "")
        return self.folder / f"{trial.key}{weights and '-'}{weights}.{ending}"

    def _show_truth(self, scene: Scene) -> None:
        truth: Truth = truth_of(scene)
        held_out = scene.test_views[len(scene.test_views) // 2]
        shown = [truth.images[index] for index in _near(scene)] + [true_picture(scene, held_out).numpy()]
        self._write("truth.png", scene, shown)
        write_json(self.folder / FLOOR, Floor(disagreement=truth.disagreement(scene, truth.images)))

    def _show(self, scene: Scene, trial: Trial, outcome: Outcome) -> None:
        shown = [outcome.fills[scene.views[index].name] for index in _near(scene)]
        self._write(self._path(trial, "png").name, scene, [*shown, outcome.shown])

    def _write(self, name: str, scene: Scene, images: Sequence[np.ndarray]) -> None:
        window = _window(scene)
        write_image(self.folder / name, np.concatenate([image[window] for image in images], axis=1))


def _near(scene: Scene) -> range:
    """Fitted views in the middle of the cameras' path."""
    middle = len(scene.views) // 2
    return range(middle - 1, middle - 1 + NEIGHBOURS)


def _window(scene: Scene) -> tuple[slice, slice]:
    """Rows and columns around the masks of the views that are shown."""
    held_out = scene.test_views[len(scene.test_views) // 2]
    masks = [view.mask for view in (*(scene.views[index] for index in _near(scene)), held_out)]
    together = np.any([mask for mask in masks if mask is not None], axis=0)
    spans = []
    for axis in (1, 0):
        (where,) = np.nonzero(together.any(axis))
        spans.append(slice(max(0, where[0] - MARGIN), where[-1] + 1 + MARGIN))
    return spans[0], spans[1]
