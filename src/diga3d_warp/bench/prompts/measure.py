"""Edit one capture by its prompts with each method; figures and pictures are kept in a folder."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import TypedDict

import numpy as np
import torch

from diga3d_warp.bench.captures import CaptureFolder, Captures
from diga3d_warp.bench.prompts.edits import BUILT_IN, TRUTHS, UNEDITED, Prompts, Task, knows, settings_of
from diga3d_warp.bench.room import share_stages
from diga3d_warp.evaluation.metrics import compare, mean_scores, psnr
from diga3d_warp.evaluation.record import MANIFEST
from diga3d_warp.files import write_image, write_json
from diga3d_warp.pipelines.clearing import widened
from diga3d_warp.pipelines.method import Method
from diga3d_warp.pipelines.replace import ReplaceSettings, replace_object
from diga3d_warp.pipelines.request import EditResult
from diga3d_warp.pipelines.retexture import RetextureSettings, retexture_object
from diga3d_warp.pipelines.run import Run, say
from diga3d_warp.priors.protocol import DiffusionPrior
from diga3d_warp.scene.photographs.images import read_image
from diga3d_warp.scene.scene import Scene, View
from diga3d_warp.splatting.render import render
from diga3d_warp.state import read_state


class Figures(TypedDict):
    """One edit of one capture, of the held-out views within the widened masks.

    psnr, ssim: against the truth of the prompt [dB, 1].
    before: PSNR against the photographs, which show what was there [dB]; None where nothing was edited.
    nearer: share of the views that are nearer to the truth of the prompt than to the photograph [1].
    """

    psnr: float
    ssim: float
    before: float | None
    nearer: float


class Cell(CaptureFolder):
    """One capture.

    Args:
        captures: What is edited.
        situation, seed: Which of them.
        folder: Of all cells.
        prior: The network.
    """

    def __init__(
        self, captures: Captures, situation: str, seed: int, folder: Path, prior: DiffusionPrior
    ) -> None:
        super().__init__(captures, situation, seed, folder)
        self.prior = prior

    @property
    def prompts(self) -> Prompts:
        """What the capture is edited by."""
        return Prompts.of(self.folder / "capture")

    def figures(self, task: Task, methods: Mapping[str, Method]) -> dict[str, Figures]:
        """Figures of a task by method, of what its prompt allows; those that are missing are measured."""
        scene, found = self.scene, {}
        for name, method in {UNEDITED: None, **methods}.items():
            if name == BUILT_IN and not knows(task, getattr(self.prompts, task)):
                continue
            path = self.path(task, name, "json")
            if not path.exists():
                self._measure(scene, task, name, method)
            found[name] = read_state(path, Figures)
        return found

    def clean(self) -> None:
        """Delete the runs, which take much room."""
        shutil.rmtree(self.folder / "runs", ignore_errors=True)

    def path(self, task: Task, name: str, ending: str) -> Path:
        """File of one edit; a network's tells its weights."""
        weights = getattr(self.prior, "weights", "") if self.prior.name in name else ""
        words = name.replace(" ", "-").replace(",", "").replace("/", "_")
        return self.folder / f"{task}-{words}{weights and '-'}{weights}.{ending}"

    def _measure(self, scene: Scene, task: Task, name: str, method: Method | None) -> None:
        def truth(view: View) -> torch.Tensor:
            file = scene.path / "ground_truth" / TRUTHS[task] / f"{view.name}.png"
            return torch.from_numpy(read_image(file)).float() / 255.0

        if method is None:
            shown = [view.image for view in scene.test_views]
        else:
            say(f"{self.situation}, seed {self.seed}: {task}, {name}")
            result = self._edited(scene, task, name, method)
            shown = [_rendered(result, view) for view in scene.test_views]
        masking = self.captures.settings.masking
        masks = [widened(view.mask, masking) for view in scene.test_views if view.mask is not None]
        scores, before = [], []
        for view, image, mask in zip(scene.test_views, shown, masks, strict=True):
            scores.append(compare(image, truth(view), mask))
            before.append(psnr(image, view.image, torch.from_numpy(mask)))
        score = mean_scores(scores)["masked"]
        nearer = [found["masked"].psnr > other for found, other in zip(scores, before, strict=True)]
        middle = len(shown) // 2
        write_image(self.path(task, name, "png"), shown[middle].numpy())
        write_image(self.folder / f"{task}-truth.png", truth(scene.test_views[middle]).numpy())
        figures = Figures(
            psnr=score.psnr,
            ssim=score.ssim,
            before=None if method is None else float(np.mean(before)),
            nearer=float(np.mean(nearer)),
        )
        write_json(self.path(task, name, "json"), figures)

    def _edited(self, scene: Scene, task: Task, name: str, method: Method) -> EditResult:
        folder = self.folder / "runs" / self.path(task, name, "run").name
        run = Run(folder, task, {"scene": scene.path}, resume=(folder / MANIFEST).exists())
        share_stages(self.folder / "captured", folder)
        settings = settings_of(task, method, self.captures.settings)
        prompt, words = getattr(self.prompts, task), name != BUILT_IN
        if isinstance(settings, RetextureSettings):
            prior = self.prior if words else None
            result = retexture_object(scene, prompt, run, settings, prior=prior, seed=self.seed)
        else:
            assert isinstance(settings, ReplaceSettings)
            result = replace_object(
                scene, prompt, run, settings, prior=self.prior if words else None, free_text=words,
                seed=self.seed,
            )  # fmt: skip
        share_stages(folder, self.folder / "captured")
        return result


def _rendered(result: EditResult, view: View) -> torch.Tensor:
    with torch.no_grad():
        return render(result.gaussians, view.camera, effects=result.run.effects).color.clamp(0.0, 1.0)
