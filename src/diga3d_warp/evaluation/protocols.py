"""Evaluation protocols: which views of a run are compared with which images.

held-out
    Against photographs that were never fitted. A run that removes an object has no photograph without it, so
    there the splat before the edit is scored on all pixels, the edited one on unmasked pixels only, and the
    two against each other on unmasked pixels: what the edit should have left alone. Pictures are compared as
    they render. Where a fit had exposures, it is compared a second time under a name of its own, after the
    affine colour transform that fits each photograph best. Photographs
    with transparent pixels and their renderings are compared over white, as in NeRF-synthetic's protocol.
spin-nerf
    Against the photographs without the object that a scene of SPIn-NeRF, 360-USID or Inpaint360GS brings:
    whole, over the mask, over the mask's bounding box. A test view without a mask is measured over the one
    that the run gave it. Any image scale; figures of different scales do not compare.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from tqdm import tqdm

from diga3d_warp.config import Effects
from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.frames import Draw, corrs_of_run, corrs_table
from diga3d_warp.evaluation.metrics import Score, compare, matched, mean_scores
from diga3d_warp.evaluation.perceptual import Gathering, Pair, Perceptual, perceptual_tables
from diga3d_warp.evaluation.record import (
    CAMERAS,
    REMEDY,
    RESULT,
    SOURCE,
    add_metrics,
    read_manifest,
    read_metrics,
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

EVAL_LINE = "`diga3d eval` measures LPIPS and other perceptual metrics."


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


@dataclass(frozen=True)
class Subject:
    """What is compared with what.

    Attributes:
        title: Name of the comparison.
        pair: A test view to its picture and reference.
    """

    title: str
    pair: Callable[[View], Pair]


def evaluate(
    folder: Path,
    protocol: str = "held-out",
    *,
    image_scale: float | None = None,
    scene: Scene | None = None,
    perceptual: Perceptual | None = None,
) -> list[Table]:
    """Measure a finished run and put the figures into its metrics.json under "evaluation".

    Args:
        folder: The run folder.
        protocol: "held-out" or "spin-nerf"; see the module.
        image_scale: Size of the images; that of the run if None.
        scene: The run's scene, if it is loaded already; read from where the manifest says if None.
        perceptual: Metrics that are measured beside PSNR and SSIM, and Corrs with them; none if None.

    Returns:
        The table of means, those of the perceptual metrics, then one by view for each comparison.

    Raises:
        InputError: the folder holds no finished run, the scene has gone, or it has no views to compare with.
    """
    manifest = read_manifest(folder)
    read_metrics(folder)  # damaged figures are refused before the work, not after it
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
    draws = {"edited": _renderer(folder / RESULT, effects)}
    if (folder / SOURCE).is_file():
        draws["source"] = _renderer(folder / SOURCE, effects)
    else:
        draws = {"fit": draws["edited"]}
    if protocol == "spin-nerf":
        subjects = [_against_truth(folder, draws)]
    elif "source" in draws:
        subjects = _edited_and_source(folder, draws)
    else:
        subjects = _fitted(draws["fit"], effects)
    comparisons, gatherings = _measure(subjects, views, perceptual)
    figures: dict[str, Any] = {
        "protocol": protocol,
        "image_scale": scale,
        "may_be_seen": scene.may_be_seen,
        "comparisons": [comparison.as_json() for comparison in comparisons],
    }
    if protocol == "held-out":
        figures["unmasked_loss_db"] = _unmasked_loss(comparisons)
    if perceptual is not None:
        cameras = load_cameras(folder / CAMERAS).train
        figures["perceptual"] = {
            "missing": perceptual.missing,
            "comparisons": {title: gathering.as_json() for title, gathering in gatherings.items()},
            "corrs": corrs_of_run(
                draws, cameras, folder / "masks", perceptual.matchers, fills=manifest["command"] == "remove"
            ),
        }
    add_metrics(folder, "evaluation", figures)
    return evaluation_tables(figures)


def evaluation_tables(figures: Mapping[str, Any]) -> list[Table]:
    """Tables of what `evaluate` put into metrics.json: the means, then each comparison by view."""
    comparisons = figures["comparisons"]
    count = max(len(comparison["views"]) for comparison in comparisons)
    title = f"Mean over {count} views ({figures['protocol']}, image scale {figures['image_scale']:g})."
    if "perceptual" not in figures:
        title += f" {EVAL_LINE}"
    if figures.get("may_be_seen"):
        title += " The splat was given: it may have been trained on these views."
    if figures.get("unmasked_loss_db") is not None:
        title += f" Unmasked pixels lost {figures['unmasked_loss_db']:.2f} dB to the edit."
    means = {entry["title"]: _scores_from_json(entry["mean"]) for entry in comparisons}
    tables = [score_table(title, "compared", means)]
    if "perceptual" in figures:
        tables += perceptual_tables(figures["perceptual"])
        if figures["perceptual"]["corrs"]["rows"]:
            tables.append(corrs_table(figures["perceptual"]["corrs"], figures["perceptual"]["missing"]))
    for entry in comparisons:
        rows = {name: _scores_from_json(scores) for name, scores in entry["views"].items()}
        tables.append(score_table(entry["title"].capitalize(), "view", rows))
    return tables


def _measure(
    subjects: list[Subject], views: list[View], perceptual: Perceptual | None
) -> tuple[list[Comparison], dict[str, Gathering]]:
    """Scores of all subjects, view by view, so that one view's pictures are in memory at a time."""
    scores: dict[str, dict[str, Mapping[str, Score]]] = {subject.title: {} for subject in subjects}
    gatherings = {} if perceptual is None else {title: Gathering(perceptual) for title in scores}
    for view in tqdm(views, "measuring", disable=perceptual is None or not sys.stderr.isatty()):
        for subject in subjects:
            pair = subject.pair(view)
            found = compare(pair.picture, pair.reference, pair.mask)
            scores[subject.title][view.name] = {key: found[key] for key in pair.regions if key in found}
            if gatherings:
                gatherings[subject.title].add(view.name, pair)
    return [Comparison(title, found) for title, found in scores.items()], gatherings


