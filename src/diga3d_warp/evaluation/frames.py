"""Corrs of a run: correspondences between fixed pairs of frames of its result, its source and a baseline.

Two sets of pairs. Along a path: frames of the video that `diga3d render` makes, as the paper counts them.
Between views: neighbouring views of the capture. Their masks are known, so matches inside them are counted
apart, and so are those of views that are filled one by one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from diga3d_warp.evaluation.correspondences import LoftrMatcher, Matcher, SiftMatcher, count_matches
from diga3d_warp.evaluation.paths import fly_through
from diga3d_warp.evaluation.perceptual import NOT_MEASURED, checked
from diga3d_warp.evaluation.tables import Table
from diga3d_warp.priors.classical import telea_fill
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.masks.labels import stretched
from diga3d_warp.state import read_plane

Draw = Callable[[Camera], torch.Tensor]
"""Renders a camera to RGB, shape (H, W, 3)."""

FRAMES = 120
"""Frames of the path: the default of `diga3d render`."""

PATH_PAIRS = tuple((first, first + 5) for first in range(0, FRAMES, 10))
"""Pairs of frames along the path. Five frames are a 24th of it, about a step between views of a capture."""

VIEW_PAIRS = 12
"""Most pairs of neighbouring views, spread evenly over the capture."""

MATCHERS = (SiftMatcher.title, LoftrMatcher.title)

LONGEST = 1008
"""Longest side of a frame [px], that of SPIn-NeRF's images; larger ones are rendered at this size."""


def corrs_of_run(
    draws: Mapping[str, Draw],
    cameras: Mapping[str, Camera],
    masks: Path,
    matchers: Sequence[Matcher],
    *,
    fills: bool,
) -> dict[str, Any]:
    """Count correspondences of a run's frames.

    Args:
        draws: What is rendered, by its name in the table; the last one is that before the edit.
        cameras: The run's cameras by view, in the order of capture.
        masks: Folder with NAME.png of the masks that the run used; may lack any.
        matchers: Find the correspondences.
        fills: Whether to fill each view's mask alone by Telea, as what a removal is compared with.

    Returns:
        JSON data: size of the frames, and rows with title, pairs and the mean matches of a pair by matcher;
        no rows without cameras.

    Raises:
        InputError: what is rendered holds NaN or infinity.
    """
    if not cameras:
        return {"size": [0, 0], "rows": []}
    small = {name: _fitting(camera) for name, camera in cameras.items()}
    path = [_fitting(camera) for camera in fly_through(list(cameras.values()), FRAMES)]
    rows = []
    for title, draw in draws.items():
        frames = {index: checked(draw(path[index])) for pair in PATH_PAIRS for index in pair}
        rows.append(_row(f"{title}, along a path", PATH_PAIRS, frames, None, matchers))
    names = list(small)
    pairs = _neighbours(len(names))
    used = sorted({index for pair in pairs for index in pair})
    inside = {index: _mask(masks / f"{names[index]}.png", small[names[index]]) for index in used}
    seen = inside if any(mask.any() for mask in inside.values()) else None
    if pairs:
        for title, draw in draws.items():
            frames = {index: checked(draw(small[names[index]])) for index in used}
            rows.append(_row(f"{title}, between views", pairs, frames, seen, matchers))
        if fills and seen is not None:  # `frames` are those before the edit
            filled = {index: telea_fill(frames[index], torch.from_numpy(inside[index])) for index in frames}
            rows.append(_row("Telea on each view, between views", pairs, filled, seen, matchers))
    first = path[0]
    return {"size": [first.width, first.height], "rows": rows}


def corrs_table(figures: Mapping[str, Any], missing: Mapping[str, str]) -> Table:
    """The table of what `corrs_of_run` counted; matchers that are missing have cells that say so."""
    titles = list(dict.fromkeys(title for row in figures["rows"] for title in row["matches"]))
    columns, cells = ["frames", "pairs"], [[row["title"], str(row["pairs"])] for row in figures["rows"]]
    for title in [*titles, *(title for title in MATCHERS if title in missing)]:
        columns += [title, "in the mask"]
        for row, line in zip(figures["rows"], cells, strict=True):
            found = row["matches"].get(title)
            if found is None:
                line += [NOT_MEASURED, NOT_MEASURED]
            else:
                masked = found["masked"]
                line += [f"{found['whole']:.1f}", "–" if masked is None else f"{masked:.1f}"]
    width, height = figures["size"]
    return Table(f"Corrs: mean matches of a pair of frames, {width} x {height} px", columns, cells)


def _row(
    title: str,
    pairs: Sequence[tuple[int, int]],
    frames: Mapping[int, torch.Tensor],
    masks: Mapping[int, np.ndarray] | None,
    matchers: Sequence[Matcher],
) -> dict[str, Any]:
    found = {matcher.title: count_matches(matcher, pairs, frames, masks) for matcher in matchers}
    matches = {name: {"whole": corrs.whole, "masked": corrs.masked} for name, corrs in found.items()}
    return {"title": title, "pairs": len(pairs), "matches": matches}


def _neighbours(count: int) -> list[tuple[int, int]]:
    """Pairs of views in a row, at most `VIEW_PAIRS`; none of a single view."""
    if count < 2:
        return []
    starts = np.unique(np.linspace(0, count - 2, VIEW_PAIRS).round().astype(int))
    return [(int(first), int(first) + 1) for first in starts]


def _fitting(camera: Camera) -> Camera:
    scale = LONGEST / max(camera.width, camera.height)
    if scale >= 1.0:
        return camera
    return camera.resized(max(round(scale * camera.width), 1), max(round(scale * camera.height), 1))


def _mask(path: Path, camera: Camera) -> np.ndarray:
    """The mask that the run used for a view, shape (H, W), bool; empty if it used none."""
    if not path.is_file():
        return np.zeros((camera.height, camera.width), bool)
    return stretched(read_plane(path), camera.width, camera.height) > 127
