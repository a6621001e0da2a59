"""Lift 2D masks to gaussians through their blending weights over all views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from diga3d_warp.config import Effects
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.gaussians.representation import Drawn, Representation
from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.attribution import shares
from diga3d_warp.splatting.composite import composite
from diga3d_warp.splatting.project import Projection, project

SHOWN = 1e-3
"""Blending weight over all views from which a gaussian has a colour of its own [pixels]."""

COLOR_ALONE = Effects(depth=False)


@dataclass(frozen=True)
class LiftSettings:
    """When a gaussian belongs to the masked object.

    Attributes:
        share: Part of its blending weight that falls into masks. Half is the vote of the majority of pixels.
        faint: Weight over all views under which a gaussian was never really seen [pixels at full opacity]:
            the inside of the object. Once its surface is gone, it would come to light.
        hull: Part of the views whose mask a faint gaussian's centre must lie in, of those that have it in the
            image, to belong to the object: it lies in the visual hull.
        free_share: Part of its weight in widened masks from which a remaining gaussian takes part in the
            refit. Below, it shows elsewhere, and must not move.
        opacity: Part of a pixel that the object must cover to be in its mask.
        overlap: Least part that the user's mask of a view and the object's own have in common, of what either
            covers [1]. A fit of 60 iterations reaches 0.3 in its worst view; masks of other photographs have
            nothing in common.
    """

    share: float = 0.5
    faint: float = 1.0
    hull: float = 0.9
    free_share: float = 0.05
    opacity: float = 0.5
    overlap: float = 0.1


@dataclass(frozen=True, eq=False)
class Votes:
    """Blending weights of each gaussian, or of each anchor's gaussians, summed over all views.

    Attributes:
        masked: Blending weight inside masks, summed over views [pixels], shape (N,).
        total: Blending weight, summed over views [pixels], shape (N,).
        inside: Views whose mask holds the centre, shape (N,).
        visible: Views whose image holds the centre, shape (N,).
    """

    masked: torch.Tensor
    total: torch.Tensor
    inside: torch.Tensor
    visible: torch.Tensor

    @property
    def share(self) -> torch.Tensor:
        """Part of each gaussian's weight that falls into masks, in [0, 1]; 0 for one never seen."""
        return self.masked / self.total.clamp_min(1e-12)


def vote(
    scene: Representation,
    cameras: Sequence[Camera],
    masks: Sequence[np.ndarray],
    effects: Effects = Effects(),
) -> Votes:
    """Count the blending weights of gaussians inside and outside masks.

    Args:
        scene: N gaussians, or anchors, whose gaussians' votes are theirs.
        cameras: One per view.
        masks: One per view, shape (H, W), bool.
        effects: With which the gaussians are rendered.
    """
    return _votes(scene, cameras, masks, effects, len(scene))


def divided(
    scene: Representation,
    cameras: Sequence[Camera],
    masks: Sequence[np.ndarray],
    settings: LiftSettings,
    effects: Effects = Effects(),
) -> Representation:
    """The same scene, where no anchor has gaussians of the masked object and others; arguments as `vote`."""
    if scene.slots == 1:
        return scene
    votes = _votes(scene, cameras, masks, effects, len(scene) * scene.slots)
    return scene.divided(object_rows(votes, settings), votes.total > SHOWN)


def _votes(
    scene: Representation,
    cameras: Sequence[Camera],
    masks: Sequence[np.ndarray],
    effects: Effects,
    count: int,
) -> Votes:
    """Votes of the rows of a scene, or of the `count` gaussians that these can have."""
    masked, total, inside, visible = torch.zeros(4, count).unbind()
    for camera, mask in zip(cameras, masks, strict=True):
        drawn, projection = _projected(scene, camera, effects)
        if count != len(scene):
            drawn = drawn._replace(owners=drawn.slots)
        taken = shares(projection, torch.from_numpy(mask.astype(np.float32))[..., None].expand(-1, -1, 3))
        masked = masked + drawn.by_row(taken.sums[:, 0], count)
        total = total + drawn.by_row(taken.weights, count)
        in_image, in_mask = _centers_in(projection, mask)
        visible = visible + (drawn.by_row(in_image.float(), count) > 0.0)
        inside = inside + (drawn.by_row(in_mask.float(), count) > 0.0)
    return Votes(masked, total, inside, visible)


