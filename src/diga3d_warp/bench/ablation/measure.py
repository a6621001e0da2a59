"""Run the trials, and compute their figures from the finished stages."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypedDict

import numpy as np
import torch

from diga3d_warp.bench.ablation.trials import Trial
from diga3d_warp.bench.room import SETTINGS, against_truth, share_stages, true_picture
from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.consistency import depth_errors, disagreement
from diga3d_warp.evaluation.record import MANIFEST, read_manifest
from diga3d_warp.pipelines.coarse import read_fills
from diga3d_warp.pipelines.demo import TRUTH
from diga3d_warp.pipelines.remove import RemoveSettings, remove_object
from diga3d_warp.pipelines.request import EditResult
from diga3d_warp.pipelines.run import Run
from diga3d_warp.pipelines.stages import shell_of
from diga3d_warp.priors.named import load_prior
from diga3d_warp.priors.protocol import Prior
from diga3d_warp.propagation.fill import Fill
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.scene import Scene
from diga3d_warp.splatting.render import render
from diga3d_warp.state import read_mask

COARSE = ("references", "charts", "fill", "propagate", "refit")
"""Stages that the fine stage builds on."""

EDIT = (*COARSE, "distil")

TRUE_DEPTH = TRUTH.with_name("depth_without_object")


class Figures(TypedDict):
    """Figures of one removal.

    psnr, ssim, psnr_masked, ssim_masked: of the held-out views against the truth, over whole images and
        within the widened masks [dB, 1].
    coarse_psnr: of the filled views before any fit, in what no view had seen [dB].
    coarse_contrast: deviation of their colours there, relative to that of the true images [1].
    coarse: their disagreement there [levels of 255].
    rendered: disagreement of the same views, rendered from the edited splat [levels of 255].
    depth_error: median relative depth error of those renderings in what no view had seen [1].
    seconds: wall time of the stages from the choice of references to the last.
    peak_mib: largest resident memory of the process in these stages.
    """

    psnr: float
    ssim: float
    psnr_masked: float
    ssim_masked: float
    coarse_psnr: float
    coarse_contrast: float
    coarse: float
    rendered: float
    depth_error: float
    seconds: float
    peak_mib: float


@dataclass(frozen=True, eq=False)
class Outcome:
    """One removal.

    Attributes:
        figures: Against the truth.
        fills: The filled views by name, RGB in [0, 1], shape (H, W, 3); grey where no fill arrived, which the
            figures of the filled views leave out, as the fit does.
        shown: One held-out view, rendered, RGB in [0, 1], shape (H, W, 3).
    """

    figures: Figures
    fills: dict[str, np.ndarray]
    shown: np.ndarray


@dataclass(frozen=True, eq=False)
class Truth:
    """Ground truth of the fitted views of a room, and their unseen pixels.

    Attributes:
        images: The room without the object, RGB in [0, 1], shape (H, W, 3).
        depths: Its z depth [m], shape (H, W).
        unseen: What no photograph shows behind the object, shape (H, W), bool.
    """

    images: list[np.ndarray]
    depths: list[np.ndarray]
    unseen: list[np.ndarray]

    @classmethod
    def of(cls, scene: Scene, run: Run) -> Truth:
        """From the generator, and from a run that has looked behind the object."""
        stage = run.folder / "stages" / "look-behind"
        return cls(
            [true_picture(scene, view).numpy() for view in scene.views],
            [np.load(scene.path / TRUE_DEPTH / f"{view.name}.npy") for view in scene.views],
            [read_mask(stage / f"{view.name}.unseen.png") for view in scene.views],
        )

    def psnr(self, images: Sequence[np.ndarray], regions: Sequence[np.ndarray]) -> float:
        """Of images of the fitted views within regions, all together [dB]; infinite for equal ones."""
        parts = [
            (image[where] - true[where]).astype(np.float64).ravel()
            for image, true, where in zip(images, self.images, regions, strict=True)
        ]
        error = float(np.square(np.concatenate(parts)).mean())
        return -10.0 * float(np.log10(error)) if error else float("inf")

    def contrast(self, images: Sequence[np.ndarray], regions: Sequence[np.ndarray]) -> float:
        """Deviation of colours within regions, mean over views, relative to the truth's [1]."""
        shown, true = (
            [each[where].std(0).mean() for each, where in zip(views, regions, strict=True) if where.any()]
            for views in (images, self.images)
        )
        return float(np.mean(shown) / np.mean(true))

    def disagreement(
        self, scene: Scene, images: Sequence[np.ndarray], regions: Sequence[np.ndarray] | None = None
    ) -> float:
        """Of images of the fitted views in what no view had seen, along the true depth [levels of 255].

        Args:
            scene: The room.
            images: RGB in [0, 1], one a fitted view, shape (H, W, 3).
            regions: The part of `unseen` where the images hold something, shape (H, W), bool; all if None.
        """
        cameras = [view.camera for view in scene.views]
        regions = self.unseen if regions is None else regions
        depths = [
            np.where(unseen & ~held, 0.0, depth)
            for depth, unseen, held in zip(self.depths, self.unseen, regions, strict=True)
        ]
        return disagreement(cameras, images, depths, regions).difference


