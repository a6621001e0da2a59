"""Object masks of all views from those of a few: lifted to 3D, and cut along the colours of each view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from diga3d_warp.config import Effects
from diga3d_warp.errors import InputError
from diga3d_warp.files import write_image
from diga3d_warp.gaussians.lift import LiftSettings, Votes, object_mask, object_rows, vote
from diga3d_warp.gaussians.representation import Representation
from diga3d_warp.perception.boxes import cut_along
from diga3d_warp.pipelines import clearing
from diga3d_warp.pipelines.marking import Marks
from diga3d_warp.pipelines.run import Run
from diga3d_warp.scene.scene import Scene, View

SHEET = "mask_sheet.png"

TINT = (255, 64, 160)
"""Colour of a mask on the sheet, RGB: rare in photographs."""


@dataclass(frozen=True)
class MaskPropagationSettings:
    """Thresholds of propagating masks from a few views to all.

    Attributes:
        grid: Cells across the object; gaussians in adjacent cells are connected. The largest connected group
            is the object.
        part: Least size of another group that belongs to it [share of the largest].
        depth: How far the object may extend behind what the masked views see of it [object sizes], within its
            outline in those views.
        sure: Distance inside the outline from which pixels are foreground [image diagonals].
        reach: Distance outside the outline up to which pixels may be foreground [image diagonals].
        tile: Height of a picture on the overlay sheet [px].
        columns: Pictures side by side on it.
    """

    grid: int = 24
    part: float = 0.2
    depth: float = 0.35
    sure: float = 0.012
    reach: float = 0.02
    tile: int = 180
    columns: int = 6


def propagate_masks(
    run: Run, scene: Scene, source: Representation, marks: Marks, lift: LiftSettings
) -> clearing.Masks:
    """Object masks: of all views from those of the marked ones; the user's, if the scene brought its own.

    The gaussians that the marked views show the object by give every other view a rough mask, whose edge
    GrabCut then lays along the colours. A sheet of all masks goes into the run folder.

    Raises:
        InputError: the masks lift to no gaussian.
    """
    views = [*scene.views, *scene.test_views]
    given = {view.name: view.mask for view in views if view.mask is not None}
    if marks.own:
        return given
    settings = MaskPropagationSettings()

    def compute(folder: Path) -> None:
        seeds, candidates = object_seeds(source, _votes(source, views, given, run.effects), lift, settings)
        if not seeds.any():
            raise InputError(
                f"{scene.path}: the marked object lifts to no gaussian; mark what the splat shows"
            )
        cut = dict(given)
        for view in views:
            if view.name not in given:
                cut[view.name] = _propagated(source, view, seeds, candidates, lift, settings, run.effects)
        # Each view was cut by itself; a vote over all views makes the masks consistent.
        rows = object_rows(_votes(source, views, cut, run.effects), lift)
        masks = []
        for view in views:
            mask = given.get(view.name)
            if mask is None:
                mask = object_mask(source, view.camera, rows, lift, run.effects)
            write_image(folder / f"{view.name}.png", mask)
            masks.append(mask)
        write_image(folder / SHEET, overlay_sheet(views, masks, settings))

    folder = run.stage("propagate-masks", compute)
    run.publish(folder / SHEET, SHEET)
    return clearing.read_masks(folder, views)


def _votes(source: Representation, views: Sequence[View], masks: clearing.Masks, effects: Effects) -> Votes:
    """Votes of the views that have a mask."""
    known = [view for view in views if view.name in masks]
    return vote(source, [view.camera for view in known], [masks[view.name] for view in known], effects)


def object_seeds(
    source: Representation, votes: Votes, lift: LiftSettings, settings: MaskPropagationSettings
) -> tuple[torch.Tensor, torch.Tensor]:
    """Gaussians that the masked views show to be the object, and those that may be, both shape (N,), bool."""
    from scipy.ndimage import label
    from scipy.spatial import cKDTree

    seen = votes.total > lift.faint
    rows = (seen & (votes.share > lift.share)).numpy()
    if not rows.any():
        return torch.from_numpy(rows), torch.from_numpy(rows)
    means = source.means.numpy().astype(np.float64)
    weight = votes.masked.numpy()
    low, high = _bounds(means[rows], weight[rows])
    size = float((high - low).max())
    cell = np.floor((means[rows] - low) / max(size / settings.grid, 1e-9)).astype(int)
    near = ((cell > -settings.grid) & (cell < 2 * settings.grid)).all(axis=1)
    filled = np.zeros((3 * settings.grid,) * 3, bool)
    place = tuple((cell[near] + settings.grid).T)
    filled[place] = True
    group = label(filled, np.ones((3, 3, 3)))[0][place]
    size_of = np.bincount(group, weight[rows][near])
    kept = size_of >= settings.part * size_of.max()
    seeds = rows.copy()
    seeds[rows] = False
    seeds[np.flatnonzero(rows)[near][kept[group]]] = True
    low, high = _bounds(means[seeds], weight[seeds])
    reach = settings.depth * float((high - low).max())
    distance = cKDTree(means[seeds]).query(means, distance_upper_bound=reach)[0]
    hull = ((votes.visible > 0) & (votes.inside >= lift.hull * votes.visible) & ~seen).numpy()
    return torch.from_numpy(seeds), torch.from_numpy(seeds | (hull & np.isfinite(distance)))


def _bounds(points: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the box that holds all but 4 % of the weight of points (P, 3) along each axis."""
    low, high = np.empty(3), np.empty(3)
    for axis in range(3):
        order = np.argsort(points[:, axis])
        share = np.cumsum(weight[order]) / max(float(weight.sum()), 1e-12)
        low[axis], high[axis] = np.interp([0.02, 0.98], share, points[order, axis])
    return low, high


