"""Fit a splat to a capture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from diga3d_warp.config import ACCURACIES, Accuracy
from diga3d_warp.effects.overrides import format_overrides
from diga3d_warp.evaluation.protocols import evaluate
from diga3d_warp.evaluation.report import write_report
from diga3d_warp.gaussians.fit import FitSettings
from diga3d_warp.pipelines import stages
from diga3d_warp.pipelines.run import Run
from diga3d_warp.scene.load import load_scene
from diga3d_warp.scene.scene import Scene

BUDGET_PER_POINT = 4
"""Gaussians at the end of a fit for each sparse point: points stand for texture, and where there is more of
it more gaussians are needed."""

BUDGET_LEAST, BUDGET_MOST = 60_000, 150_000
"""Bounds of the budget. Fewer save little time; more want more iterations than minutes on a CPU allow."""

ITERATIONS_PER_VIEW = 50
"""Iterations of a fit for each image, one an iteration: with fewer, images of a large capture are still far
apart from their renderings when the rates have decayed."""

ITERATIONS_MOST = 6000
"""Most iterations that a fit takes by itself; a user may ask for more."""


def fit_settings(scene: Scene, iterations: int | None, accuracy: Accuracy = Accuracy.STANDARD) -> FitSettings:
    """The settings of a fit that suit a scene, with another number of iterations if one is given."""
    budget = min(max(BUDGET_PER_POINT * len(scene.points), BUDGET_LEAST), BUDGET_MOST)
    wanted = min(ITERATIONS_PER_VIEW * len(scene.views), ITERATIONS_MOST)
    settings = FitSettings(accuracy=accuracy)
    return replace(settings, budget=budget, iterations=iterations or max(wanted, settings.iterations))


def fit_command(
    scene: Path, out: Path, masks: Path | None, image_scale: float, iterations: int | None, hold_out: int,
    seed: int, resume: bool, effects: Mapping[str, bool | int], accuracy: str,
) -> Run:  # fmt: skip
    """`diga3d fit`: read the capture, fit it, measure it, and leave a run folder.

    Raises:
        InputError: the input or the run folder is not usable.
    """
    capture = load_scene(scene, image_scale=image_scale, masks=masks, hold_out=hold_out, progress=True)
    stages.check_splat(capture)
    settings = fit_settings(capture, iterations, ACCURACIES[accuracy])
    run = Run(
        out,
        "fit",
        {
            "scene": scene, "masks": masks, "image_scale": image_scale, "hold_out": hold_out, "seed": seed,
            "iterations": settings.iterations, "accuracy": accuracy, "effects": format_overrides(effects),
        },
        resume=resume,
    )  # fmt: skip
    capture = stages.begin(run, capture, effects)
    fitted = stages.fit_source(run, capture, settings, seed)
    stages.show_views(run, capture, None, fitted)
    stages.finish(run, "fit")
    conclude(run, capture)
    return run


def conclude(run: Run, scene: Scene) -> None:
    """Measure the run on held-out views, where it has any, and write its report."""
    if scene.test_views:
        for table in evaluate(run.folder, "spin-nerf" if scene.ground_truth else "held-out", scene=scene):
            print(table.text())
    write_report(run.folder)
