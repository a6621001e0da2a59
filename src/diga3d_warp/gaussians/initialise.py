"""First gaussians of a fit, from sparse points."""

from __future__ import annotations

import numpy as np
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.kernels.harmonics import C0
from diga3d_warp.scene.scene import Points

NEIGHBOURS = 3
"""Nearest points whose mean distance becomes a gaussian's size, as in 3DGS."""

OPACITY = 0.1
"""First opacity, as in 3DGS."""

SMALLEST = 1e-7
"""Floor of the squared distance [scene units^2], as in 3DGS: points may coincide."""


def initialise(points: Points, coefficients: int = 16) -> Gaussians:
    """One round gaussian per point, as wide as the points are apart.

    Args:
        points: P points, at least one.
        coefficients: Spherical harmonics per gaussian, 1, 4, 9 or 16; those above the first are zero.

    Raises:
        InputError: there is no point, or none with finite coordinates.
    """
    from scipy.spatial import cKDTree

    finite = np.isfinite(points.positions).all(axis=1)
    positions, colors = points.positions[finite], points.colors[finite]
    if len(positions) == 0:
        raise InputError(
            "the scene has no sparse points to start from; run COLMAP's point triangulator on it"
        )
    nearest = min(NEIGHBOURS + 1, len(positions))
    distances, _ = cKDTree(positions).query(positions, k=np.arange(1, nearest + 1))
    squared = (distances[:, 1:] ** 2).mean(axis=1) if nearest > 1 else np.ones(len(positions))
    log_scales = 0.5 * np.log(np.maximum(squared, SMALLEST))
    sh = torch.zeros(len(positions), coefficients, 3)
    sh[:, 0] = (torch.from_numpy(colors.astype(np.float32) / 255.0) - 0.5) / C0
    quaternions = torch.zeros(len(positions), 4)
    quaternions[:, 0] = 1.0
    return Gaussians(
        means=torch.from_numpy(positions.astype(np.float32)),
        log_scales=torch.from_numpy(log_scales.astype(np.float32))[:, None].repeat(1, 3),
        quaternions=quaternions,
        opacity_logits=torch.full((len(positions),), float(np.log(OPACITY / (1.0 - OPACITY)))),
        sh=sh,
    )
