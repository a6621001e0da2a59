"""Gaussians on the filled part of charts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from diga3d_warp.gaussians.initialise import FILL_OPACITY, FILL_WIDTH
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.kernels.harmonics import C0
from diga3d_warp.surfaces.chart import Chart
from diga3d_warp.surfaces.settings import SHOWN, SURFACES, SurfaceSettings


def surfels(
    charts: Sequence[Chart], coefficients: int, settings: SurfaceSettings = SURFACES
) -> list[Gaussians]:
    """Discs on what was filled of charts, about as wide as they are apart.

    Args:
        charts: Filled ones.
        coefficients: Spherical harmonics per gaussian.
        settings: Number of gaussians of all charts together.
    """
    filled = [chart.wanted & (chart.alpha >= settings.alpha) for chart in charts]
    total = sum(int(each.sum()) for each in filled)
    step = max(1, int(np.ceil(np.sqrt(total / settings.seeds))))
    return [
        _discs(chart, each, step, coefficients)
        for chart, each in zip(charts, filled, strict=True)
        if each.any()
    ]


def _discs(chart: Chart, filled: np.ndarray, step: int, coefficients: int) -> Gaussians:
    from scipy.spatial.transform import Rotation

    rows, columns = np.nonzero(filled)
    cells = (rows // step) * filled.shape[1] + columns // step
    _, first = np.unique(cells, return_index=True)
    rows, columns = rows[first], columns[first]
    count = len(rows)
    width = FILL_WIDTH * step * chart.frame.texel
    scales = np.log(np.maximum([width, width, SHOWN.flatness * width], np.finfo(np.float64).tiny))
    turned = chart.frame.axes.copy()
    if np.linalg.det(turned) < 0.0:  # a disc looks the same from both sides
        turned[2] *= -1.0
    quaternion = Rotation.from_matrix(turned.T).as_quat()[[3, 0, 1, 2]]
    sh = torch.zeros(count, coefficients, 3)
    sh[:, 0] = (torch.from_numpy(chart.image[rows, columns]) - 0.5) / C0
    discs = Gaussians(
        means=torch.from_numpy(chart.frame.points[rows, columns]),
        log_scales=torch.from_numpy(scales).float().repeat(count, 1),
        quaternions=torch.from_numpy(quaternion).float().repeat(count, 1),
        opacity_logits=torch.full((count,), float(np.log(FILL_OPACITY / (1.0 - FILL_OPACITY)))),
        sh=sh,
    )
    return discs.with_fitting_means()