def _fitted(draw: Draw, effects: Effects) -> list[Subject]:
    """The fit as it renders new views and, where exposures were fitted, a second time with colours matched.

    A photograph that was not fitted has no exposure of its own, so the first is uncorrected.
    """

    def plain(view: View) -> Pair:
        return Pair(draw(view.camera), view.image)

    def even(view: View) -> Pair:
        alpha = view.alpha if effects.background else None
        return Pair(matched(draw(view.camera), view.image, alpha), view.image)

    subjects = [Subject("fit against photographs", plain)]
    if effects.exposure:
        subjects.append(Subject("fit, colours matched to each photograph", even))
    return subjects


def _edited_and_source(folder: Path, draws: Mapping[str, Draw]) -> list[Subject]:
    def before(view: View) -> Pair:
        regions = ("whole", "unmasked")
        return Pair(draws["source"](view.camera), view.image, _used_mask(folder, view), regions)

    def after(view: View) -> Pair:
        return Pair(draws["edited"](view.camera), view.image, _used_mask(folder, view), ("unmasked",))

    def change(view: View) -> Pair:
        first, last = draws["source"](view.camera), draws["edited"](view.camera)
        return Pair(last, first, _used_mask(folder, view), ("unmasked",), edit=True)

    return [
        Subject("source against photographs", before),
        Subject("edited against photographs", after),
        Subject("edited against source", change),
    ]


def _against_truth(folder: Path, draws: Mapping[str, Draw]) -> Subject:
    what, draw = next(iter(draws.items()))

    def shown(view: View) -> Pair:
        mask = _used_mask(folder, view) if view.mask is None else view.mask
        return Pair(draw(view.camera), view.image, mask)

    return Subject(f"{what} against ground truth", shown)


def _unmasked_loss(comparisons: list[Comparison]) -> float | None:
    """PSNR lost on unmasked pixels, which the edit should not change [dB]; None if unknown."""
    means = [comparison.mean.get("unmasked") for comparison in comparisons[:2]]
    if len(means) < 2 or means[0] is None or means[1] is None:
        return None
    loss = means[0].psnr - means[1].psnr
    return loss if math.isfinite(loss) else None


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


def _renderer(path: Path, effects: Effects) -> Draw:
    """A function that renders a .ply from a camera to RGB, shape (H, W, 3)."""
    gaussians = Gaussians.load_ply(path)

    @lru_cache(1)  # comparisons share the picture of a view
    def draw(camera: Camera) -> torch.Tensor:
        with torch.no_grad():
            return render(gaussians, camera, effects=effects, background=BACKGROUND).color

    return draw


def _scores_as_json(scores: Mapping[str, Score]) -> dict[str, Any]:
    return {region: score.as_json() for region, score in scores.items()}


def _scores_from_json(data: Mapping[str, Any]) -> dict[str, Score]:
    return {region: Score.from_json(score) for region, score in data.items()}
