"""Footprint of a 3D gaussian in the image (EWA, Zwicker et al. 2001; paper Sec. 3.1).

A function of one gaussian; `projection` runs it, and the derivative that Warp finds for it, over all of them.

Invariants
- The projected covariance is the Gram matrix of rows a, b: those of J W R S, or of sigma points. So it is
  positive semi-definite in floating point too, and its determinant is a sum of squares:
  |a ^ b|^2 + e (|a|^2 + |b|^2) + e^2 with the low-pass e (Cauchy-Binet). The textbook a d - b^2 loses all
  digits on needles.
- The output is the Cholesky factor L of the inverse covariance L L^T, lower triangular, as (l11, l21, l22).
  No entry is a difference, and the exponent at an offset d, -|L^T d|^2 / 2, is never above 0. Its rounding
  error grows with the length of a needle; that of the inverse covariance grows with the square.
- Every guard is written positively, `x >= limit`, so that NaN fails it.
- Gaussians are in SIMD lanes, so nothing returns early. The numbers of a gaussian that fails a guard are
  meaningless, and may be NaN.
- The code is compiled for one `Projecting` and holds nothing that it does not ask for.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import warp as wp

from diga3d_warp.config import SPLATTING, Accuracy, Effects
from diga3d_warp.kernels.cameras import lens_model
from diga3d_warp.kernels.elementary import clamp_function, exp_function, log_function
from diga3d_warp.kernels.precision import REALS, types_of
from diga3d_warp.kernels.sigma_points import spread_function

_S = SPLATTING


@dataclass(frozen=True)
class Projecting:
    """What projection is compiled for.

    Attributes:
        lens_kind: "none", "brown", "brown5" or "fisheye".
        alpha_min, extent, footprint, precision: As in `config.Accuracy`.
        antialias: As in `config.Effects`.
        slopes: Give the slopes of depth over the image, which per-pixel order needs.
    """

    lens_kind: str = "none"
    alpha_min: float = Accuracy.alpha_min
    extent: str = Accuracy.extent
    footprint: str = Accuracy.footprint
    precision: str = Accuracy.precision
    antialias: bool = False
    slopes: bool = False

    @classmethod
    def of(cls, lens_kind: str, accuracy: Accuracy, effects: Effects) -> "Projecting":
        """What a lens, an accuracy and some effects need."""
        return cls(
            lens_kind, accuracy.alpha_min, accuracy.extent, accuracy.footprint, accuracy.precision,
            antialias=effects.antialias, slopes=accuracy.pixel_order or effects.pixel_order,
        )  # fmt: skip

    @property
    def real(self) -> Any:
        """Scalar type of all arrays."""
        return REALS[self.precision]

    @property
    def calls(self) -> bool:
        """Whether the code calls a library: for all exponentials in float64, and for a fisheye's angle."""
        return self.precision == "float64" or self.lens_kind == "fisheye"


@cache
def rotation_function(real: Any) -> Any:
    """Warp function: rotation of a quaternion (w, x, y, z), not necessarily of unit length."""
    _, _, vec4, _, mat33, _ = types_of(real)
    one, two = real(1.0), real(2.0)

    @wp.func
    def rotation_of(q: vec4):
        n = q * (one / wp.sqrt(wp.dot(q, q)))
        w = n[0]
        x = n[1]
        y = n[2]
        z = n[3]
        return mat33(
            one - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y),
            two * (x * y + w * z), one - two * (x * x + z * z), two * (y * z - w * x),
            two * (x * z - w * y), two * (y * z + w * x), one - two * (x * x + y * y),
        )  # fmt: skip

    return rotation_of


@cache
def within_function(real: Any) -> Any:
    """Warp function: 1 if all numbers of a vector are nearer to 0 than a limit, else 0."""
    vec3 = types_of(real).vec3

    @wp.func
    def within(v: vec3, limit: real) -> int:
        near = wp.where(wp.abs(v[0]) < limit, 1, 0) & wp.where(wp.abs(v[1]) < limit, 1, 0)
        return near & wp.where(wp.abs(v[2]) < limit, 1, 0)

    return within


class Footprint(NamedTuple):
    """Warp functions from a gaussian to its splat.

    Attributes:
        splat: (mean, log_scale, quaternion, opacity_logit, pose, intrinsics, coefficients, lower, upper,
            radius_max) -> center x, y; depth; factor; opacity; depth slope x, y; variances (xx, yy, xy);
            seen, which is 0 if a guard fails, else 1.
        box: (opacity, variances) -> extent x, y. Carries no gradient.
        weighted: The arguments of `splat`, then weights of center x, y, depth, factor, opacity and depth
            slope x, y -> the weighted sum. Its derivative pulls gradients of a splat back to the gaussian and
            the camera.
    """

    splat: Any
    box: Any
    weighted: Any


