"""Camera parameters of the kernels, computed once per set of intrinsics."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import warp as wp

from diga3d_warp.config import SPLATTING
from diga3d_warp.kernels.cameras import lens_model, pixel_rays_kernel, valid_radius
from diga3d_warp.kernels.launch import launch
from diga3d_warp.kernels.projection import Lens
from diga3d_warp.scene.camera import Camera, Distortion

NO_RADIUS_LIMIT = {"none": 1e6, "brown": 1e6, "brown5": 1e4, "fisheye": 1e6}
"""Replaces an infinite valid radius [focal lengths]: a ray a fifth of an arc second from the image plane,
or 20 arc seconds. The power of it that a lens polynomial takes, the fifth or the seventh, still is a float32
after a product with `PIXELS_MAX` and `COEFFICIENT_MAX`."""


@dataclass(frozen=True, eq=False)
class Optics(Lens):
    """Lens, field of view and image size of a camera, without its pose, and the rays of its pixels.

    Attributes:
        rays: Undistorted (x/z, y/z) of every pixel centre, shape (H * W, 2), float32; NaN where the lens
            reaches no ray.
    """

    rays: np.ndarray


def optics_of(camera: Camera) -> Optics:
    """The optics of a camera; kept for the next call with the same intrinsics."""
    return _optics(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy, camera.distortion)


def lens_of(camera: Camera) -> tuple[str, tuple[float, ...], float]:
    """Kind, coefficients and largest radius [focal lengths] of a camera's lens."""
    distortion = camera.distortion
    kind = distortion.kind if distortion else "none"
    coefficients = distortion.coefficients if distortion else (0.0, 0.0, 0.0, 0.0)
    return kind, coefficients, _radius(kind, coefficients)


@lru_cache(maxsize=1024)
def _radius(kind: str, coefficients: tuple[float, ...]) -> float:
    return min(valid_radius(kind, coefficients), NO_RADIUS_LIMIT[kind])


@lru_cache(maxsize=64)
def _optics(
    width: int, height: int, fx: float, fy: float, cx: float, cy: float, distortion: Distortion | None
) -> Optics:
    kind = distortion.kind if distortion else "none"
    coefficients = distortion.coefficients if distortion else (0.0, 0.0, 0.0, 0.0)
    radius = _radius(kind, coefficients)
    rays = wp.empty(width * height, dtype=wp.vec2, device="cpu")
    launch(
        pixel_rays_kernel(kind), width * height,
        [width, wp.vec4(fx, fy, cx, cy), lens_model(kind).vector(*coefficients), radius], [rays],
        device="cpu",
    )  # fmt: skip
    seen = rays.numpy()
    reached = seen[np.isfinite(seen).all(axis=1)]
    if len(reached) == 0:  # all that is drawn lies outside the image
        reached = np.zeros((1, 2), np.float32)
    low, high = reached.min(axis=0), reached.max(axis=0)
    margin = (SPLATTING.jacobian_margin - 1.0) * 0.5 * (high - low)
    lower, upper = tuple((low - margin).tolist()), tuple((high + margin).tolist())
    return Optics(kind, coefficients, radius, lower, upper, width, height, seen)