def priors_of(trials: Iterable[Trial]) -> dict[str, Prior | str]:
    """The priors of the trials by name; for one that cannot be loaded, a line that says why."""
    found: dict[str, Prior | str] = {}
    for name in dict.fromkeys(trial.prior for trial in trials):
        try:
            found[name] = load_prior(name, task="remove", controls=("edges", "depth"))
        except InputError as error:
            found[name] = str(error)
    return found


def measure(
    scene: Scene,
    trials: Iterable[Trial],
    seed: int,
    folder: Path,
    priors: Mapping[str, Prior | str],
    settings: RemoveSettings = SETTINGS,
) -> Iterator[tuple[Trial, Outcome]]:
    """Run each trial on a capture, once.

    All share the fit of the capture; those that differ in the fine stage alone share the coarse one.

    Args:
        scene: A synthetic capture, with held-out views.
        trials: Equal ones are run once. Those of a prior that cannot be measured are left out.
        seed: Seed of the edits.
        folder: Folder that receives the runs; what it holds of an interrupted measurement is taken up.
        priors: From `priors_of`.
        settings: Settings of all trials except their method.
    """
    for trial in dict.fromkeys(trials):
        prior = priors[trial.prior]
        if isinstance(prior, str):
            continue
        runs = folder / trial.key
        run = Run(runs, "remove", {"scene": scene.path}, resume=(runs / MANIFEST).exists())
        share_stages(folder / "captured", run.folder)
        share_stages(folder / f"coarse-{trial.coarse.key}", run.folder, COARSE)
        result = remove_object(scene, run, replace(settings, method=trial.method), prior=prior, seed=seed)
        share_stages(run.folder, folder / "captured")
        share_stages(run.folder, folder / f"coarse-{trial.coarse.key}", COARSE)
        yield trial, outcome_of(scene, result, settings, Truth.of(scene, run))


def final_fills(result: EditResult, scene: Scene) -> list[Fill]:
    """The views as they are filled before any fit."""
    stages = result.run.folder / "stages"
    return read_fills(stages / ("propagate" if (stages / "propagate").is_dir() else "fill"), scene.views)


def outcome_of(scene: Scene, result: EditResult, settings: RemoveSettings, truth: Truth) -> Outcome:
    """The figures of a finished removal."""
    images, regions = [], []
    for fill, unseen in zip(final_fills(result, scene), truth.unseen, strict=True):
        missing, picture = fill.missing, fill.image
        images.append(np.where(missing[..., None], np.float32(0.5), picture))
        regions.append(unseen & ~missing)
    colors, depths = zip(*(_seen(result, view.camera) for view in scene.views), strict=True)
    timing = [stage for stage in read_manifest(result.run.folder)["stages"] if stage["name"] in EDIT]
    score = against_truth(scene, result, settings)
    figures = Figures(
        psnr=score["whole"].psnr,
        ssim=score["whole"].ssim,
        psnr_masked=score["masked"].psnr,
        ssim_masked=score["masked"].ssim,
        coarse_psnr=truth.psnr(images, regions),
        coarse_contrast=truth.contrast(images, regions),
        coarse=truth.disagreement(scene, images, regions),
        rendered=truth.disagreement(scene, colors),
        depth_error=float(np.median(depth_errors(depths, truth.depths, truth.unseen))),
        seconds=sum(stage["seconds"] for stage in timing),
        peak_mib=float(max(stage["peak_mib"] for stage in timing)),
    )
    return Outcome(
        figures,
        fills={view.name: image for view, image in zip(scene.views, images, strict=True)},
        shown=_seen(result, scene.test_views[len(scene.test_views) // 2].camera)[0],
    )


def _seen(result: EditResult, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Colour in [0, 1] and depth of a rendering; depth is 0 where the splat covers less than half.

    The surround counts for colour alone: it is far behind, and a little of it changes mean depth much.
    """
    shell, effects = shell_of(result.run), result.run.effects
    scene = result.gaussians.select(
        torch.arange(len(result.gaussians) - (0 if shell is None else len(shell)))
    )
    with torch.no_grad():
        color = render(result.gaussians, camera, effects=effects).color
        rendering = render(scene, camera, effects=replace(effects, depth=True))
    depth = torch.where(rendering.alpha > 0.5, rendering.depth, 0.0)
    return color.clamp(0.0, 1.0).numpy(), depth.numpy()
