"""One capture, filled by each method: its figures and pictures are kept in a folder of its own."""

from __future__ import annotations

import shutil
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from diga3d_warp.bench.ablation.measure import Truth, final_fills, outcome_of
from diga3d_warp.bench.captures import CaptureFolder, Captures
from diga3d_warp.bench.fill.figures import Figures
from diga3d_warp.bench.fill.methods import PerView, Removal
from diga3d_warp.bench.fill.truth import psnr_elsewhere, truth_of
from diga3d_warp.bench.room import share_stages, true_picture
from diga3d_warp.evaluation.metrics import compare, mean_scores
from diga3d_warp.evaluation.record import MANIFEST
from diga3d_warp.files import to_bytes, write_image, write_json
from diga3d_warp.pipelines.clearing import widened
from diga3d_warp.pipelines.remove import remove_object
from diga3d_warp.pipelines.run import Run, say
from diga3d_warp.priors.protocol import Prior
from diga3d_warp.propagation.references import select_references, usable_views
from diga3d_warp.scene.scene import Scene, View
from diga3d_warp.splatting.render import render
from diga3d_warp.state import read_state

SHOWN = 0.6
"""Share of an image's width and height that a picture shows."""


def picture_path(folder: Path, place: tuple[str, int], name: str) -> Path:
    """A picture of a capture.

    Args:
        folder: Of all captures.
        place: Situation and seed.
        name: "photograph", "truth", or a method's name with "filled" or "rendered".
    """
    situation, seed = place
    return folder / f"{situation}-{seed}" / f"{name.replace(' ', '-')}.png"


class Cell(CaptureFolder):
    """One capture, filled by each method.

    Args:
        captures: What is filled.
        situation, seed: Which of them.
        folder: Of all cells.
        priors: By name.
    """

    def __init__(
        self, captures: Captures, situation: str, seed: int, folder: Path, priors: Mapping[str, Prior | str]
    ) -> None:
        super().__init__(captures, situation, seed, folder)
        self.priors = priors

    def figures(self, methods: Mapping[str, PerView | Removal]) -> dict[str, Figures]:
        """Figures by method; those that are missing are measured."""
        missing = [name for name in methods if not self._path(name, "json").exists()]
        if missing:
            self._measure({name: methods[name] for name in missing})
        return {name: read_state(self._path(name, "json"), Figures) for name in methods}

    def _path(self, method: str, ending: str) -> Path:
        return self.folder / f"{method.replace(' ', '-')}.{ending}"

    def _measure(self, methods: Mapping[str, PerView | Removal]) -> None:
        scene = self.scene
        truth = truth_of(scene)
        shown = int(np.argmax([unseen.sum() for unseen in truth.unseen]))
        window = _window(scene.views[shown])
        write_image(self._path("photograph", "png"), scene.views[shown].image.numpy()[window])
        write_image(self._path("truth", "png"), truth.images[shown][window])
        for name, method in methods.items():
            say(f"{self.situation}, seed {self.seed}: {name}")
            if isinstance(method, Removal):
                figures, filled, rendered = self._removal(scene, truth, name, method, shown)
            else:
                figures, filled = self._each_view(scene, truth, method, shown)
                rendered = filled
            write_image(self._path(f"{name} filled", "png"), filled[window])
            write_image(self._path(f"{name} rendered", "png"), rendered[window])
            write_json(self._path(name, "json"), figures)
        shutil.rmtree(self.folder / "runs", ignore_errors=True)

    def _removal(
        self, scene: Scene, truth: Truth, name: str, method: Removal, shown: int
    ) -> tuple[Figures, np.ndarray, np.ndarray]:
        prior = self.priors[method.prior]
        assert not isinstance(prior, str), "methods without a prior are left out"
        settings = replace(self.captures.settings, method=method.method)
        folder = self.folder / "runs" / name.replace(" ", "-")
        run = Run(folder, "remove", {"scene": scene.path}, resume=(folder / MANIFEST).exists())
        captured = self.folder / "captured"  # the fit of the capture serves all methods
        share_stages(captured, folder)
        own = self._given(scene, truth, method)
        result = remove_object(scene, run, settings, prior=prior, seed=self.seed, own=own)
        share_stages(folder, captured)
        outcome = outcome_of(scene, result, settings, truth)
        found = outcome.figures
        view = scene.views[shown]
        left = [
            (fill.missing & unseen).sum()
            for fill, unseen in zip(final_fills(result, scene), truth.unseen, strict=True)
        ]
        figures = Figures(
            psnr=found["psnr_masked"],
            ssim=found["ssim_masked"],
            unseen=_finite(found["coarse_psnr"]),
            contrast=_finite(found["coarse_contrast"]),
            left=float(np.sum(left) / max(1, np.sum(truth.unseen))),
            disagreement=_finite(found["coarse"]),
            depth_error=_finite(found["depth_error"]),
            elsewhere=psnr_elsewhere(scene, result.gaussians, result.run),
            seconds=found["seconds"],
        )
        with torch.no_grad():
            rendered = render(result.gaussians, view.camera, effects=result.run.effects).color
        return figures, outcome.fills[view.name], rendered.clamp(0.0, 1.0).numpy()

    def _given(self, scene: Scene, truth: Truth, removal: Removal) -> dict[str, np.ndarray]:
        """True images of the references that the method would choose, of all views, or none."""
        if removal.given == "none":
            return {}
        indices: Sequence[int] = range(len(scene.views))
        if removal.given == "references":
            method, usable = removal.method, usable_views(truth.unseen)
            centers = np.stack([view.camera.center for view in scene.views])
            chosen = select_references(centers, method.references, self.seed, method.selection, usable)
            indices = chosen.indices
        return {scene.views[i].name: to_bytes(truth.images[i]) for i in indices}

    def _each_view(
        self, scene: Scene, truth: Truth, method: PerView, shown: int
    ) -> tuple[Figures, np.ndarray]:
        def filled(view: View) -> torch.Tensor:
            return method(view.image, torch.from_numpy(self._widened(view)))

        began = time.perf_counter()
        images = [filled(view).numpy() for view in scene.views]
        seconds = time.perf_counter() - began
        scores = [
            compare(filled(view), true_picture(scene, view), self._widened(view)) for view in scene.test_views
        ]
        score = mean_scores(scores)["masked"]
        figures = Figures(
            psnr=score.psnr,
            ssim=score.ssim,
            unseen=_finite(truth.psnr(images, truth.unseen)),
            contrast=_finite(truth.contrast(images, truth.unseen)),
            left=0.0,
            disagreement=_finite(truth.disagreement(scene, images)),
            depth_error=None,
            elsewhere=None,
            seconds=seconds,
        )
        return figures, images[shown]

    def _widened(self, view: View) -> np.ndarray:
        assert view.mask is not None, "the generator writes a mask for each view"
        return widened(view.mask, self.captures.settings.masking)


def _window(view: View) -> tuple[slice, slice]:
    """Rows and columns about the object: `SHOWN` of each side, of one size for all captures."""
    assert view.mask is not None, "the generator writes a mask for each view"
    spans = []
    for axis in (1, 0):
        (where,) = np.nonzero(view.mask.any(axis))
        side = view.mask.shape[1 - axis]
        length = round(SHOWN * side)
        start = int(np.clip((where[0] + where[-1] + 1 - length) // 2, 0, side - length))
        spans.append(slice(start, start + length))
    return spans[0], spans[1]


def _finite(value: float) -> float | None:
    """The figure, or None where there was no pixel to take it of."""
    return value if np.isfinite(value) else None
