"""The object on its support, in a few small views: where its shadow and its mirror image are looked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch

from diga3d_warp.gaussians.lift import LiftSettings, object_mask
from diga3d_warp.gaussians.representation import Representation
from diga3d_warp.pipelines.clearing import Masks, MaskSettings, widened
from diga3d_warp.pipelines.run import Run
from diga3d_warp.propagation.unseen import OPAQUE
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.scene import Scene, View
from diga3d_warp.shadows.settings import SHADOWS
from diga3d_warp.shadows.support import Solid, Support, find_support, on_floor
from diga3d_warp.splatting.render import render
from diga3d_warp.surfaces.evidence import gather
from diga3d_warp.surfaces.photo import Photo
from diga3d_warp.surfaces.planes import find_planes, mean_eye
from diga3d_warp.surfaces.settings import SURFACES

SEARCH = replace(SURFACES, points=9000, trials=200, planes=3)
"""Search of the support: it holds a large part of what is around the object, so fewer points find it."""


@dataclass(frozen=True, eq=False)
class Standing:
    """An object on its support.

    Attributes:
        photos: Some views, small, the object taken out.
        own: The object's gaussians, without support that its masks hold, shape (N,), bool.
        held: That support, shape (N,), bool.
        support: What it stands on; None if nothing is found under it.
    """

    photos: list[Photo]
    own: torch.Tensor
    held: torch.Tensor
    support: Support | None


@dataclass(frozen=True, eq=False)
class Masked:
    """The object as its masks mark it.

    Attributes:
        run: With the effects with which gaussians are rendered.
        scene: The capture.
        edit_masks: Of all views.
        source: The splat, N gaussians or anchors.
        rows: Those of the object, shape (N,).
        lift: When a gaussian belongs to what is masked, and where it is in the way.
        masking: Dilation of the masks.
        seed: Of random choices.
    """

    run: Run
    scene: Scene
    edit_masks: Masks
    source: Representation
    rows: torch.Tensor
    lift: LiftSettings
    masking: MaskSettings
    seed: int

    @property
    def views(self) -> list[View]:
        """All views, those that are held out last."""
        return [*self.scene.views, *self.scene.test_views]

    @cached_property
    def standing(self) -> Standing:
        """The object on its support."""
        return self.standing_beside(None)

    def standing_beside(self, image: Masks | None) -> Standing:
        """The same, where views show a mirror image that is not the support's own."""
        source, rows = self.source, self.rows
        chosen = [self.scene.views[row] for row in _spread(len(self.scene.views))]
        small = [view.camera.within(SHADOWS.side) for view in chosen]

        def resized(masks: Masks) -> list[np.ndarray]:
            return [_resized(masks[view.name], camera) for view, camera in zip(chosen, small, strict=True)]

        beside = resized(image or {view.name: np.zeros_like(self.edit_masks[view.name]) for view in chosen})

        def photos(masks: Sequence[np.ndarray], left: Representation) -> list[Photo]:
            whole = [mask | more for mask, more in zip(masks, beside, strict=True)]
            return _photos(self.run, chosen, small, whole, left)

        masks = resized(self.edit_masks)
        first = photos(masks, source.select(~rows))
        points = gather(first, self.scene.points.positions, self.seed, SEARCH)
        planes = find_planes(points, mean_eye(small), self.seed, SEARCH)
        solid = solid_of(source.select(rows))
        support, held = find_support(solid, planes, small), torch.zeros_like(rows)
        if support is None:
            return Standing(first, rows, held, None)
        held[rows] = torch.from_numpy(on_floor(solid, support))
        if not held.any():
            return Standing(first, rows, held, support)
        own = rows & ~held
        masks = [mask & self.about(own, camera) for mask, camera in zip(masks, small, strict=True)]
        return Standing(photos(masks, source.select(~own)), own, held, support)

    def about(self, own: torch.Tensor, camera: Camera) -> np.ndarray:
        """Where a view shows the object's own gaussians, and twice as far around as masks are widened."""
        shown = object_mask(self.source, camera, own, self.lift, self.run.effects)
        return widened(widened(shown, self.masking), self.masking)


def solid_of(gaussians: Representation) -> Solid:
    """Gaussians or anchors as points."""
    return Solid(
        gaussians.means.double().numpy(),
        np.sort(gaussians.scales.numpy(), axis=1)[:, 1],
        gaussians.opacities.numpy(),
    )


def _spread(count: int) -> np.ndarray:
    return np.linspace(0, count - 1, min(SHADOWS.views, count)).round().astype(int)


def _resized(mask: np.ndarray, camera: Camera) -> np.ndarray:
    """A mask at the size of a camera: whatever it touches."""
    import cv2

    size = (camera.width, camera.height)
    return cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.0


def _photos(
    run: Run,
    views: Sequence[View],
    cameras: Sequence[Camera],
    masks: Sequence[np.ndarray],
    left: Representation,
) -> list[Photo]:
    import cv2

    photos = []
    for view, camera, mask in zip(views, cameras, masks, strict=True):
        with torch.no_grad():
            seen = render(left, camera, effects=replace(run.effects, depth=True))
        depth = np.where(seen.alpha.numpy() > 0.5, seen.depth.numpy(), 0.0).astype(np.float32)
        size = (camera.width, camera.height)
        pixels = cv2.resize(view.pixels, size, interpolation=cv2.INTER_AREA)
        opaque = cv2.resize(view.opacity, size, interpolation=cv2.INTER_AREA) >= OPAQUE
        photos.append(Photo(camera, pixels, depth, ~mask & opaque, mask))
    return photos