@cache
def footprint(kind: Projecting) -> Footprint:
    """The functions for one way of projecting."""
    real = kind.real
    vec2, vec3, vec4, _, mat33, mat44 = types_of(real)
    lens = lens_model(kind.lens_kind, real)
    vector, distort, distort_jacobian = lens.vector, lens.distort, lens.distort_jacobian
    spread = spread_function(kind.lens_kind, real)
    rotation_of, within = rotation_function(real), within_function(real)
    clamp, exp, log = clamp_function(real), exp_function(real), log_function(real)
    unscented, antialias, slopes = kind.footprint == "unscented", kind.antialias, kind.slopes
    circle = kind.extent == "circle"

    zero, half, one, two = real(0.0), real(0.5), real(1.0), real(2.0)
    low_pass = real(_S.low_pass_antialiased if antialias else _S.low_pass)
    alpha_min, inv_alpha_min = real(kind.alpha_min), real(1.0 / kind.alpha_min)
    alpha_min_squared = real(kind.alpha_min**2)
    reach_guard = real(1e-6)  # more than the rounding of the logarithm before it
    root_half = real(0.5**0.5)
    circle_radius = real(_S.circle_radius)
    circle_floor = real(0.1)  # under the square root of 3DGS's larger eigenvalue [px^4]
    near, coordinate_max, log_scale_max = real(_S.near), real(_S.coordinate_max), real(_S.log_scale_max)
    logit_min, quaternion_min = real(_S.logit_min), real(_S.quaternion_min)
    variance_max = real(_S.variance_max)

    @wp.func
    def splat(
        mean: vec3,
        scale: vec3,
        q: vec4,
        logit: real,
        pose: mat44,
        f: vec4,
        coefficients: vector,
        lower: vec2,
        upper: vec2,
        radius_max: real,
    ):
        seen = within(mean, coordinate_max) & within(scale, log_scale_max)
        seen = seen & within(vec3(q[0], q[1], q[2]), coordinate_max)
        seen = seen & wp.where(wp.abs(q[3]) < coordinate_max, 1, 0)
        seen = seen & wp.where(logit > logit_min, 1, 0)  # no upper end: infinity is opacity 1

        p = wp.transform_point(pose, mean)
        seen = seen & wp.where(p[2] >= near, 1, 0)
        seen = seen & wp.where(wp.dot(q, q) >= quaternion_min, 1, 0)
        opacity = one / (one + exp(-logit))
        seen = seen & wp.where(opacity >= alpha_min, 1, 0)

        inv_z = one / p[2]
        x = p[0] * inv_z
        y = p[1] * inv_z
        seen = seen & wp.where(x * x + y * y < radius_max * radius_max, 1, 0)

        # Jacobian of the pixel in camera coordinates, at a direction clamped to the margin.
        xj = clamp(x, lower[0], upper[0])
        yj = clamp(y, lower[1], upper[1])
        xx, xy, yy = distort_jacobian(xj, yj, coefficients)
        dx = vec3(inv_z, zero, -xj * inv_z)
        dy = vec3(zero, inv_z, -yj * inv_z)
        row_u = f[0] * (xx * dx + xy * dy)
        row_v = f[1] * (xy * dx + yy * dy)
        u, v = distort(x, y, coefficients)

        # Rows of J W R S, whose Gram matrix is the projected covariance.
        world = wp.transpose(mat33(
            pose[0, 0], pose[0, 1], pose[0, 2],
            pose[1, 0], pose[1, 1], pose[1, 2],
            pose[2, 0], pose[2, 1], pose[2, 2],
        ))  # fmt: skip
        axes = wp.transpose(rotation_of(q))
        scales = vec3(exp(scale[0]), exp(scale[1]), exp(scale[2]))
        a = wp.cw_mul(axes * (world * row_u), scales)
        b = wp.cw_mul(axes * (world * row_v), scales)
        a_even = vec3(zero, zero, zero)
        b_even = vec3(zero, zero, zero)
        if wp.static(unscented):
            if x == xj and y == yj:
                frame = axes * world
                a0, b0, c0, d0 = spread(
                    p, x, y, u, v, xx, xy, yy, scales[0] * frame[0], coefficients, radius_max
                )
                a1, b1, c1, d1 = spread(
                    p, x, y, u, v, xx, xy, yy, scales[1] * frame[1], coefficients, radius_max
                )
                a2, b2, c2, d2 = spread(
                    p, x, y, u, v, xx, xy, yy, scales[2] * frame[2], coefficients, radius_max
                )
                a = f[0] * vec3(a0, a1, a2)
                b = f[1] * vec3(b0, b1, b2)
                a_even = f[0] * vec3(c0, c1, c2)
                b_even = f[1] * vec3(d0, d1, d2)

        aa = wp.dot(a, a)
        bb = wp.dot(b, b)
        ab = wp.dot(a, b)
        if wp.static(unscented):
            aa += wp.dot(a_even, a_even)
            bb += wp.dot(b_even, b_even)
            ab += wp.dot(a_even, b_even)
        seen = seen & wp.where(aa + bb < variance_max, 1, 0)
        n = wp.cross(a, b)
        area = wp.dot(n, n)
        if wp.static(unscented):
            n_even = wp.cross(a_even, b_even)
            mixed = wp.outer(a, b_even) - wp.outer(b, a_even)
            area += wp.dot(n_even, n_even) + wp.ddot(mixed, mixed)
        det = area + low_pass * (aa + bb) + low_pass * low_pass
        inv_det = one / det
        var_x = aa + low_pass
        var_y = bb + low_pass
        inv_var_y = one / var_y
        l11 = wp.sqrt(var_y * inv_det)
        factor = vec3(l11, -ab * inv_var_y * l11, wp.sqrt(inv_var_y))

        if wp.static(antialias):
            # The low-pass widens the splat; its opacity shrinks by the same ratio of areas. Below alpha_min
            # it is culled here: the square root of a number that can be zero has no slope.
            seen = seen & wp.where(opacity * opacity * area >= alpha_min_squared * det, 1, 0)
            opacity = opacity * wp.sqrt(area * inv_det)

        center_x = f[0] * u + f[2]
        center_y = f[1] * v + f[3]
        if wp.static(unscented):
            center_x += root_half * (a_even[0] + a_even[1] + a_even[2])
            center_y += root_half * (b_even[0] + b_even[1] + b_even[2])
        slope_x = zero
        slope_y = zero
        if wp.static(slopes):
            # Depth of the largest response along a pixel's ray is linear in the pixel: the mean of z given
            # the pixel, cov(z, pixel) times the inverse covariance.
            along_z = wp.cw_mul(axes * vec3(pose[2, 0], pose[2, 1], pose[2, 2]), scales)
            with_u = wp.dot(a, along_z)
            with_v = wp.dot(b, along_z)
            along_first = factor[0] * with_u + factor[1] * with_v
            along_second = factor[2] * with_v
            slope_x = factor[0] * along_first
            slope_y = factor[1] * along_first + factor[2] * along_second
        return center_x, center_y, p[2], factor, opacity, slope_x, slope_y, vec3(var_x, var_y, ab), seen

    @wp.func
    def box(opacity: real, variances: vec3):
        if wp.static(circle):
            mid = half * (variances[0] + variances[1])
            spread_of_variances = half * (variances[0] - variances[1])
            under_root = spread_of_variances * spread_of_variances + variances[2] * variances[2]
            floored = wp.where(under_root > circle_floor, under_root, circle_floor)
            half_width = circle_radius * wp.sqrt(mid + wp.sqrt(floored))
            half_height = half_width
        else:
            # Half width and height of the ellipse on which alpha falls to alpha_min.
            over = opacity * inv_alpha_min
            reach = wp.sqrt(two * log(wp.where(over > one, over, one)) + reach_guard)
            half_width = reach * wp.sqrt(variances[0])
            half_height = reach * wp.sqrt(variances[1])
        return half_width, half_height

    @wp.func
    def weighted(
        mean: vec3,
        scale: vec3,
        q: vec4,
        logit: real,
        pose: mat44,
        f: vec4,
        coefficients: vector,
        lower: vec2,
        upper: vec2,
        radius_max: real,
        of_x: real,
        of_y: real,
        of_depth: real,
        of_factor: vec3,
        of_opacity: real,
        of_slope_x: real,
        of_slope_y: real,
    ) -> real:
        center_x, center_y, depth, factor, opacity, slope_x, slope_y, _variances, _seen = splat(
            mean, scale, q, logit, pose, f, coefficients, lower, upper, radius_max
        )
        total = of_x * center_x + of_y * center_y + of_depth * depth + wp.dot(of_factor, factor)
        total += of_opacity * opacity
        if wp.static(slopes):
            total += of_slope_x * slope_x + of_slope_y * slope_y
        return total

    return Footprint(splat, box, weighted)
