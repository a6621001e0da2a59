"""The demo: remove the vase of a synthetic room, turn it into marble, put a golden ball in its place.

The synthetic room has ground truth for all three edits. Only the removal is measured: marble and gold in the
ground truth have another texture than the edit, and are compared by eye.

The baselines fill the photographs, the removal renders a splat. So they are compared within the masks, whose
pixels every method has to inpaint; the masks are those that the removal dilated.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace as with_changes
from pathlib import Path

import numpy as np
import torch

from diga3d_warp.evaluation.gallery import write_gallery
from diga3d_warp.evaluation.metrics import Score, compare, mean_scores
from diga3d_warp.evaluation.protocols import evaluate
from diga3d_warp.evaluation.record import MANIFEST, add_metrics, read_manifest, run_effects
from diga3d_warp.evaluation.report import write_report
from diga3d_warp.evaluation.tables import Table, score_table
from diga3d_warp.gaussians.fit import FitSettings
from diga3d_warp.pipelines.clearing import widened
from diga3d_warp.pipelines.remove import RemoveSettings, remove_object
from diga3d_warp.pipelines.replace import ReplaceSettings, replace_object
from diga3d_warp.pipelines.request import EditResult
from diga3d_warp.pipelines.retexture import RetextureSettings, retexture_object
from diga3d_warp.pipelines.run import Run
from diga3d_warp.pipelines.stages import SOURCE
from diga3d_warp.priors.classical import mean_color_fill, telea_fill
from diga3d_warp.priors.exemplar.prior import ExemplarPrior
from diga3d_warp.scene.load import load_scene
from diga3d_warp.scene.photographs.images import read_image
from diga3d_warp.scene.scene import Scene, View
from diga3d_warp.scene.synthetic.generate import SyntheticScene, generate
from diga3d_warp.splatting.render import render

SCENE, RUN, RETEXTURED, REPLACED = "scene", "removed", "retextured", "replaced"
"""Folders that the demo makes: the capture with its ground truth, and a run for each task."""

TRUTH = Path("ground_truth") / "without_object"
"""Folder of the views without the object, below the folder of the capture; beside it are the views
with another material and another object."""

MATERIAL, OBJECT = "white marble", "a golden sphere"
"""What the generator's other truths show."""

SHOWN = 4
"""Views in the gallery, spread evenly over all."""

ROOM = SyntheticScene(shadows=False, seed=0)
"""The vase casts no shadow. Masks mark the object only, so a shadow would stay, and the comparison would
measure the shadow rather than the fill."""

SETTINGS = RemoveSettings(fit=FitSettings(iterations=1500, budget=30_000))
"""A fit that takes about two minutes on two cores. The room is small and its images have 320 x 240 pixels:
more gaussians gain it little."""

HOLD_OUT = 8

Method = Callable[[View, np.ndarray], torch.Tensor]
"""A view and its widened mask (H, W) to an image without the object, RGB in [0, 1], shape (H, W, 3)."""


def run_demo(out: Path, room: SyntheticScene | None = None) -> Path:
    """Generate a room, edit its vase in three ways, and compare with the ground truth.

    The removal is also compared with two baselines that fill each view alone. The scene and the stages that
    an earlier call finished are reused.

    Args:
        out: Folder for the scene and the runs.
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
    run = _run(out / RUN, "remove")
    result = remove_object(scene, run, SETTINGS, seed=ROOM.seed)
    table = _against_truth(scene, result)
    evaluate(run.folder, scene=scene)
    add_metrics(run.folder, "tables", [table.as_json()])
    write_report(run.folder)

    fitted = with_changes(scene, splat=run.folder / SOURCE)  # one fit serves all three
    retextured = _run(out / RETEXTURED, "retexture", MATERIAL)
    retexture_object(fitted, MATERIAL, retextured, RetextureSettings(fit=SETTINGS.fit), seed=ROOM.seed)
    replaced = _run(out / REPLACED, "replace", OBJECT)
    replace_object(fitted, OBJECT, replaced, ReplaceSettings(SETTINGS), seed=ROOM.seed)
    for other in (retextured, replaced):
        evaluate(other.folder, scene=scene)
        write_report(other.folder)

    print(table.text())
    report = _side_by_side(out, scene, table)
    print(report)
    return report


def _run(folder: Path, task: str, prompt: str | None = None) -> Run:
    settings = {
        "scene": folder.parent / SCENE, "masks": None, "image_scale": 1.0, "hold_out": HOLD_OUT,
        "seed": ROOM.seed, "iterations": SETTINGS.fit.iterations, "budget": SETTINGS.fit.budget,
        **SETTINGS.method_for(ExemplarPrior()).summary(),
    }  # fmt: skip
    if prompt is not None:
        settings["prompt"] = prompt
    return Run(folder, task, settings, resume=(folder / MANIFEST).exists())


def _side_by_side(out: Path, scene: Scene, table: Table) -> Path:
    views = [*scene.test_views, *scene.views]
    rows = []
    for index in np.linspace(0, len(views) - 1, SHOWN).round().astype(int):
        file = f"{views[index].name}.png"
        truth, after = out / SCENE / TRUTH.parent, Path("views") / "after" / file
        rows.append(
            {
                f"photograph {views[index].name}": out / SCENE / "images" / file,
                "removed": out / RUN / after,
                "truth without": truth / TRUTH.name / file,
                MATERIAL: out / RETEXTURED / after,
                "truth in marble": truth / "other_material" / file,
                OBJECT: out / REPLACED / after,
                "truth with a ball": truth / "other_object" / file,
            }
        )
    runs = {"removed": out / RUN, MATERIAL: out / RETEXTURED, OBJECT: out / REPLACED}
    return write_gallery(out, "A vase removed, in marble, and replaced", rows, runs, table)


def _against_truth(scene: Scene, result: EditResult) -> Table:
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
