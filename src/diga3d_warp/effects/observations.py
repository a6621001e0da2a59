"""Observations of the sparse points: colour, direction and sampling of each point in each view.

Readers keep no tracks, and half of the layouts have none. So whether a view sees a point is judged by the
points themselves: the image is cut into cells, and in each the second nearest point hides all that lie
clearly behind it. Where points are too sparse for that, a hidden point passes with a wrong colour; whoever
uses the colours must expect such outliers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from diga3d_warp.effects.thresholds import Thresholds
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.scene import Scene, View
from diga3d_warp.splatting.project import project

BORDER = 2.0
"""Points nearer to the image's border are not read [px]: the blur mirrors the image there."""


POINT_SIZE = 1e-5
"""Standard deviation of a point when it is projected [near planes]: far below a pixel at any depth."""


@dataclass(frozen=True, eq=False)
class Observations:
    """P points seen from V views.

    Attributes:
        colors: RGB in [0, 1], shape (V, P, 3), float64; NaN where the view does not see the point.
        directions: From the camera to the point, unit length, shape (V, P, 3), float64.
        sampling: Pixels per scene unit at the point, in the view's own image, shape (V, P); NaN as above.
    """

    colors: np.ndarray
    directions: np.ndarray
    sampling: np.ndarray

    @property
    def seen(self) -> np.ndarray:
        """Whether a view sees a point, shape (V, P), bool."""
        return np.isfinite(self.sampling)


def observe(scene: Scene, thresholds: Thresholds) -> Observations:
    """Read the colours of sparse points in the training views that see them.

    Args:
        scene: Only its training views are read.
        thresholds: How many views and points, and what hides what.
    """
    views = _spread(scene.views, thresholds.views_most)
    positions = np.asarray(_spread(scene.points.positions, thresholds.points_most), np.float64)
    placed = [_place(positions, view, thresholds) for view in views]
    count = np.zeros(len(positions), int)
    for pixels in placed:
        count += np.isfinite(pixels[:, 0])
    chosen = np.array(_spread(np.nonzero(count >= thresholds.views_least)[0], thresholds.points_read), int)
    shape = (len(views), len(chosen))
    colors, directions = np.full((*shape, 3), np.nan), np.zeros((*shape, 3))
    sampling = np.full(shape, np.nan)
    for row, (view, pixels) in enumerate(zip(views, placed, strict=True)):
        offsets = positions[chosen] - view.camera.center
        directions[row] = offsets / np.linalg.norm(offsets, axis=1, keepdims=True).clip(np.finfo(float).tiny)
        seen = np.nonzero(np.isfinite(pixels[chosen, 0]))[0]
        small = view.camera.within(thresholds.image_side)
        colors[row, seen] = _read(view.pixels, small, pixels[chosen[seen]], thresholds)
        depth = offsets[seen] @ view.camera.forward
        sampling[row, seen] = 0.5 * (view.camera.fx + view.camera.fy) / depth
    return Observations(colors, directions, sampling)


def _spread(items: Sequence | np.ndarray, most: int) -> Sequence | np.ndarray:
    """At most that many of them, evenly."""
    if len(items) <= most:
        return items
    rows = np.linspace(0, len(items) - 1, most).round().astype(int)
    return items[rows] if isinstance(items, np.ndarray) else [items[row] for row in rows]


def _place(positions: np.ndarray, view: View, thresholds: Thresholds) -> np.ndarray:
    """Pixels of points in the small image, shape (N, 2); NaN where outside, hidden, or not opaque."""
    small = view.camera.within(thresholds.image_side)
    local = small.relative_to(small.center)
    means = torch.from_numpy((positions - small.center).astype(np.float32))
    count = len(means)
    quaternions = means.new_tensor([1.0, 0.0, 0.0, 0.0]).expand(count, 4)
    with torch.no_grad():
        # Points are gaussians far smaller than a pixel: the projection follows the lens and culls.
        log_scales = means.new_full((count, 3), np.log(POINT_SIZE * small.near))
        points = project(means, log_scales, quaternions, means.new_zeros(count), local)
    pixels, depths = points.centers.numpy(), points.depths.numpy()
    high = np.array([small.width, small.height]) - BORDER
    inside = points.visible.numpy() & ((pixels > BORDER) & (pixels < high)).all(1)
    if view.alpha is not None:
        inside[inside] = _read(view.alpha, small, pixels[inside], thresholds) >= thresholds.opaque
    rows = np.nonzero(inside)[0]
    area = small.width * small.height
    side = max(np.sqrt(thresholds.points_per_cell * area / max(len(rows), 1)), thresholds.cell_side_least)
    seen = rows[_in_front(pixels[rows], depths[rows], side, thresholds.depth_tolerance)]
    placed = np.full((count, 2), np.nan)
    placed[seen] = pixels[seen]
    return placed


def _in_front(pixels: np.ndarray, depths: np.ndarray, side: float, tolerance: float) -> np.ndarray:
    """Whether points are not clearly behind the second nearest of their cell, shape (M,), bool."""
    cells = np.floor(pixels / side).astype(np.int64) @ np.array([1, 1 << 20])
    order = np.lexsort((depths, cells))
    sorted_cells = cells[order]
    first = np.searchsorted(sorted_cells, sorted_cells, side="left")
    last = np.searchsorted(sorted_cells, sorted_cells, side="right") - 1
    front = depths[order][np.minimum(first + 1, last)]
    visible = np.zeros(len(depths), bool)
    visible[order] = depths[order] <= (1.0 + tolerance) * front
    return visible


def _read(image: np.ndarray, small: Camera, pixels: np.ndarray, thresholds: Thresholds) -> np.ndarray:
    """An image, RGB or of one channel, at pixels (M, 2) of the small one: shape (M, 3) or (M,), in [0, 1]."""
    import cv2
    from scipy.ndimage import map_coordinates

    image = cv2.resize(image, (small.width, small.height), interpolation=cv2.INTER_AREA)
    image = cv2.GaussianBlur(image.astype(np.float32) / 255.0, (0, 0), thresholds.blur)
    places = pixels.T[::-1] - 0.5
    if image.ndim == 2:
        return map_coordinates(image, places, order=1)
    return np.stack([map_coordinates(image[..., k], places, order=1) for k in range(3)], axis=1)
