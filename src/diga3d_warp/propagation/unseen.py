"""Shrink each view's mask to the pixels behind the object that no other view observes.

Follows the idea of 3DGIC: the background behind the object in one view is beside the object in others.
There a photograph shows it, so it need not be inpainted. A point behind the object counts as observed by
another view if it is the first surface there (its depth agrees with that view's own), outside that view's
mask, and seen from a similar direction: through the hole that the object left, a camera may see the back
of a surface whose front the other views see.

Where photographs are transparent there may be nothing behind the object, and then nothing is inpainted. This
holds where the scene without the object is transparent and the transparent region reaches the transparent
part of the photograph. A transparent region enclosed by surfaces is a hole that the object left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
import warp as wp

from diga3d_warp.errors import InputError
from diga3d_warp.files import to_bytes
from diga3d_warp.kernels.observation import look_up
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.photographs.images import BACKGROUND
from diga3d_warp.scene.scene import View
from diga3d_warp.splatting.reproject import motion_between

OPAQUE = 242
"""Opacity from which a pixel of a photograph counts as all surface, of 255: 95 %. Mattes of cut-out things
waver by some levels; a rim lets half of the background through."""


@dataclass(frozen=True)
class UnseenSettings:
    """Thresholds for counting a pixel as observed.

    Attributes:
        depth_tolerance: Largest difference of depths that are the same surface [ratio]. The depth of a
            fitted splat wavers by about 1 % on textured ground; an object stands off by more.
        alpha_min: Least opacity at which a depth is used. Below one half most of the light comes from
            behind the surface.
        angle_max: Largest angle between the two directions towards a point [degrees]. At 60 a surface that
            faces one camera at 30 still faces the other; beyond, its appearance changes too much.
        observers: How many views must observe a pixel, if there are as many. One alone may be fooled by a
            floater.
        blended: How many observations, from the nearest views, the median colour is taken of. Five outvote
            two wrong ones; more only blur.
        views_max: Number of nearest views that are searched. Bounds the time on large captures.
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
    """The observed background inside the mask of one view.

    Attributes:
        unseen: True where no view saw the background, shape (H, W), bool. A part of the mask.
        image: The view's photograph with observed background in the mask, shape (H, W, 3), float32 RGB in
            [0, 1]. Where `unseen`, the photograph is unchanged and still shows the object.
        observed: True where `image` was filled from other views or shows that nothing is there, shape
            (H, W), bool: mask without `unseen`.
        alpha: Opacity without the object, shape (H, W), uint8: 0 in the mask where nothing is behind the
            object; None if the view has no alpha.
    """

    unseen: np.ndarray
    image: np.ndarray
    observed: np.ndarray
    alpha: np.ndarray | None = None


def observe_behind(
    views: Sequence[View],
    edit_masks: Sequence[np.ndarray],
    depths: Sequence[np.ndarray],
    alphas: Sequence[np.ndarray],
    settings: UnseenSettings | None = None,
) -> list[Background]:
    """Shrink every view's mask to what no other view saw, and fill the rest from those that did.

    Args:
        views: Views; their own masks are not read.
        edit_masks: Masks of the object, dilated so that no rim of it is left outside, each (H, W), bool.
        depths: z of the splat without the object's gaussians, per view [scene units], each (H, W).
        alphas: Opacity of the same renders, each (H, W).
        settings: Thresholds of what counts as observed.

    Raises:
        InputError: a mask, a depth or an opacity does not fit its view.
    """
    settings = settings or UnseenSettings()
    for view, mask, depth, alpha in zip(views, edit_masks, depths, alphas, strict=True):
        size = (view.camera.height, view.camera.width)
        if not size == mask.shape == depth.shape == alpha.shape:
            raise InputError(
                f"view {view.name} is {size[1]} x {size[0]} px, its mask {mask.shape[::-1]}, depth "
                f"{depth.shape[::-1]}, opacity {alpha.shape[::-1]}: all must have one size"
            )
    surfaces = [
        np.where((alpha >= settings.alpha_min) & np.isfinite(depth), depth, np.nan).astype(np.float32)
        for depth, alpha in zip(depths, alphas, strict=True)
    ]
    observing = [
        _observer(view, mask, surface)
        for view, mask, surface in zip(views, edit_masks, surfaces, strict=True)
    ]
    centers = np.stack([view.camera.center for view in views])
    backgrounds = []
    for i, (view, mask) in enumerate(zip(views, edit_masks, strict=True)):
        nearest = np.argsort(np.linalg.norm(centers - centers[i], axis=1), kind="stable")
        others = [observing[j] for j in nearest if j != i][: settings.views_max]
        found = _assemble(view, mask, *_observe(view, mask, surfaces[i], others, settings), settings)
        if view.alpha is not None:
            found = _with_nothing(found, view, mask, alphas[i], settings)
        backgrounds.append(found)
    return backgrounds


def _clear(view: View, mask: np.ndarray) -> np.ndarray:
    """Pixels whose neighbours are all unmasked and opaque: samples between their centres mix nothing in."""
    import cv2

    hidden = mask if view.alpha is None else mask | (view.alpha < OPAQUE)
    return cv2.dilate(hidden.astype(np.uint8), np.ones((3, 3), np.uint8)) == 0


