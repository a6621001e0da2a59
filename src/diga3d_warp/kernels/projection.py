"""Projection: a 3D gaussian becomes a 2D one (EWA, Zwicker et al. 2001; paper Sec. 3, Preliminary).

Invariants
- The projected covariance is the Gram matrix of rows a, b: those of J W R S, or of sigma points. So it is
  positive semi-definite in floating point too, and its determinant is a sum of squares:
  |a ^ b|^2 + e (|a|^2 + |b|^2) + e^2 with the low-pass e (Cauchy-Binet). The textbook a d - b^2 loses all
  digits on needles.
- A splat goes out as `roots`, the Cholesky root L of its inverse covariance L L^T, lower triangular, as
  (l11, l21, l22). No entry is a difference, and the exponent at an offset d, -|L^T d|^2 / 2, is never above
  0; its rounding grows with the length of a needle, that of the inverse covariance with its square.
- A culled gaussian has extent (0, 0) and exact zeros in every output; its gradient is exactly zero.
- Every guard is written positively, `if not (x >= limit)`, so that NaN fails it.
- Broken input is culled before any arithmetic: the adjoint of a product multiplies by the other factor, and
  zero times infinity or NaN would reach the camera's gradient.
- The camera comes in rows, one for `POSE_GROUP` gaussians, all equal: each row collects the gradient of its
  own group.
- The kernel is compiled for one `Projecting`: what it does not ask for is not in the code.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import warp as wp

from diga3d_warp.config import POSE_GROUP, SPLATTING, Accuracy, Effects
from diga3d_warp.kernels.cameras import lens_model
from diga3d_warp.kernels.launch import DIFFERENTIABLE, launch
from diga3d_warp.kernels.precision import REALS, types_of
from diga3d_warp.kernels.sigma_points import spread_function

_S = SPLATTING


@dataclass(frozen=True)
class Projecting:
    """What a projection kernel is compiled for.

    Attributes:
        lens_kind: "none", "brown" or "fisheye".
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
        """The kernel for a lens that an accuracy and some effects need."""
        return cls(
            lens_kind, accuracy.alpha_min, accuracy.extent, accuracy.footprint, accuracy.precision,
            antialias=effects.antialias, slopes=accuracy.pixel_order or effects.pixel_order,
        )  # fmt: skip

    @property
    def real(self) -> Any:
        """Scalar type of all arrays."""
        return REALS[self.precision]


@cache
def rotation_function(real: Any) -> Any:
    """Warp function: rotation of a quaternion (w, x, y, z), not necessarily of unit length."""
    _, _, vec4, _, mat33, _ = types_of(real)
    one, two = real(1.0), real(2.0)

    @wp.func
    def rotation_of(q: vec4):
        n = q * (one / wp.length(q))
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


@wp.func
def within(v: Any, limit: Any):
    return wp.abs(v[0]) < limit and wp.abs(v[1]) < limit and wp.abs(v[2]) < limit