def object_rows(votes: Votes, settings: LiftSettings) -> torch.Tensor:
    """Which gaussians belong to the masked object, shape (N,), bool."""
    seen = votes.total > settings.faint
    in_hull = (votes.visible > 0) & (votes.inside >= settings.hull * votes.visible)
    return torch.where(seen, votes.share > settings.share, in_hull)


def object_share(
    scene: Representation, camera: Camera, rows: torch.Tensor, effects: Effects = Effects()
) -> torch.Tensor:
    """Part of each pixel that the gaussians in `rows` (N,) take, behind the gaussians in front, (H, W)."""
    drawn, projection = _projected(scene, camera, effects)
    colors = drawn.of_rows(rows).to(torch.float32)[:, None].repeat(1, 3)
    return composite(projection, colors, camera.width, camera.height, effects=COLOR_ALONE).color[..., 0]


def object_mask(
    scene: Representation,
    camera: Camera,
    rows: torch.Tensor,
    settings: LiftSettings,
    effects: Effects = Effects(),
) -> np.ndarray:
    """Where the gaussians in `rows` (N,) show in a camera, in front of the others, shape (H, W), bool."""
    return (object_share(scene, camera, rows, effects) > settings.opacity).numpy()


def lies_elsewhere(mask: np.ndarray, shown: np.ndarray, settings: LiftSettings) -> bool:
    """Whether a user's mask (H, W) marks something else than the object's own mask of that view."""
    return bool(mask.any()) and (mask & shown).sum() < settings.overlap * (mask | shown).sum()


def lifted_colors(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    images: Sequence[np.ndarray],
    masks: Sequence[np.ndarray],
    effects: Effects = Effects(),
    among: Representation | None = None,
) -> torch.Tensor:
    """Mean colour of the masked pixels that each gaussian shows in, by blending weight, shape (N, 3).

    Args:
        gaussians: N gaussians.
        cameras: One per view.
        images: One per view, RGB in [0, 1], shape (H, W, 3).
        masks: One per view, shape (H, W), bool.
        effects: With which the gaussians are rendered.
        among: What else there is, which hides them or is hidden; of as many harmonics.

    Returns:
        Colours; for a gaussian that shows in no mask the mean of all others.
    """
    sums, total = torch.zeros(len(gaussians), 3), torch.zeros(len(gaussians), 1)
    for camera, image, mask in zip(cameras, images, masks, strict=True):
        inside = torch.from_numpy(mask.astype(np.float32))[..., None].expand(-1, -1, 3)
        around = gaussians if among is None else among.seen_from(camera).joined(gaussians)
        projection, mine = _projected(around, camera, effects)[1], slice(len(around) - len(gaussians), None)
        sums += shares(projection, torch.from_numpy(image) * inside).sums[mine]
        total += shares(projection, inside).sums[mine, :1]
    mean = sums.sum(dim=0) / total.sum().clamp_min(1e-12)
    return torch.where(total > SHOWN, sums / total.clamp_min(SHOWN), mean)


def _projected(scene: Representation, camera: Camera, effects: Effects) -> tuple[Drawn, Projection]:
    with torch.no_grad():
        drawn = scene.drawn_in(camera)
        gaussians = drawn.gaussians
        return drawn, project(
            gaussians.means, gaussians.log_scales, gaussians.quaternions, gaussians.opacity_logits, camera,
            effects=effects,
        )  # fmt: skip


def _centers_in(projection: Projection, mask: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
    """Whether each gaussian's centre lies in the image, and in the mask, both shape (N,), bool."""
    height, width = mask.shape
    x, y = projection.centers.floor().long().unbind(dim=1)
    in_image = projection.visible & (x >= 0) & (x < width) & (y >= 0) & (y < height)
    rows = torch.where(in_image, y * width + x, 0)
    return in_image, in_image & torch.from_numpy(mask).reshape(-1)[rows]
