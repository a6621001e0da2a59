"""Evaluation protocols: which views of a run are compared with which images.

held-out
    Against photographs that were never fitted. A run that removes an object has no photograph without it, so
    there the splat before the edit is scored on all pixels, the edited one on unmasked pixels only, and the
    two against each other on unmasked pixels: what the edit should have left alone. Pictures are compared as
    they render. Where a fit had exposures, it is compared a second time under a name of its own, after the
    affine colour transform that fits each photograph best. Photographs
    with transparent pixels and their renderings are compared over white, as in NeRF-synthetic's protocol.
spin-nerf
    Against the photographs without the object that a SPIn-NeRF scene brings: whole, over the mask, over the
    mask's bounding box. Any image scale; figures of different scales do not compare.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from diga3d_warp.config import Effects
from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.metrics import Score, compare, matched, mean_scores
from diga3d_warp.evaluation.record import (
    CAMERAS,
    REMEDY,
    RESULT,
    SOURCE,
    add_metrics,
    read_manifest,
    run_effects,
)
from diga3d_warp.evaluation.tables import Table, score_table
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.layouts.cameras_file import load_cameras
from diga3d_warp.scene.masks.labels import stretched
from diga3d_warp.scene.photographs.images import BACKGROUND
from diga3d_warp.scene.scene import Scene, View
from diga3d_warp.splatting.render import render
from diga3d_warp.state import read_plane

if TYPE_CHECKING:
    from numpy.typing import NDArray

LPIPS_LINE = "LPIPS is not measured: its weights are not part of this program."


@dataclass(frozen=True)
class Comparison:
    """Pictures compared with others, view by view.

    Attributes:
        title: What is compared with what.
        views: Scores by view name and region.
    """

    title: str
    views: Mapping[str, Mapping[str, Score]]

    @property
    def mean(self) -> dict[str, Score]:
        """Mean over views by region."""
        return mean_scores(self.views.values())

    def as_json(self) -> dict[str, Any]:
        """All figures as JSON data."""
        return {
            "title": self.title,
            "mean": _scores_as_json(self.mean),
            "views": {name: _scores_as_json(scores) for name, scores in self.views.items()},
        }


def evaluate(
    folder: Path, protocol: str = "held-out", *, image_scale: float | None = None, scene: Scene | None = None
) -> list[Table]:
    """Measure a finished run and put the figures into its metrics.json under "evaluation".

    Args:
        folder: The run folder.
        protocol: "held-out" or "spin-nerf"; see the module.
        image_scale: Size of the images; that of the run if None.
        scene: The run's scene, if it is loaded already; read from where the manifest says if None.

    Returns:
        The table of means, then one by view for each comparison.

    Raises:
        InputError: the folder holds no finished run, the scene has gone, or it has no views to compare with.
    """
    manifest = read_manifest(folder)
    settings, effects = manifest["settings"], run_effects(manifest)
    if not (folder / RESULT).is_file():
        raise InputError(f"{folder} has no {RESULT}: finish the run with --resume first")
    scale = settings.get("image_scale", 1.0) if image_scale is None else image_scale
    if scene is None:
        scene = _load_scene(folder, settings, scale)
    if protocol == "spin-nerf" and not scene.ground_truth:
        raise InputError(
            f"{scene.path} has no ground-truth views without the object, which spin-nerf compares with: "
            "use --protocol held-out"
        )
    views = _test_views(folder, scene.with_alpha(effects.background))
    if protocol == "spin-nerf":
        comparisons = [_against_truth(folder, views, effects)]
    elif (folder / SOURCE).is_file():
        comparisons = _edited_and_source(folder, views, effects)
    else:
        comparisons = _fitted(folder, views, effects)
    figures: dict[str, Any] = {
        "protocol": protocol,
        "image_scale": scale,
        "lpips": None,
        "may_be_seen": scene.may_be_seen,
        "comparisons": [comparison.as_json() for comparison in comparisons],
    }
    if protocol == "held-out":
        figures["unmasked_loss_db"] = _unmasked_loss(comparisons)
    add_metrics(folder, "evaluation", figures)
    return evaluation_tables(figures)


def evaluation_tables(figures: Mapping[str, Any]) -> list[Table]:
    """Tables of what `evaluate` put into metrics.json: the means, then each comparison by view."""
    comparisons = figures["comparisons"]
    count = max(len(comparison["views"]) for comparison in comparisons)
    title = f"Mean over {count} views ({figures['protocol']}, image scale {figures['image_scale']:g}). "
    title += LPIPS_LINE
    if figures.get("may_be_seen"):
        title += " The splat was given: it may have been trained on these views."
    if figures.get("unmasked_loss_db") is not None:
        title += f" Unmasked pixels lost {figures['unmasked_loss_db']:.2f} dB to the edit."
    means = {entry["title"]: _scores_from_json(entry["mean"]) for entry in comparisons}
    tables = [score_table(title, "compared", means)]
    for entry in comparisons:
        rows = {name: _scores_from_json(scores) for name, scores in entry["views"].items()}
        tables.append(score_table(entry["title"].capitalize(), "view", rows))
    return tables


def _fitted(folder: Path, views: list[View], effects: Effects) -> list[Comparison]:
    """The fit as it renders new views and, where exposures were fitted, a second time with colours matched.

    A photograph that was not fitted has no exposure of its own, so the first is uncorrected.
    """
    draw = _renderer(folder / RESULT, effects)
    pictures = {view.name: draw(view.camera) for view in views}
    plain = {view.name: compare(pictures[view.name], view.image) for view in views}
    comparisons = [Comparison("fit against photographs", plain)]
    if effects.exposure:
        even = {
            view.name: compare(
                matched(pictures[view.name], view.image, view.alpha if effects.background else None),
                view.image,
            )
            for view in views
        }
        comparisons.append(Comparison("fit, colours matched to each photograph", even))
    return comparisons


def _edited_and_source(folder: Path, views: list[View], effects: Effects) -> list[Comparison]:
    edited, source = _renderer(folder / RESULT, effects), _renderer(folder / SOURCE, effects)
    before: dict[str, Mapping[str, Score]] = {}
    after: dict[str, Mapping[str, Score]] = {}
    change: dict[str, Mapping[str, Score]] = {}
    for view in views:
        mask = _used_mask(folder, view)
        first, last, photo = source(view.camera), edited(view.camera), view.image
        scores = compare(first, photo, mask)
        before[view.name] = {key: scores[key] for key in ("whole", "unmasked") if key in scores}
        after[view.name] = _only_unmasked(compare(last, photo, mask))
        change[view.name] = _only_unmasked(compare(last, first, mask))
    return [
        Comparison("source against photographs", before),
        Comparison("edited against photographs", after),
        Comparison("edited against source", change),
    ]


def _against_truth(folder: Path, views: list[View], effects: Effects) -> Comparison:
    draw = _renderer(folder / RESULT, effects)
    what = "edited" if (folder / SOURCE).is_file() else "fit"
    return Comparison(
        f"{what} against ground truth",
        {view.name: compare(draw(view.camera), view.image, view.mask) for view in views},
    )


def _unmasked_loss(comparisons: list[Comparison]) -> float | None:
    """PSNR lost on unmasked pixels, which the edit should not change [dB]; None if unknown."""
    means = [comparison.mean.get("unmasked") for comparison in comparisons[:2]]
    if len(means) < 2 or means[0] is None or means[1] is None:
        return None
    loss = means[0].psnr - means[1].psnr
    return loss if math.isfinite(loss) else None


def _only_unmasked(scores: Mapping[str, Score]) -> dict[str, Score]:
    return {"unmasked": scores["unmasked"]} if "unmasked" in scores else {}


def _load_scene(folder: Path, settings: Mapping[str, Any], scale: float) -> Scene:
    from diga3d_warp.scene.load import load_scene

    if "scene" not in settings:
        raise InputError(f"{folder} does not say which scene it was made from: {REMEDY}")
    masks = settings.get("masks")
    return load_scene(
        Path(settings["scene"]),
        image_scale=scale,
        masks=Path(masks) if masks else None,
        mask_ids=settings.get("mask_ids", ()),
        hold_out=settings.get("hold_out", 8),
    )


def _test_views(folder: Path, scene: Scene) -> list[View]:
    """The scene's test views with the run's own cameras: poses found by a mapper differ from run to run."""
    cameras = load_cameras(folder / CAMERAS).test
    views = []
    for view in scene.test_views:
        if view.name in cameras:
            height, width = view.pixels.shape[:2]
            camera = cameras[view.name].resized(width, height)
            views.append(replace(view, camera=camera))
    if not views:
        raise InputError(f"{folder} held out no views to measure on: run it with --hold-out 8")
    return views


def _used_mask(folder: Path, view: View) -> NDArray[np.bool_] | None:
    """The mask that the run used for a view, which may be wider than the scene's; else the scene's."""
    path = folder / "masks" / f"{view.name}.png"
    if not path.is_file():
        return view.mask
    mask = read_plane(path)
    height, width = view.pixels.shape[:2]
    return stretched(mask, width, height) > 127


def _renderer(path: Path, effects: Effects) -> Callable[[Camera], torch.Tensor]:
    """A function that renders a .ply from a camera to RGB, shape (H, W, 3)."""
    gaussians = Gaussians.load_ply(path)

    def draw(camera: Camera) -> torch.Tensor:
        with torch.no_grad():
            return render(gaussians, camera, effects=effects, background=BACKGROUND).color

    return draw


def _scores_as_json(scores: Mapping[str, Score]) -> dict[str, Any]:
    return {region: score.as_json() for region, score in scores.items()}


def _scores_from_json(data: Mapping[str, Any]) -> dict[str, Score]:
    return {region: Score.from_json(score) for region, score in data.items()}
