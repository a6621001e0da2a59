"""The demo: remove the vase from a synthetic room and compare with the room as it is without the vase.

The baselines fill the photographs, the removal renders a splat. So the fair comparison is that of the masked
pixels, which all methods have to invent: the pixels of the masks as the removal widened them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import torch

from diga3d_warp.evaluation.metrics import Score, compare, mean_scores
from diga3d_warp.evaluation.protocols import evaluate
from diga3d_warp.evaluation.record import MANIFEST, add_metrics, read_manifest, run_effects
from diga3d_warp.evaluation.report import write_report
from diga3d_warp.evaluation.tables import Table, score_table
from diga3d_warp.gaussians.fit import FitSettings
from diga3d_warp.pipelines.remove import RemoveResult, RemoveSettings, remove
from diga3d_warp.pipelines.run import Run
from diga3d_warp.pipelines.stages import widened
from diga3d_warp.priors.classical import mean_color_fill, telea_fill
from diga3d_warp.scene.images import read_image
from diga3d_warp.scene.load import load_scene
from diga3d_warp.scene.scene import Scene, View
from diga3d_warp.scene.synthetic.generate import SyntheticScene, generate
from diga3d_warp.splatting.render import render

SCENE, RUN = "scene", "removed"
"""Folders that the demo makes: the capture with its ground truth, and the run."""

TRUTH = Path("ground_truth") / "without_object"
"""Where the generator puts the views without the object, in the folder of the capture."""

ROOM = SyntheticScene(shadows=False, seed=0)
"""The vase casts no shadow. Masks mark the object, so a shadow would stay, and the comparison would tell how
dark the shadow is rather than how well the floor goes on."""

SETTINGS = RemoveSettings(fit=FitSettings(iterations=1500, budget=30_000))
"""A fit that takes about two minutes on two cores. The room is small and its images have 320 x 240 pixels:
more gaussians gain it little."""

HOLD_OUT = 8

Method = Callable[[View, np.ndarray], torch.Tensor]
"""A view and its widened mask (H, W) to an image without the object, RGB in [0, 1], shape (H, W, 3)."""


def run_demo(out: Path, room: SyntheticScene | None = None) -> Path:
    """Generate a room, remove its vase, and compare with the ground truth and two fills of each view alone.

    What an earlier call finished is taken up: the scene, and each stage of the run.

    Args:
        out: Folder for the scene and the run.
        room: The room to generate; `ROOM` if None.

    Returns:
        The report.

    Raises:
        InputError: `out` cannot be written, or holds other things.
    """
    capture = out / SCENE
    if not capture.exists():
        generate(room or ROOM, capture, progress=True)
    scene = load_scene(capture, hold_out=HOLD_OUT, progress=True)
    run = Run(
        out / RUN,
        "remove",
        {
            "scene": capture, "masks": None, "image_scale": 1.0, "hold_out": HOLD_OUT, "seed": ROOM.seed,
            "iterations": SETTINGS.fit.iterations, "budget": SETTINGS.fit.budget,
            "references": SETTINGS.references, "selection": SETTINGS.selection,
        },
        resume=(out / RUN / MANIFEST).exists(),
    )  # fmt: skip
    result = remove(scene, run, SETTINGS, seed=ROOM.seed)
    table = _against_truth(scene, result)
    evaluate(run.folder, scene=scene)
    add_metrics(run.folder, "tables", [table.as_json()])
    report = write_report(run.folder)
    print(table.text())
    print(report)
    return report


def _against_truth(scene: Scene, result: RemoveResult) -> Table:
    """Each method on the fitted and on the held-out views, against the images without the object."""

    effects = run_effects(read_manifest(result.run.folder))

    def rendered(view: View, _: np.ndarray) -> torch.Tensor:
        with torch.no_grad():
            return render(result.gaussians, view.camera, effects=effects).color

    methods: dict[str, Method] = {
        "mean colour of each view": lambda view, mask: mean_color_fill(view.image, torch.from_numpy(mask)),
        "Telea on each view": lambda view, mask: telea_fill(view.image, torch.from_numpy(mask)),
        "diga3d remove": rendered,
    }
    rows = {
        f"{name}, {kind}": mean_scores(_scores(scene, views, method))
        for kind, views in (("fitted", scene.views), ("held out", scene.test_views))
        for name, method in methods.items()
    }
    title = (
        f"Against the room without the vase: mean over {len(scene.views)} fitted views, "
        f"{len(scene.test_views)} held out. Outside the masks the fills keep the photographs."
    )
    return score_table(title, "method, views", rows)


def _scores(scene: Scene, views: Sequence[View], method: Method) -> Iterator[dict[str, Score]]:
    for view in views:
        assert view.mask is not None, "the generator writes a mask for each view"
        mask = widened(view.mask, SETTINGS.masking)
        truth = read_image(scene.path / TRUTH / f"{view.name}.png")
        yield compare(method(view, mask), torch.from_numpy(truth).float() / 255.0, mask)
