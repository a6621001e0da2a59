"""First gaussians of a fit: from sparse points, or from an image with depth."""

from __future__ import annotations

import numpy as np
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.kernels.harmonics import C0
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.scene import Points
from diga3d_warp.splatting.optics import optics_of

NEIGHBOURS = 3
"""Nearest points whose mean distance becomes a gaussian's size, as in 3DGS."""

OPACITY = 0.1
"""First opacity, as in 3DGS."""

FILL_OPACITY = 0.5
"""First opacity of a gaussian on a filled surface: it lies where it should, but must be able to fade."""

FILL_WIDTH = 0.6
"""Its standard deviation [px]: neighbours at one pixel's distance then leave no gap."""

SMALLEST = 1e-2
"""Least size of a gaussian [median distances between points]: points may coincide. 3DGS: 3e-4 scene units, of
a median of some 0.02."""


def initialise(points: Points, coefficients: int = 16) -> Gaussians:
    """One round gaussian per point, as wide as the points are apart.

    Args:
        points: P points, at least one.
        coefficients: Spherical harmonics per gaussian, 1, 4, 9 or 16; those above the first are zero.

    Returns:
        Gaussians; their means are float64 where float32 cannot hold the positions.

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
    apart = np.sqrt((distances[:, 1:] ** 2).mean(axis=1)) if nearest > 1 else np.ones(len(positions))
    usual = float(np.median(apart[apart > 0.0])) if (apart > 0.0).any() else 1.0
    log_scales = np.log(np.maximum(apart, SMALLEST * usual))
    return round_gaussians(positions, log_scales, colors / 255.0, OPACITY, coefficients)


def from_image(
    image: np.ndarray, depth: np.ndarray, where: np.ndarray, camera: Camera, coefficients: int, most: int
) -> Gaussians:
    """Gaussians on the surface that an image with depth shows, about as wide as a pixel.

    Args:
        image: RGB in [0, 1], shape (H, W, 3).
        depth: z along the camera axis [scene units], shape (H, W).
        where: Pixels to start from, shape (H, W), bool; those without a finite depth or a ray are left out.
        camera: At the size of the image.
        coefficients: Spherical harmonics per gaussian.
        most: Largest number of gaussians, at least 1; above it, pixels are skipped evenly and gaussians are
            wider.
    """
    rays = optics_of(camera).rays.reshape(camera.height, camera.width, 2)
    usable = where & np.isfinite(rays).all(axis=2) & np.isfinite(depth) & (depth > 0.0)
    rows, columns, step = _spread(usable, most)
    z = depth[rows, columns].astype(np.float64)
    local = np.concatenate([rays[rows, columns] * z[:, None], z[:, None]], axis=1)
    pose = camera.pose
    positions = (local - pose[:3, 3]) @ pose[:3, :3]
    sizes = FILL_WIDTH * step * z / (0.5 * (camera.fx + camera.fy))
    log_scales = np.log(np.maximum(sizes, np.finfo(np.float64).tiny))
    return round_gaussians(positions, log_scales, image[rows, columns], FILL_OPACITY, coefficients)


def _spread(usable: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray, int]:
    """Rows and columns of at most `most` pixels, one in each square cell that holds any, and the cell's side.

    Cells, not every n-th row and column: between those a thin region would go empty.
    """
    rows, columns = np.nonzero(usable)
    step = max(1, int(np.ceil(np.sqrt(len(rows) / most))))
    while True:
        cells = (rows // step) * usable.shape[1] + columns // step
        _, first = np.unique(cells, return_index=True)
        if len(first) <= most:
            return rows[first], columns[first], step
        step += 1


def round_gaussians(
    positions: np.ndarray, log_scales: np.ndarray, colors: np.ndarray, opacity: float, coefficients: int
) -> Gaussians:
    """Round gaussians of one opacity; colours (N, 3) in [0, 1]."""
    count = len(positions)
    sh = torch.zeros(count, coefficients, 3)
    sh[:, 0] = (torch.from_numpy(np.asarray(colors, np.float32)) - 0.5) / C0
    quaternions = torch.zeros(count, 4)
    quaternions[:, 0] = 1.0
    gaussians = Gaussians(
        means=torch.from_numpy(np.asarray(positions, np.float64)),
        log_scales=torch.from_numpy(log_scales.astype(np.float32))[:, None].repeat(1, 3),
        quaternions=quaternions,
        opacity_logits=torch.full((count,), float(np.log(opacity / (1.0 - opacity)))),
        sh=sh,
    )
    return gaussians.with_fitting_means()
