"""World positions of pixels, and pixels of world positions, through any lens."""

from __future__ import annotations

import numpy as np
import warp as wp

from diga3d_warp.kernels.cameras import lens_model
from diga3d_warp.kernels.launch import launch
from diga3d_warp.kernels.reprojection import ReprojectionLimits, position_kernel
from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.optics import lens_of, optics_of

Pixels = tuple[np.ndarray, np.ndarray]
"""Rows and columns of some pixels, of equal shapes."""


def pixel_rays(camera: Camera, at: Pixels | None = None) -> np.ndarray:
    """Undistorted (x/z, y/z) of every pixel centre, shape (H, W, 2), float32; NaN where there is no ray.

    Args:
        camera: Of any lens.
        at: Some pixels instead, of shape S: the result has shape (S, 2).
    """
    rays = optics_of(camera).rays.reshape(camera.height, camera.width, 2)
    return rays if at is None else rays[at]


def unprojected(depth: np.ndarray, camera: Camera, at: Pixels | None = None) -> np.ndarray:
    """World position of each pixel at its depth, shape (H, W, 3), float64.

    Args:
        depth: z along the camera axis [scene units], shape (H, W).
        camera: At the size of the depth.
        at: Some pixels instead, of shape S; the depth is theirs, of the same shape, and so is the result.
    """
    rays = pixel_rays(camera, at)
    z = depth.astype(np.float64)
    rays = np.where(np.isfinite(rays), rays, 0.0)
    local = np.concatenate([rays * z[..., None], z[..., None]], axis=-1)
    pose = camera.pose
    return (local - pose[:3, 3]) @ pose[:3, :3]


def projected(points: np.ndarray, camera: Camera) -> np.ndarray:
    """Where a camera sees world positions.

    Args:
        points: World space [scene units], shape (..., 3), float64.
        camera: Of any lens.

    Returns:
        Column and row [px], the first pixel's centre at 0.5, and z along the camera axis [scene units],
        shape (..., 3), float64; NaN behind the camera and outside the range of its lens. Columns and rows
        may lie outside the image.
    """
    pose = camera.pose
    local = points.reshape(-1, 3) @ pose[:3, :3].T + pose[:3, 3]
    z = local[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        rays = local[:, :2] / z[:, None]
    kind, coefficients, radius = lens_of(camera)
    if kind == "none":
        return _pinhole(rays, z, camera, radius).reshape(points.shape)
    found = wp.empty(len(local), dtype=wp.vec3d, device="cpu")
    launch(
        position_kernel(kind, wp.float64), len(local),
        [
            wp.array(np.ascontiguousarray(z), dtype=wp.float64, device="cpu"),
            wp.array(np.ascontiguousarray(rays), dtype=wp.vec2d, device="cpu"),
            wp.mat33d(*np.eye(3).ravel().tolist()), wp.vec3d(0.0, 0.0, 0.0),
            wp.vec4d(camera.fx, camera.fy, camera.cx, camera.cy),
            lens_model(kind, wp.float64).vector(*coefficients), radius,
        ],
        [found], device="cpu",
    )  # fmt: skip
    return found.numpy().reshape(points.shape)


def _pinhole(rays: np.ndarray, z: np.ndarray, camera: Camera, radius: float) -> np.ndarray:
    """What the kernel finds without a lens: a launch takes longer, and a search for planes has thousands."""
    with np.errstate(over="ignore", invalid="ignore"):
        shown = (
            (z >= ReprojectionLimits.depth_min)
            & (z <= ReprojectionLimits.depth_max)
            & ((rays**2).sum(axis=1) < radius**2)
        )
        places = rays * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    return np.where(shown[:, None], np.column_stack([places, z]), np.nan)
