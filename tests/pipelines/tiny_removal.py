"""A removal that takes seconds, for the tests and for the processes that they kill."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from diga3d_warp.gaussians.fit import FitSettings
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.gaussians.working import to_user
from diga3d_warp.pipelines.method import PAPER
from diga3d_warp.pipelines.remove import DISTIL, REFIT, RemoveSettings
from diga3d_warp.pipelines.request import EditResult
from diga3d_warp.pipelines.run import Run
from diga3d_warp.priors.settings import SamplingSettings
from diga3d_warp.scene.scene import Scene

SETTINGS = RemoveSettings(
    fit=FitSettings(iterations=150, budget=4000),
    refit=replace(REFIT, iterations=60),
    distil=replace(DISTIL, iterations=10),
    method=replace(PAPER, sampling=SamplingSettings(steps=3)),
)


FILLED = [
    "effects", "fit", "lift", "mirror", "shadow", "clear", "look-behind", "charts", "references", "fill",
]  # fmt: skip
"""Stages of a removal until its views are filled."""


def stage_splat(run: Run, stage: str) -> Gaussians:
    """What a stage made, in the user's world."""
    working = Gaussians.load_ply(run.folder / "stages" / stage / "point_cloud.ply", every_row=True)
    return to_user(working, run.frame)


@dataclass(frozen=True)
class Removed:
    """A finished removal.

    Attributes:
        scene: What it was given.
        result: What it returned.
        folder: What it left; not to be changed.
    """

    scene: Scene
    result: EditResult
    folder: Path

    @property
    def working(self) -> Scene:
        """The scene in the working units of the stages."""
        return self.result.run.frame.working_scene(self.scene)

    def picture(self, name: str) -> np.ndarray:
        """An image of the run folder or, for names that begin so, of the capture's ground truth."""
        root = self.scene.path if name.startswith("ground_truth") else self.folder
        pixels = cv2.imread(str(root / name), cv2.IMREAD_COLOR_RGB)
        assert pixels is not None and pixels.shape == (72, 96, 3)
        return pixels.astype(np.float64) / 255.0

    def mask(self, name: str) -> np.ndarray:
        """The widened mask of a view."""
        return cv2.imread(str(self.folder / "masks" / f"{name}.png"), cv2.IMREAD_GRAYSCALE) > 127
