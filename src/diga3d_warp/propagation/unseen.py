"""What nobody saw: each view's mask shrunk to what no other view observes behind the object.

Follows the idea of 3DGIC: the background behind the object in one view stands beside the object in others.
There a photograph shows it, so it need not be invented. A point behind the object counts as observed by
another view if it is the first surface there (its depth agrees with that view's own), outside that view's
mask, and looked at from a similar direction: through a hole that the object left, a camera looks at the backs
of surfaces, whose fronts the others see.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.files import to_bytes
from diga3d_warp.scene.scene import View
from diga3d_warp.splatting.optics import optics_of
from diga3d_warp.splatting.reproject import locate


@dataclass(frozen=True)
class UnseenSettings:
    """When a pixel counts as observed.

    Attributes:
        depth_tolerance: Largest difference of depths that are the same surface [ratio]. The depth of a
            fitted splat wavers by about 1 % on textured ground; an object stands off by more.
        alpha_min: Least opacity of a depth that is believed. Below one half most of the light comes from
            behind the surface.
        angle_max: Largest angle between the two directions towards a point [degrees]. At 60 a surface that
            faces one camera at 30 still faces the other; beyond, its look changes too much to be reused.
        observers: How many views must observe a pixel, if there are as many. One alone may be fooled by a
            floater.
        blended: How many observations, from the nearest views, the median colour is taken of. Five outvote
            two wrong ones; more only blur.
        views_max: Nearest views that are asked. Bounds the time on large captures.
        closing: Radius by which gaps in the unseen region are closed [px at an image diagonal of 630].
        speck: Smallest unseen region that is kept, in the same measure squared [px^2]; smaller ones are gaps
            between samples and take their neighbours' colours.
    """

    depth_tolerance: float = 0.02
    alpha_min: float = 0.5
    angle_max: float = 60.0
    observers: int = 2
    blended: int = 5
    views_max: int = 32
    closing: float = 3.0
    speck: float = 40.0


@dataclass(frozen=True, eq=False)
class Background:
    """What is known of one view's background inside its mask.

    Attributes:
        unseen: True where nobody saw the background, shape (H, W), bool. A part of the mask.
        image: The view's photograph with observed background in the mask, shape (H, W, 3), float32 RGB in
            [0, 1]. Where `unseen`, the photograph is unchanged and still shows the object.
        observed: True where `image` was filled from other views, shape (H, W), bool: mask without `unseen`.
    """

    unseen: np.ndarray
    image: np.ndarray
    observed: np.ndarray


def observe_behind(
    views: Sequence[View],
    depths: Sequence[np.ndarray],
    alphas: Sequence[np.ndarray],
    settings: UnseenSettings | None = None,
) -> list[Background]:
    """Shrink every view's mask to what no other view saw, and fill the rest from those that did.

    Args:
        views: Views with masks (dilated already, so that no rim of the object is left outside them).
        depths: z of the splat without the object's gaussians, per view [scene units], each (H, W).
        alphas: Opacity of the same renders, each (H, W).
        settings: Thresholds.

    Raises:
        InputError: a view has no mask, or a depth or opacity does not fit its view.
    """
    settings = settings or UnseenSettings()
    for view, depth, alpha in zip(views, depths, alphas, strict=True):
        size = (view.camera.height, view.camera.width)
        if view.mask is None:
            raise InputError(f"view {view.name} has no mask: give every view one before looking behind them")
        if not size == view.mask.shape == depth.shape == alpha.shape:
            raise InputError(
                f"view {view.name} is {size[1]} x {size[0]} px, its mask {view.mask.shape[::-1]}, depth "
                f"{depth.shape[::-1]}, opacity {alpha.shape[::-1]}: all must have one size"
            )
    surfaces = [
        np.where((alpha >= settings.alpha_min) & np.isfinite(depth), depth, np.nan).astype(np.float32)
        for depth, alpha in zip(depths, alphas, strict=True)
    ]
    outside = [_clear_of(_mask(view)) for view in views]
    centers = np.stack([view.camera.center for view in views])
    backgrounds = []
    for i, view in enumerate(views):
        nearest = np.argsort(np.linalg.norm(centers - centers[i], axis=1), kind="stable")
        others = [int(j) for j in nearest if j != i][: settings.views_max]
        colors, seen = _observe(
            view, surfaces[i], [(views[j], surfaces[j], outside[j]) for j in others], settings
        )
        backgrounds.append(_assemble(view, colors, seen, settings))
    return backgrounds


def _mask(view: View) -> np.ndarray:
    assert view.mask is not None
    return view.mask.astype(bool)


def _clear_of(mask: np.ndarray) -> np.ndarray:
    """Pixels whose neighbours are all unmasked: samples between pixel centres there mix nothing in."""
    import cv2

    return cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) == 0


def _observe(
    view: View,
    surface: np.ndarray,
    others: Sequence[tuple[View, np.ndarray, np.ndarray]],
    settings: UnseenSettings,
) -> tuple[np.ndarray, np.ndarray]:
    """Median colour of the masked pixels, shape (P, 3), and which of them enough views saw, shape (P,)."""
    pixels = np.flatnonzero(_mask(view) & np.isfinite(surface))
    depth = surface.ravel()[pixels]
    samples = np.full((settings.blended, len(pixels), 3), np.inf, np.float32)
    count = np.zeros(len(pixels), np.int64)
    for other, other_surface, outside in others:
        active = np.flatnonzero(count < settings.blended)
        if not active.size:
            break
        found, colors = _look_up(view, pixels[active], depth[active], other, other_surface, outside, settings)
        taken = active[found]
        samples[count[taken], taken] = colors
        count[taken] += 1
    inside = np.flatnonzero(_mask(view))
    colors = np.zeros((len(inside), 3), np.float32)
    seen = np.zeros(len(inside), bool)
    enough = count >= max(min(settings.observers, len(others)), 1)
    position = np.searchsorted(inside, pixels[enough])
    ordered = np.sort(samples[:, enough], axis=0)
    middle, some = (count[enough] - 1) // 2, np.arange(int(enough.sum()))
    upper = count[enough] // 2
    colors[position] = 0.5 * (ordered[middle, some] + ordered[upper, some])
    seen[position] = True
    return colors, seen


def _look_up(
    view: View,
    pixels: np.ndarray,
    depth: np.ndarray,
    other: View,
    other_surface: np.ndarray,
    outside: np.ndarray,
    settings: UnseenSettings,
) -> tuple[np.ndarray, np.ndarray]:
    """Which points of `view` another view observes, as indices, and the colours that it sees there."""
    positions = locate(torch.from_numpy(pixels), torch.from_numpy(depth), view.camera, other.camera).numpy()
    height, width = outside.shape
    column, row = positions[:, 0] - 0.5, positions[:, 1] - 0.5
    with np.errstate(invalid="ignore"):
        found = np.flatnonzero((column >= 0) & (column <= width - 1) & (row >= 0) & (row <= height - 1))
    column, row, z = column[found], row[found], positions[found, 2]
    nearest = np.rint(row).astype(np.int64) * width + np.rint(column).astype(np.int64)
    agrees = np.abs(other_surface.ravel()[nearest] - z) <= settings.depth_tolerance * z
    agrees &= outside.ravel()[nearest]
    agrees &= _cosines(view, pixels[found], depth[found], other) >= np.cos(np.radians(settings.angle_max))
    found, column, row = found[agrees], column[agrees], row[agrees]
    return found, _bilinear(other.pixels, column, row)


def _cosines(view: View, pixels: np.ndarray, depth: np.ndarray, other: View) -> np.ndarray:
    """Cosine of the angle at each point between the directions from the two cameras, shape (P,)."""
    rays = optics_of(view.camera).rays[pixels]
    points = np.concatenate([rays, np.ones((len(rays), 1), np.float32)], axis=1) * depth[:, None]
    pose = view.camera.pose
    from_other = points - (pose[:3, :3] @ other.camera.center + pose[:3, 3])
    lengths = np.linalg.norm(points, axis=1) * np.linalg.norm(from_other, axis=1)
    return (points * from_other).sum(1) / np.maximum(lengths, 1e-30)


def _bilinear(image: np.ndarray, column: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Colours in [0, 1] at positions between the pixel centres of an 8-bit image, shape (P, 3)."""
    height, width = image.shape[:2]
    left = np.minimum(column.astype(np.int64), width - 2)
    top = np.minimum(row.astype(np.int64), height - 2)
    x, y = (column - left)[:, None], (row - top)[:, None]
    upper = (1 - x) * image[top, left] + x * image[top, left + 1]
    lower = (1 - x) * image[top + 1, left] + x * image[top + 1, left + 1]
    return (((1 - y) * upper + y * lower) / 255.0).astype(np.float32)


