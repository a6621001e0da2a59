"""Lens models as building blocks of kernels, and the ray of every pixel.

Invariants
- Lens models act on normalised camera coordinates (x, y) = (X/Z, Y/Z), in units of the focal length.
- `distort` and `distort_jacobian` hold no loop and no branch, and divide by nothing that can be zero, so the
  adjoint that Warp derives for them is right everywhere, the optical axis included.
- Pairs of numbers go in and out one by one: a 2-vector between functions is passed as one register, which
  keeps a loop over lanes from being vectorised.
- A lens polynomial folds over at some radius: beyond it, far-off points come back into the image. Before
  distorting, cull points whose undistorted radius is not below `valid_radius`.
- A pixel that no ray inside the valid radius reaches has a NaN ray; guards downstream are written so that NaN
  fails them.

One model per (lens kind, scalar type): float32 for work, float64 for gradient checks.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import warp as wp

from diga3d_warp.kernels.launch import OPTIONS
from diga3d_warp.kernels.precision import types_of

NEWTON_STEPS = 12
"""Newton steps of `undistort`. Convergence is quadratic: 4 to 6 steps reach float64 precision for real
lenses; the rest is for pixels close to the fold, where the slope goes to zero."""

RESIDUAL = {wp.float32: 2e-5, wp.float64: 1e-10}
"""Largest distance between a pixel and its ray distorted again, in focal lengths: 0.02 px at a focal length
of 1000 px. Above it the inverse has not converged: the pixel lies outside the range of the lens."""

AXIS_GUARD = {wp.float32: 1e-8, wp.float64: 1e-16}
"""Added to r^2 in the fisheye model, which divides by r on the optical axis. It shifts values by a third of
itself, which is below the resolution of the type."""


@dataclass(frozen=True)
class LensModel:
    """Warp functions of one lens kind in one scalar type; `k` is its coefficients.

    Attributes:
        vector: Type of `k`.
        distort: (x, y, k) -> distorted x, y.
        distort_jacobian: (x, y, k) -> d distorted / d (x, y), closed form: its entries xx, xy and yy. All
            models are symmetric.
        undistort: (xd, yd, k, max_radius) -> (x, y), or NaN where no ray with a radius below `max_radius`
            reaches (xd, yd). Not differentiable.
    """

    vector: Any
    distort: Any
    distort_jacobian: Any
    undistort: Any


@cache
def lens_model(kind: str = "none", scalar: Any = wp.float32) -> LensModel:
    """The Warp functions of "none" or of a lens kind of `scene.camera.Distortion`."""
    if kind == "none":
        return _pinhole(scalar)
    if kind in ("brown", "brown5"):
        return _brown(scalar, longer=kind == "brown5")
    if kind == "fisheye":
        return _fisheye(scalar)
    raise ValueError(f"unknown lens kind {kind!r}")


def valid_radius(kind: str, coefficients: Sequence[float] = (0.0, 0.0, 0.0, 0.0)) -> float:
    """Radius sqrt(x^2 + y^2) of undistorted coordinates below which the lens is one to one.

    For "brown" the bound is that the Jacobian is positive definite on the whole disc, which makes the
    mapping one to one there. The radial terms give it the eigenvalues 1 + 3 k1 r^2 + 5 k2 r^4 + 7 k3 r^6 and
    1 + k1 r^2 + k2 r^4 + k3 r^6; the tangential terms lower them by at most 6 |p| r. For "fisheye" it is the
    tangent of the first angle at which the distorted angle stops growing.

    Returns:
        The radius [focal lengths]; infinity if the mapping never folds over.
    """
    if kind == "none":
        return math.inf
    if kind in ("brown", "brown5"):
        k1, k2, p1, p2, k3 = [*coefficients, 0.0][:5]
        tangential = 6.0 * math.hypot(p1, p2)
        return min(
            _first_positive_root((7.0 * k3, 0.0, 5.0 * k2, 0.0, 3.0 * k1, -tangential, 1.0)),
            _first_positive_root((k3, 0.0, k2, 0.0, k1, -tangential, 1.0)),
        )
    k1, k2, k3, k4 = coefficients
    angle = _first_positive_root((9.0 * k4, 0.0, 7.0 * k3, 0.0, 5.0 * k2, 0.0, 3.0 * k1, 0.0, 1.0))
    return math.tan(angle) if angle < 0.5 * math.pi else math.inf


def _first_positive_root(polynomial: Sequence[float]) -> float:
    roots = np.roots(polynomial)
    real = roots.real[(np.abs(roots.imag) < 1e-9 * (1.0 + np.abs(roots))) & (roots.real > 0.0)]
    return float(real.min()) if real.size else math.inf


def _pinhole(scalar: Any) -> LensModel:
    vec2, _, vec4, *_ = types_of(scalar)

    @wp.func
    def distort(x: scalar, y: scalar, k: vec4):
        return x, y

    @wp.func
    def distort_jacobian(x: scalar, y: scalar, k: vec4):
        return scalar(1.0), scalar(0.0), scalar(1.0)

    @wp.func
    def undistort(xd: scalar, yd: scalar, k: vec4, max_radius: scalar):
        return vec2(xd, yd)

    return LensModel(vec4, distort, distort_jacobian, undistort)


def _brown(scalar: Any, longer: bool) -> LensModel:
    """The Brown lens; `longer` has a third radial coefficient, k[4]."""
    vec2 = types_of(scalar).vec2
    vector = wp.types.vector(length=5 if longer else 4, dtype=scalar)
    residual = RESIDUAL[scalar]
    steps = NEWTON_STEPS

    @wp.func
    def distort(x: scalar, y: scalar, k: vector):
        r2 = x * x + y * y
        radial = scalar(1.0) + r2 * (k[0] + r2 * k[1])
        if wp.static(longer):
            radial += r2 * r2 * r2 * k[4]
        two = scalar(2.0)
        return (
            x * radial + two * k[2] * x * y + k[3] * (r2 + two * x * x),
            y * radial + k[2] * (r2 + two * y * y) + two * k[3] * x * y,
        )

    @wp.func
    def distort_jacobian(x: scalar, y: scalar, k: vector):
        r2 = x * x + y * y
        radial = scalar(1.0) + r2 * (k[0] + r2 * k[1])
        two, six = scalar(2.0), scalar(6.0)
        slope = two * (k[0] + two * r2 * k[1])  # (d radial / d r^2) * 2
        if wp.static(longer):
            radial += r2 * r2 * r2 * k[4]
            slope += six * r2 * r2 * k[4]
        cross = slope * x * y + two * (k[2] * x + k[3] * y)
        return (
            radial + slope * x * x + two * k[2] * y + six * k[3] * x,
            cross,
            radial + slope * y * y + six * k[2] * y + two * k[3] * x,
        )

    @wp.func
    def undistort(xd: scalar, yd: scalar, k: vector, max_radius: scalar):
        x = scalar(xd)
        y = scalar(yd)
        for _ in range(steps):
            at_x, at_y = distort(x, y, k)
            xx, xy, yy = distort_jacobian(x, y, k)
            off_x = (at_x - xd) / (xx * yy - xy * xy)
            off_y = (at_y - yd) / (xx * yy - xy * xy)
            x -= yy * off_x - xy * off_y
            y -= xx * off_y - xy * off_x
        at_x, at_y = distort(x, y, k)
        error = wp.sqrt((at_x - xd) * (at_x - xd) + (at_y - yd) * (at_y - yd))
        ray = vec2(scalar(wp.nan), scalar(wp.nan))
        if error < scalar(residual) and wp.sqrt(x * x + y * y) < max_radius:
            ray = vec2(x, y)
        return ray

    return LensModel(vector, distort, distort_jacobian, undistort)


def _fisheye(scalar: Any) -> LensModel:
    vec2, _, vec4, *_ = types_of(scalar)
    guard = AXIS_GUARD[scalar]
    residual = RESIDUAL[scalar]
    steps = NEWTON_STEPS

    @wp.func
    def bend(t: scalar, k: vec4):
        """Distorted angle over the angle: 1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8."""
        t2 = t * t
        return scalar(1.0) + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3])))

    @wp.func
    def bend_slope(t: scalar, k: vec4):
        """Derivative of the distorted angle by the angle."""
        t2 = t * t
        return scalar(1.0) + t2 * (
            scalar(3.0) * k[0]
            + t2 * (scalar(5.0) * k[1] + t2 * (scalar(7.0) * k[2] + t2 * scalar(9.0) * k[3]))
        )

    @wp.func
    def distort(x: scalar, y: scalar, k: vec4):
        r = wp.sqrt(x * x + y * y + scalar(guard))
        angle = wp.atan(r)
        scale = angle * bend(angle, k) / r
        return x * scale, y * scale

    @wp.func
    def distort_jacobian(x: scalar, y: scalar, k: vec4):
        r2 = x * x + y * y + scalar(guard)
        r = wp.sqrt(r2)
        angle = wp.atan(r)
        scale = angle * bend(angle, k) / r
        radial = (bend_slope(angle, k) / (scalar(1.0) + r2) - scale) / r2
        cross = radial * x * y
        return scale + radial * x * x, cross, scale + radial * y * y

    @wp.func
    def undistort(xd: scalar, yd: scalar, k: vec4, max_radius: scalar):
        bent = wp.sqrt(xd * xd + yd * yd + scalar(guard))
        angle = scalar(bent)
        for _ in range(steps):
            angle -= (angle * bend(angle, k) - bent) / bend_slope(angle, k)
        error = wp.abs(angle * bend(angle, k) - bent)
        ray = vec2(scalar(wp.nan), scalar(wp.nan))
        if error < scalar(residual) and angle >= scalar(0.0) and angle < scalar(0.5 * math.pi):
            r = wp.tan(angle)
            if r < max_radius:
                ray = vec2(xd * r / bent, yd * r / bent)
        return ray

    return LensModel(vec4, distort, distort_jacobian, undistort)


@cache
def pixel_rays_kernel(kind: str = "none", scalar: Any = wp.float32) -> wp.Kernel:
    """Kernel over the pixels of a camera, row by row, giving the undistorted ray of each pixel centre.

    Arguments of the kernel: offset; image width [px]; (fx, fy, cx, cy) [px]; lens coefficients;
    `valid_radius`; then the output, rays (x/z, y/z), shape [H * W], 2-vectors, NaN for pixels outside the
    range of the lens.
    """
    vec2, _, vec4, _, _, _ = types_of(scalar)
    lens = lens_model(kind, scalar)
    undistort, vector = lens.undistort, lens.vector

    @wp.kernel(module="unique", module_options=OPTIONS)
    def pixel_rays(
        offset: int,
        width: int,
        intrinsics: vec4,
        coefficients: vector,
        max_radius: scalar,
        # outputs
        rays: wp.array(dtype=vec2),
    ):
        i = wp.tid() + offset
        u = scalar(i % width) + scalar(0.5)
        v = scalar(i // width) + scalar(0.5)
        xd = (u - intrinsics[2]) / intrinsics[0]
        yd = (v - intrinsics[3]) / intrinsics[1]
        rays[i] = undistort(xd, yd, coefficients, max_radius)

    return pixel_rays
