"""Exposure: an affine colour transform of each image, found beside the gaussians.

Phones change exposure and white balance from view to view. Without transforms, gaussians explain that by
floating in front of single cameras, or by harmonics.

A transform has 12 numbers and an image has many thousand pixels: each time an image is rendered, its best
transform is known in closed form. Adam would move it by its learning rate instead, whose noise of 1 % is as
large as the drift of most captures.

The gaussians and the transforms could trade a common colour change, and by their harmonics one that follows
the camera's place and direction. So transforms hold neither: their mean is the identity, and over the images
they are orthogonal to linear functions of place and direction. A rendering of a new view, to which no
transform belongs, then has the look of the photographs around it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.photographs.images import BACKGROUND


@dataclass(frozen=True)
class ExposureSettings:
    """Settings of the exposure fit.

    Attributes:
        begin: Part of the iterations before the first update: a rendering must resemble its image.
        share: Part of the way to the best transform that one update goes. Half, so that a bad rendering does
            not take its image along.
        identity_weight: Weight of the squared distance to the identity, against squared errors of colours.
            It equals the variance of colours that is needed to move a gain half of the way: 8 levels squared.
        views_per_function: Images for each function of place and direction that is taken out of the
            transforms. With fewer, little else would be left of them; then only the mean is.
        rank_least: Functions weaker than this against the strongest are none [ratio].
        gain_least: Smallest singular value of a gain that is undone. Below, noise would be amplified.
    """

    begin: float = 0.15
    share: float = 0.5
    identity_weight: float = 1e-3
    views_per_function: int = 4
    rank_least: float = 1e-3
    gain_least: float = 0.25


SETTINGS = ExposureSettings()

IDENTITY = torch.eye(3, 4)
"""Gain 1 and offset 0: the left 3 x 3 part multiplies a colour, the last column is added."""


def exposed(color: torch.Tensor, transform: torch.Tensor) -> torch.Tensor:
    """An image as one exposure shows it, shape (H, W, 3); gradients reach both arguments.

    Args:
        color: RGB, shape (H, W, 3).
        transform: Gain and offset, shape (3, 4).
    """
    return color @ transform[:, :3].T + transform[:, 3]


def unexposed(color: torch.Tensor, transform: torch.Tensor) -> torch.Tensor:
    """Colours that one exposure shows as these, shape (..., 3): the inverse of `exposed`."""
    return (color - transform[:, 3]) @ torch.linalg.inv(transform[:, :3]).T


def best_transform(
    color: torch.Tensor, photograph: torch.Tensor, weight: torch.Tensor | None, present: torch.Tensor,
    alpha: torch.Tensor | None = None,
) -> torch.Tensor:  # fmt: skip
    """The transform that brings a rendering closest to its photograph, shape (3, 4), without gradient.

    Weighted least squares with a ridge towards the identity. Weights fall with the error under the present
    transform (Cauchy's function), so that what is not fitted yet, or moved, counts little.

    Args:
        color: Rendered RGB, shape (H, W, 3).
        photograph: shape (H, W, 3).
        weight: Trust in each pixel in [0, 1], shape (H, W); None for 1 everywhere.
        present: The transform so far, shape (3, 4).
        alpha: Opacity of the rendering, shape (H, W), if both images are over black: as much of the offset is
            added. None for 1 everywhere.
    """
    color, photograph = color.detach(), photograph.detach()
    opacity = torch.ones(color.shape[:2]) if alpha is None else alpha.detach()
    known = torch.cat([color, opacity[..., None]], dim=2)
    shown = color @ present[:, :3].T + opacity[..., None] * present[:, 3]
    error = (shown - photograph).norm(dim=2)
    trust = 1.0 / (1.0 + (error / error.mean().clamp_min(1.0 / 255.0)) ** 2)
    if weight is not None:
        trust = trust * weight
    trust = trust.reshape(-1, 1).double()
    known = known.reshape(-1, 4).double()
    total = trust.sum().clamp_min(1e-12)
    ridge = SETTINGS.identity_weight * torch.eye(4, dtype=torch.float64)
    normal = known.T @ (trust * known) / total + ridge
    wanted = known.T @ (trust * photograph.reshape(-1, 3).double()) / total
    wanted += ridge @ IDENTITY.T.double()
    return torch.linalg.solve(normal, wanted).T.float()


def exposure_corrected(
    pixels: np.ndarray, transform: torch.Tensor, alpha: np.ndarray | None = None
) -> np.ndarray:
    """A photograph with its exposure undone, as if taken with the mean exposure, uint8 (H, W, 3).

    What the photograph clipped stays clipped. A gain too small to be undone leaves the photograph as it is.

    Args:
        pixels: RGB, shape (H, W, 3), uint8.
        transform: Colour transform of this photograph, shape (3, 4).
        alpha: Its opacity, shape (H, W), uint8: the background behind it has no exposure, and stays.
    """
    transform = transform.double()
    if float(torch.linalg.svdvals(transform[:, :3]).min()) < SETTINGS.gain_least:
        return pixels
    undone = unexposed(torch.from_numpy(pixels).double() / 255.0, transform)
    if alpha is not None:
        through = 1.0 - torch.from_numpy(alpha).double()[..., None] / 255.0
        background = torch.tensor(BACKGROUND, dtype=torch.float64)
        undone = undone + through * (background - unexposed(background, transform))
    return (undone.clamp(0.0, 1.0) * 255.0).round().to(torch.uint8).numpy()


class Exposures:
    """Transforms of all images.

    Attributes:
        transforms: shape (V, 3, 4), without gradient.
    """

    def __init__(self, cameras: Sequence[Camera]) -> None:
        """Start with the identity for the images of V cameras."""
        count = len(cameras)
        self.transforms = IDENTITY.repeat(count, 1, 1)
        basis = torch.ones(count, 1, dtype=torch.float64)
        if count >= SETTINGS.views_per_function * (1 + 2 * 3):
            places = np.stack([camera.center for camera in cameras])
            directions = np.stack([camera.forward for camera in cameras])
            basis = torch.cat([basis, torch.from_numpy(np.concatenate([places, directions], axis=1))], dim=1)
        # Orthonormal, and short of what is constant or repeated, such as the height on a level path.
        left, strength, _ = torch.linalg.svd(basis, full_matrices=False)
        self._followed = left[:, strength > SETTINGS.rank_least * strength[0]].float()

    def update(
        self, image: int, color: torch.Tensor, photograph: torch.Tensor, weight: torch.Tensor | None,
        alpha: torch.Tensor | None = None,
    ) -> None:  # fmt: skip
        """Move the transform of one image towards the best one, and take from all what gaussians can follow.

        Args:
            image: Its index.
            color: Rendered RGB before any transform, shape (H, W, 3).
            photograph: shape (H, W, 3).
            weight: Trust in each pixel, shape (H, W); None for 1 everywhere.
            alpha: As `best_transform` takes it.
        """
        present = self.transforms[image]
        best = best_transform(color, photograph, weight, present, alpha)
        self.transforms[image] = present + SETTINGS.share * (best - present)
        change = (self.transforms - IDENTITY).reshape(len(self.transforms), 12)
        change -= self._followed @ (self._followed.T @ change)
        self.transforms = IDENTITY + change.reshape(-1, 3, 4)
