"""Multi-view consistency: whether a surface has the same colours in all views.

Each view's region is warped into its neighbours by DIBR (paper Eq. 5) and compared with what they show
there. It needs no ground truth, so it applies to inpainted views before any fit as well as to renderings of
a splat. It does not measure quality: uniform grey fills are consistent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.reproject import reproject

NEIGHBOURS = 4
"""Number of views with which each is compared: two on either side along a handheld path."""

SAME_SURFACE = 0.02
"""Largest difference between the depth warped in and the target's own of one surface [share of the latter].
Above the 1 % error of a fitted splat's depth, below the distance between objects in a room."""


@dataclass(frozen=True)
class Disagreement:
    """How far the views of a scene differ where they show the same surface.

    Attributes:
        difference: Mean absolute difference over compared pixels and channels [levels of 255]; NaN without
            pixels. Even images of one unchanging scene have some: warping resamples, and a pixel covers
            another patch of the surface in each view.
        pixels: How many pixels were compared, each once for every neighbour it is seen from.
    """

    difference: float
    pixels: int


def disagreement(
    cameras: Sequence[Camera],
    images: Sequence[np.ndarray],
    depths: Sequence[np.ndarray],
    regions: Sequence[np.ndarray],
    neighbours: int = NEIGHBOURS,
) -> Disagreement:
    """Compare each view's region with what its neighbours show of the same surface.

    A pixel is compared where the surface of the region lands on a neighbour's pixel and is the one that the
    neighbour shows there, by depth: what one of the two hides is left out. Where several parts of the region
    land on one pixel, the nearest counts. The neighbour's own region does not matter, for a fill must agree
    with what others saw, too.

    Args:
        cameras: One per view, at least two.
        images: RGB in [0, 1], one per view, shape (H, W, 3), float32.
        depths: z along each camera's axis [scene units], shape (H, W), float32; 0 where unknown.
        regions: Pixels of each view to compare, shape (H, W), bool; may be empty.
        neighbours: With how many views each is compared, those whose centres are nearest; all if there are
            fewer.

    Raises:
        InputError: fewer than two views, lists of different lengths, or sizes that do not fit.
    """
    counts = {len(cameras), len(images), len(depths), len(regions)}
    if len(counts) > 1 or len(cameras) < 2:
        raise InputError(
            f"{len(cameras)} cameras, {len(images)} images, {len(depths)} depths and {len(regions)} regions: "
            "give one of each for at least two views"
        )
    total, pixels = 0.0, 0
    for source, target in _pairs(cameras, neighbours):
        surface = np.where(regions[source], depths[source], 0.0).astype(np.float32)
        if not surface.any():
            continue
        warp = reproject(
            torch.from_numpy(np.ascontiguousarray(images[source], np.float32)),
            torch.from_numpy(surface),
            cameras[source],
            cameras[target],
        )
        own = depths[target]
        shown = warp.visible.numpy() & (np.abs(warp.depth.numpy() - own) <= SAME_SURFACE * own)
        difference = np.abs(warp.image.numpy()[shown] - images[target][shown])
        total += float(difference.mean(-1, dtype=np.float64).sum())
        pixels += int(shown.sum())
    return Disagreement(255.0 * total / pixels if pixels else float("nan"), pixels)


def _pairs(cameras: Sequence[Camera], neighbours: int) -> list[tuple[int, int]]:
    """Each view with each of its neighbours, nearest first; of equals, the earlier."""
    centers = np.stack([camera.center for camera in cameras])
    distances = np.linalg.norm(centers[:, None] - centers, axis=-1)
    np.fill_diagonal(distances, -1.0)
    nearest = np.argsort(distances, axis=1, kind="stable")[:, 1 : 1 + neighbours]
    return [(view, int(other)) for view in range(len(cameras)) for other in nearest[view]]


def depth_errors(
    depths: Sequence[np.ndarray], truths: Sequence[np.ndarray], regions: Sequence[np.ndarray]
) -> np.ndarray:
    """Relative error |z - z*| / z* of each pixel of the regions, all views in one row, shape (P,).

    Nothing is aligned: the scale is part of the answer. Where nothing is shown, z = 0 and the error is 1.

    Args:
        depths: z along each camera's axis [scene units], shape (H, W); 0 where nothing is shown.
        truths: True z, positive, shape (H, W).
        regions: Pixels that count, shape (H, W), bool.
    """
    parts = [
        np.abs(depth[region].astype(np.float64) - truth[region]) / truth[region]
        for depth, truth, region in zip(depths, truths, regions, strict=True)
    ]
    return np.concatenate(parts) if parts else np.zeros(0)