@cache
def projection_kernel(kind: Projecting) -> wp.Kernel:
    """The kernel for one way of projecting."""
    real = kind.real
    vec2, vec3, vec4, _, mat33, mat44 = types_of(real)
    lens = lens_model(kind.lens_kind, real)
    distort, distort_jacobian = lens.distort, lens.distort_jacobian
    spread = spread_function(kind.lens_kind, real)
    rotation_of = rotation_function(real)
    unscented, antialias, slopes = kind.footprint == "unscented", kind.antialias, kind.slopes
    circle = kind.extent == "circle"

    zero, half, one, two = real(0.0), real(0.5), real(1.0), real(2.0)
    low_pass = real(_S.low_pass_antialiased if antialias else _S.low_pass)
    alpha_min, inv_alpha_min = real(kind.alpha_min), real(1.0 / kind.alpha_min)
    alpha_min_squared = real(kind.alpha_min**2)
    reach_guard = real(1e-6)  # keeps the root's slope finite where opacity is alpha_min
    root_half = real(0.5**0.5)
    circle_radius = real(_S.circle_radius)
    circle_floor = real(0.1)  # under the root of 3DGS's larger eigenvalue [px^4]
    near, coordinate_max, log_scale_max = real(_S.near), real(_S.coordinate_max), real(_S.log_scale_max)
    logit_min, quaternion_min = real(_S.logit_min), real(_S.quaternion_min)
    variance_max = real(_S.variance_max)

    @wp.kernel(module="unique", module_options=DIFFERENTIABLE)
    def project(
        offset: int,
        means: wp.array(dtype=vec3),
        log_scales: wp.array(dtype=vec3),
        quaternions: wp.array(dtype=vec4),
        opacity_logits: wp.array(dtype=real),
        poses: wp.array(dtype=mat44),
        intrinsics: wp.array(dtype=vec4),
        coefficients: vec4,
        lower: vec2,
        upper: vec2,
        radius_max: real,
        # outputs
        centers: wp.array(dtype=vec2),
        depths: wp.array(dtype=real),
        roots: wp.array(dtype=vec3),
        extents: wp.array(dtype=vec2),
        opacities: wp.array(dtype=real),
        depth_slopes: wp.array(dtype=vec2),
    ):
        i = wp.tid() + offset
        group = i // wp.static(POSE_GROUP)
        pose = poses[group]
        f = intrinsics[group]

        mean = means[i]
        scale = log_scales[i]
        q = quaternions[i]
        logit = opacity_logits[i]
        if not within(mean, coordinate_max) or not within(scale, log_scale_max):
            return
        if not within(vec3(q[0], q[1], q[2]), coordinate_max) or not (wp.abs(q[3]) < coordinate_max):
            return
        if not (logit > logit_min):  # no upper end: infinity is opacity 1
            return

        p = wp.transform_point(pose, mean)
        if not (p[2] >= near):
            return
        if not (wp.dot(q, q) >= quaternion_min):
            return
        opacity = one / (one + wp.exp(-logit))
        if not (opacity >= alpha_min):
            return

        inv_z = one / p[2]
        x = p[0] * inv_z
        y = p[1] * inv_z
        if not (x * x + y * y < radius_max * radius_max):
            return

        # Jacobian of the pixel in camera coordinates, no further out than the margin.
        xj = wp.clamp(x, lower[0], upper[0])
        yj = wp.clamp(y, lower[1], upper[1])
        d = distort_jacobian(xj, yj, coefficients)
        dx = vec3(inv_z, zero, -xj * inv_z)
        dy = vec3(zero, inv_z, -yj * inv_z)
        row_u = f[0] * (d[0, 0] * dx + d[0, 1] * dy)
        row_v = f[1] * (d[1, 0] * dx + d[1, 1] * dy)
        uv = distort(x, y, coefficients)

        # Rows of J W R S, whose Gram matrix is the projected covariance.
        world = wp.transpose(mat33(
            pose[0, 0], pose[0, 1], pose[0, 2],
            pose[1, 0], pose[1, 1], pose[1, 2],
            pose[2, 0], pose[2, 1], pose[2, 2],
        ))  # fmt: skip
        axes = wp.transpose(rotation_of(q))
        scales = vec3(wp.exp(scale[0]), wp.exp(scale[1]), wp.exp(scale[2]))
        a = wp.cw_mul(axes * (world * row_u), scales)
        b = wp.cw_mul(axes * (world * row_v), scales)
        a_even = vec3(zero, zero, zero)
        b_even = vec3(zero, zero, zero)
        if wp.static(unscented):
            if x == xj and y == yj:
                frame = axes * world
                ray = vec2(x, y)
                along_0 = spread(p, ray, uv, d, scales[0] * frame[0], coefficients, radius_max)
                along_1 = spread(p, ray, uv, d, scales[1] * frame[1], coefficients, radius_max)
                along_2 = spread(p, ray, uv, d, scales[2] * frame[2], coefficients, radius_max)
                a = f[0] * vec3(along_0[0], along_1[0], along_2[0])
                b = f[1] * vec3(along_0[1], along_1[1], along_2[1])
                a_even = f[0] * vec3(along_0[2], along_1[2], along_2[2])
                b_even = f[1] * vec3(along_0[3], along_1[3], along_2[3])

        aa = wp.dot(a, a)
        bb = wp.dot(b, b)
        ab = wp.dot(a, b)
        if wp.static(unscented):
            aa += wp.dot(a_even, a_even)
            bb += wp.dot(b_even, b_even)
            ab += wp.dot(a_even, b_even)
        if not (aa + bb < variance_max):
            return
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
        root = vec3(l11, -ab * inv_var_y * l11, wp.sqrt(inv_var_y))

        if wp.static(antialias):
            # The low-pass widens the splat; its opacity shrinks by the same ratio of areas. Below alpha_min
            # it is culled here, before the root of a number that can be zero.
            if not (opacity * opacity * area >= alpha_min_squared * det):
                return
            opacity = opacity * wp.sqrt(area * inv_det)

        center = vec2(f[0] * uv[0] + f[2], f[1] * uv[1] + f[3])
        if wp.static(unscented):
            center += root_half * vec2(a_even[0] + a_even[1] + a_even[2], b_even[0] + b_even[1] + b_even[2])
        centers[i] = center
        depths[i] = p[2]
        roots[i] = root
        opacities[i] = opacity
        if wp.static(circle):
            mid = half * (var_x + var_y)
            spread_of_variances = half * (var_x - var_y)
            under_root = spread_of_variances * spread_of_variances + ab * ab
            radius = circle_radius * wp.sqrt(mid + wp.sqrt(wp.max(under_root, circle_floor)))
            extents[i] = vec2(radius, radius)
        else:
            # Half width and height of the ellipse on which alpha falls to alpha_min.
            reach = wp.sqrt(two * wp.log(wp.max(opacity * inv_alpha_min, one)) + reach_guard)
            extents[i] = vec2(reach * wp.sqrt(var_x), reach * wp.sqrt(var_y))
        if wp.static(slopes):
            # Depth of the largest response along a pixel's ray is linear in the pixel: the mean of z given
            # the pixel, cov(z, pixel) times the inverse covariance.
            along_z = wp.cw_mul(axes * vec3(pose[2, 0], pose[2, 1], pose[2, 2]), scales)
            with_u = wp.dot(a, along_z)
            with_v = wp.dot(b, along_z)
            along_first = root[0] * with_u + root[1] * with_v
            along_second = root[2] * with_v
            depth_slopes[i] = vec2(root[0] * along_first, root[1] * along_first + root[2] * along_second)

    return project


def project(kind: Projecting, count: int, inputs: list, outputs: list, *, device: object) -> None:
    """Project `count` gaussians; outputs must hold zeros. Arguments as in the kernel, without slopes None."""
    launch(projection_kernel(kind), count, inputs, outputs, device=device, work=4, align=POSE_GROUP)


def project_adjoint(
    kind: Projecting,
    count: int,
    inputs: list,
    outputs: list,
    adj_inputs: list,
    adj_outputs: list,
    *,
    device: object,
) -> None:
    """Add the gradients of the inputs, given those of the outputs. Arguments as in the kernel."""
    launch(
        projection_kernel(kind), count, inputs, outputs,
        adj_inputs=adj_inputs, adj_outputs=adj_outputs, adjoint=True, device=device, work=8, align=POSE_GROUP,
    )  # fmt: skip