def _propagated(
    source: Representation, view: View, seeds: torch.Tensor, candidates: torch.Tensor, lift: LiftSettings,
    settings: MaskPropagationSettings, effects: Effects,
) -> np.ndarray:  # fmt: skip
    """The mask of a view that is not marked."""
    import cv2

    diagonal = float(np.hypot(*view.pixels.shape[:2]))
    likely = object_mask(source, view.camera, candidates, lift, effects)
    inner = max(1, round(settings.sure * diagonal))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * inner + 1, 2 * inner + 1))
    shown = object_mask(source, view.camera, seeds, lift, effects).astype(np.uint8)
    surely = (cv2.erode(shown, disc) > 0) & likely
    return cut_along(view.pixels, surely, likely, max(2, round(settings.reach * diagonal)))


def overlay_sheet(
    views: Sequence[View], masks: Sequence[np.ndarray], settings: MaskPropagationSettings
) -> np.ndarray:
    """All views with their masks tinted and outlined, side by side, shape (H, W, 3), uint8."""
    import cv2

    tiles = []
    for view, mask in zip(views, masks, strict=True):
        height, width = mask.shape
        size = (max(1, round(width * settings.tile / height)), settings.tile)
        tile = cv2.resize(view.pixels, size, interpolation=cv2.INTER_AREA)
        inside = cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
        tile[inside > 0] = 0.6 * tile[inside > 0] + 0.4 * np.array(TINT)
        outline = cv2.findContours(inside, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
        cv2.drawContours(tile, outline, -1, (255, 255, 255), 1)
        for colour, thick in (((0, 0, 0), 3), ((255, 255, 255), 1)):
            place, font = (4, 14), cv2.FONT_HERSHEY_SIMPLEX
            cv2.putText(tile, view.name, place, font, 0.42, colour, thick, cv2.LINE_AA)
        tiles.append(tile)
    widest = max(tile.shape[1] for tile in tiles)
    tiles = [cv2.copyMakeBorder(t, 2, 2, 2, widest - t.shape[1] + 2, cv2.BORDER_CONSTANT) for t in tiles]
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % settings.columns)
    starts = range(0, len(tiles), settings.columns)
    return np.concatenate([np.concatenate(tiles[i : i + settings.columns], 1) for i in starts])