def _assemble(view: View, colors: np.ndarray, seen: np.ndarray, settings: UnseenSettings) -> Background:
    """Make the unseen region compact, and give the gaps in the observed one their neighbours' colours."""
    import cv2

    mask = _mask(view)
    scale = float(np.hypot(*mask.shape)) / 630.0
    unseen, image = mask.copy(), view.image.numpy()
    unseen[mask] = ~seen
    image[mask] = colors
    sampled = mask & ~unseen
    radius = max(round(settings.closing * scale), 1)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    unseen = _without_specks(unseen, settings.speck * scale**2)
    unseen = cv2.morphologyEx(unseen.astype(np.uint8), cv2.MORPH_CLOSE, disc).astype(bool) & mask
    observed = mask & ~unseen
    gaps = (observed & ~sampled).astype(np.uint8)
    if gaps.any():
        known = np.where(unseen[..., None], 0.0, image)
        filled = cv2.inpaint(to_bytes(known), gaps | unseen, radius, cv2.INPAINT_TELEA)
        image = np.where(gaps[..., None] > 0, filled.astype(np.float32) / 255.0, image)
    image[unseen] = view.pixels[unseen].astype(np.float32) / 255.0
    return Background(unseen, image, observed)


def _without_specks(region: np.ndarray, smallest: float) -> np.ndarray:
    import cv2

    count, label, stats, _ = cv2.connectedComponentsWithStats(region.astype(np.uint8), connectivity=8)
    keep = stats[:, cv2.CC_STAT_AREA] >= smallest
    keep[0] = False
    return keep[label] if count > 1 else region
