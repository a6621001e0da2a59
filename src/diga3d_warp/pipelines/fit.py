"""Fit a splat to a capture."""

from __future__ import annotations

if __name__ == "__main__":  # first of all, because the command tunes the process before torch is imported
    import sys

    from diga3d_warp.cli import main

    sys.exit(main(["fit", *sys.argv[1:]]))

from dataclasses import replace
from pathlib import Path
from typing import Any

from diga3d_warp.config import Accuracy
from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.protocols import evaluate
from diga3d_warp.evaluation.record import RESULT
from diga3d_warp.evaluation.report import write_report
from diga3d_warp.gaussians.fit import FitSettings
from diga3d_warp.pipelines import stages
from diga3d_warp.pipelines.baking import baked
from diga3d_warp.pipelines.contents import everything
from diga3d_warp.pipelines.request import FitRequest, RunResult
from diga3d_warp.pipelines.run import Run
from diga3d_warp.scene.scene import Scene

BUDGET_PER_POINT = 4
"""Gaussians at the end of a fit for each sparse point: more texture gives more points, and needs more
gaussians."""

BUDGET_LEAST, BUDGET_MOST = 60_000, 150_000
"""Bounds of the budget. Fewer save little time; more want more iterations than minutes on a CPU allow."""

ITERATIONS_PER_VIEW = 50
"""Iterations of a fit for each image, one an iteration: with fewer, images of a large capture are still far
apart from their renderings when the rates have decayed."""

ITERATIONS_MOST = 6000
"""Upper limit of the default number of iterations; a user may ask for more."""


def fit_settings(scene: Scene, iterations: int | None, accuracy: Accuracy = Accuracy.STANDARD) -> FitSettings:
    """Default settings of a fit of a scene; `iterations` overrides their number."""
    budget = min(max(BUDGET_PER_POINT * len(scene.points), BUDGET_LEAST), BUDGET_MOST)
    wanted = min(ITERATIONS_PER_VIEW * len(scene.views), ITERATIONS_MOST)
    settings = FitSettings(accuracy=accuracy)
    return replace(settings, budget=budget, iterations=iterations or max(wanted, settings.iterations))


def requested_fit(scene: Scene, request: FitRequest) -> FitSettings:
    """Default settings of a fit of a scene, with the options of a request applied.

    Raises:
        InputError: the scene has a splat, which is not fitted again, and anchors are asked for.
    """
    if request.scaffold is not None and scene.splat is not None:
        raise InputError(
            f"{scene.splat} is taken as it is, and holds gaussians: leave --representation scaffold out, or "
            "give the photographs without it"
        )
    settings = fit_settings(scene, request.iterations, request.knobs)
    return replace(settings, scaffold=request.scaffold)


def fit(
    scene: str | Path | Scene, out: str | Path, *, settings: FitSettings | None = None, **options: Any
) -> RunResult:
    """Fit a splat to a capture, measure it on the held-out views, and leave a run folder.

    Args:
        scene: Folder or file of a capture, or a scene from `load_scene`.
        out: Run folder, a new one unless `resume=True`.
        settings: Iterations, budget and learning rates of the fit; chosen by the scene if None.
        options: Further attributes of `FitRequest`, such as `iterations`, `effects`, `seed` and `resume`.

    Raises:
        InputError: the input or the run folder is not usable.
        TypeError: an option is unknown.
    """
    request = FitRequest(scene=scene, out=out, **options)
    capture = request.load()
    stages.check_splat(capture)
    settings = settings or requested_fit(capture, request)
    run = request.open_run("fit", capture, settings.iterations)
    run.hold_to(**everything(capture, settings, request.seed, request.effects))
    capture = stages.begin(run, capture, request.effects)
    stages.fit_source(run, capture, settings, request.seed)
    views = capture.views if settings.scaffold is None else stages.correct_exposure(run, capture).views
    plain = baked(run, "fit", views, request.seed, RESULT)
    stages.show_views(run, capture, None, plain.gaussians)
    gaussians, _ = stages.finish(run, plain.stage, source=plain.stage)
    conclude(run, capture)
    return RunResult(gaussians, run)


def conclude(run: Run, scene: Scene) -> None:
    """Measure the run on its held-out views, if any, write its report, and release the lock of its folder."""
    if scene.test_views:
        for table in evaluate(run.folder, "spin-nerf" if scene.ground_truth else "held-out", scene=scene):
            print(table.text())
    write_report(run.folder)
    run.close()
