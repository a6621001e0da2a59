"""Anchors as standard gaussians: one place, shape and opacity each, harmonics over the training directions.

A decoded gaussian changes opacity, shape and colour with the view; a standard one changes colour alone. Each
baked gaussian takes the mean of what its decoded ones were, weighted by how much they showed in each view,
and the harmonics that come closest to their colours. `pipelines.baking` then fits all of them together to
renderings of the anchors.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch

from diga3d_warp.config import Effects
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.gaussians.scaffold.anchors import Scaffold
from diga3d_warp.kernels.harmonics import C0
from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.attribution import shares
from diga3d_warp.splatting.project import project
from diga3d_warp.splatting.shade import degree_of, shade

SHOWN = 0.02
"""Blending weight over all views under which a decoded gaussian is left out [pixels at full opacity]."""

RIDGE = 0.05
"""Weight of the squared harmonics above the first, against the squared error of colours [1]: a few directions
close together do not tell what the others see."""

STEP = 0.1
"""Coefficient with which single harmonics are evaluated: none leaves the colours' range by it."""


@dataclass(frozen=True, eq=False)
class Baked:
    """Standard gaussians of anchors.

    Attributes:
        gaussians: M gaussians.
        owners: The anchor of each, shape (M,), int64.
    """

    gaussians: Gaussians
    owners: torch.Tensor


class _Sight(NamedTuple):
    """What one camera sees: decoded gaussians, their slots and their weights in the image."""

    camera: Camera
    gaussians: Gaussians
    slots: torch.Tensor
    weights: torch.Tensor


@torch.no_grad()
def bake(
    scaffold: Scaffold, cameras: Sequence[Camera], coefficients: int, effects: Effects = Effects()
) -> Baked:
    """Standard gaussians that look like the anchors from these cameras.

    Args:
        scaffold: N anchors.
        cameras: At least one.
        coefficients: Harmonics of each gaussian: 1, 4, 9 or 16.
        effects: With which they are rendered.
    """
    count = len(scaffold) * scaffold.slots
    total = torch.zeros(count)
    for sight in _sights(scaffold, cameras, effects):
        total.index_add_(0, sight.slots, sight.weights)
    shown = torch.nonzero(total > SHOWN)[:, 0]
    row_of = torch.full((count,), -1)
    row_of[shown] = torch.arange(len(shown))
    owners = shown // scaffold.slots
    offsets = scaffold.offsets.reshape(-1, 3)[shown]
    means = scaffold.means[owners] + offsets * torch.exp(scaffold.log_spans[owners])
    sums = _Sums.zeros(len(shown), coefficients)
    for sight in _sights(scaffold, cameras, effects):
        sums.add(sight, row_of, means, degree_of(torch.empty(0, coefficients, 3)))
    return Baked(sums.gaussians(means, scaffold.log_sizes[owners]), owners)


def _sights(scaffold: Scaffold, cameras: Sequence[Camera], effects: Effects) -> Iterator[_Sight]:
    for camera in cameras:
        drawn = scaffold.drawn_in(camera)
        assert drawn.slots is not None
        seen = drawn.gaussians.detached()
        projection = project(
            seen.means, seen.log_scales, seen.quaternions, seen.opacity_logits, camera, effects=effects
        )
        blank = torch.zeros(camera.height, camera.width, 3)
        yield _Sight(camera, seen, drawn.slots, shares(projection, blank, effects=effects).weights.float())


@dataclass(eq=False)
class _Sums:
    """Weighted sums over the views, a row for each of M gaussians.

    Attributes:
        weights: shape (M, 1).
        opacities: shape (M, 1).
        log_scales: shape (M, 3).
        rotations: Of the outer products of unit quaternions, which are the same for q and -q, (M, 4, 4).
        normal, right: Least squares of the harmonics, shapes (M, K, K) and (M, K, 3).
    """

    weights: torch.Tensor
    opacities: torch.Tensor
    log_scales: torch.Tensor
    rotations: torch.Tensor
    normal: torch.Tensor
    right: torch.Tensor

    @classmethod
    def zeros(cls, count: int, coefficients: int) -> _Sums:
        k = coefficients
        return cls(*(torch.zeros(count, *tail) for tail in ((1,), (1,), (3,), (4, 4), (k, k), (k, 3))))

    def add(self, sight: _Sight, row_of: torch.Tensor, means: torch.Tensor, degree: int) -> None:
        mine = torch.nonzero((row_of[sight.slots] >= 0) & (sight.weights > 0.0))[:, 0]
        if not len(mine):
            return
        rows, weights = row_of[sight.slots[mine]], sight.weights[mine][:, None]
        seen = sight.gaussians.select(mine)
        turns = torch.nn.functional.normalize(seen.quaternions, dim=1)
        basis = harmonics_towards(sight.camera, means[rows], degree)
        # A row comes once in a view, so plain indexing adds up.
        self.weights[rows] += weights
        self.opacities[rows] += weights * seen.opacities[:, None]
        self.log_scales[rows] += weights * seen.log_scales
        self.rotations[rows] += weights[..., None] * turns[:, :, None] * turns[:, None, :]
        self.normal[rows] += weights[..., None] * basis[:, :, None] * basis[:, None, :]
        self.right[rows] += weights[..., None] * basis[:, :, None] * (C0 * seen.sh)

    def gaussians(self, means: torch.Tensor, log_sizes: torch.Tensor) -> Gaussians:
        ridge = RIDGE * torch.eye(self.normal.shape[1])
        ridge[0, 0] = 1e-6
        weights = self.weights.clamp_min(1e-12)
        sh = torch.linalg.solve(self.normal / weights[..., None] + ridge, self.right / weights[..., None])
        quaternions = torch.linalg.eigh(self.rotations).eigenvectors[:, :, -1]
        log_scales = torch.where(self.weights > 0.0, self.log_scales / weights, log_sizes)
        opacities = (self.opacities / weights)[:, 0].clamp(1e-4, 1.0 - 1e-4)
        return Gaussians(means, log_scales, quaternions.contiguous(), torch.logit(opacities), sh.contiguous())


def harmonics_towards(camera: Camera, means: torch.Tensor, degree: int) -> torch.Tensor:
    """Values of the harmonics up to a degree in the directions from a camera to positions, shape (M, K).

    They are those by which `shade` colours gaussians, which is asked for three at a time.
    """
    count = (degree + 1) ** 2
    everywhere = means.new_ones(len(means), 2)
    values = []
    for first in range(0, count, 3):
        sh = means.new_zeros(len(means), 16, 3)
        asked = range(first, min(first + 3, count))
        for channel, index in enumerate(asked):
            sh[:, index, channel] = STEP
        colors = shade(means, sh, everywhere, camera, degree)
        values.append((colors[:, : len(asked)] - 0.5) / STEP)
    return torch.cat(values, dim=1)