@dataclass(frozen=True, eq=False)
class _Observer:
    """A view searched by others: its camera, and as Warp arrays its depth, usable pixels and photograph."""

    camera: Camera
    surface: wp.array
    clear: wp.array
    image: wp.array


def _observer(view: View, mask: np.ndarray, surface: np.ndarray) -> _Observer:
    return _Observer(
        view.camera,
        wp.array(surface, dtype=wp.float32, device="cpu", copy=False),
        wp.array(_clear(view, mask), dtype=wp.bool, device="cpu", copy=False),
        wp.array(np.ascontiguousarray(view.pixels), dtype=wp.vec3ub, device="cpu", copy=False),
    )


def _observe(
    view: View, mask: np.ndarray, surface: np.ndarray, others: Sequence[_Observer], settings: UnseenSettings
) -> tuple[np.ndarray, np.ndarray]:
    """Median colour of the masked pixels, shape (P, 3), and which of them enough views saw, shape (P,)."""
    depth: wp.array = wp.array(surface[mask], dtype=wp.float32, device="cpu")
    count = wp.zeros(depth.size, dtype=int, device="cpu")
    samples = wp.full((settings.blended, depth.size), wp.vec3(np.inf), dtype=wp.vec3, device="cpu")
    rays: wp.array | None = None
    for other in others:
        motion = motion_between(view.camera, other.camera, torch.device("cpu"))
        if rays is None:
            rays = wp.array(motion.rays.numpy()[mask.ravel()], dtype=wp.vec2d, device="cpu")
        look_up(
            depth, replace(motion, rays=rays), other.surface, other.clear, other.image,
            settings.depth_tolerance, float(np.cos(np.radians(settings.angle_max))), count, samples,
        )  # fmt: skip
    found = count.numpy()
    seen = found >= max(min(settings.observers, len(others)), 1)
    ordered, each = np.sort(samples.numpy()[:, seen], axis=0), np.arange(int(seen.sum()))
    colors = np.zeros((len(found), 3), np.float32)
    colors[seen] = 0.5 * (ordered[(found[seen] - 1) // 2, each] + ordered[found[seen] // 2, each])
    return colors, seen


def _assemble(
    view: View, mask: np.ndarray, colors: np.ndarray, seen: np.ndarray, settings: UnseenSettings
) -> Background:
    """Make the unseen region compact, and give the gaps in the observed one their neighbours' colours."""
    import cv2

    scale = _scale(mask)
    unseen, image = mask.copy(), view.image.numpy()
    unseen[mask] = ~seen
    image[mask] = colors
    sampled = mask & ~unseen
    disc = _disc(settings, mask)
    unseen = _without_specks(unseen, settings.speck * scale**2)
    unseen = cv2.morphologyEx(unseen.astype(np.uint8), cv2.MORPH_CLOSE, disc).astype(bool) & mask
    observed = mask & ~unseen
    gaps = (observed & ~sampled).astype(np.uint8)
    if gaps.any():
        known = np.where(unseen[..., None], 0.0, image)
        filled = cv2.inpaint(to_bytes(known), gaps | unseen, len(disc) // 2, cv2.INPAINT_TELEA)
        image = np.where(gaps[..., None] > 0, filled.astype(np.float32) / 255.0, image)
    image[unseen] = view.pixels[unseen].astype(np.float32) / 255.0
    return Background(unseen, image, observed)


def _with_nothing(
    found: Background, view: View, mask: np.ndarray, alpha: np.ndarray, settings: UnseenSettings
) -> Background:
    """What is known behind the object, where there may be nothing; `alpha` is that of the cleared scene."""
    import cv2

    own = view.opacity
    outside = ~mask & (own < 128)
    solid = np.where(mask, alpha >= settings.alpha_min, own >= 128).astype(np.uint8)
    # Small unseen specks and spikes are remains of the object.
    opened = cv2.morphologyEx(solid, cv2.MORPH_OPEN, _disc(settings, mask))
    crumbs = (opened == 0) & ~found.observed
    through = outside | (mask & ((alpha < settings.alpha_min) | crumbs))
    _, label = cv2.connectedComponents(through.astype(np.uint8), connectivity=4)
    nothing = mask & through & np.isin(label, label[outside])
    image = np.where(nothing[..., None], np.array(BACKGROUND, np.float32), found.image)
    opacity = np.where(mask, np.where(nothing, 0, 255), own).astype(np.uint8)
    return Background(found.unseen & ~nothing, image, mask & (found.observed | nothing), opacity)


def _scale(mask: np.ndarray) -> float:
    """The diagonal of an image of the mask's size, in that for which `UnseenSettings` gives lengths."""
    return float(np.hypot(*mask.shape)) / 630.0


def _disc(settings: UnseenSettings, mask: np.ndarray) -> np.ndarray:
    """The disc by which gaps are closed, and crumbs opened, in an image of the mask's size."""
    import cv2

    radius = max(round(settings.closing * _scale(mask)), 1)
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))


def _without_specks(region: np.ndarray, smallest: float) -> np.ndarray:
    import cv2

    count, label, stats, _ = cv2.connectedComponentsWithStats(region.astype(np.uint8), connectivity=8)
    keep = stats[:, cv2.CC_STAT_AREA] >= smallest
    keep[0] = False
    return keep[label] if count > 1 else region
