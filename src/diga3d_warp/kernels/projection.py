"""EWA projection: a 3D gaussian becomes a 2D one (Zwicker et al. 2001; paper Sec. 3, Preliminary).

Invariants
- Sigma' = J W Sigma W^T J^T is formed as the Gram matrix of two rows, so it is positive semi-definite in
  floating point too, and its determinant is a sum of squares: |a x b|^2 + e (|a|^2 + |b|^2) + e^2 with the
  low-pass e. The textbook a d - b^2 loses all digits on needles.
- A culled gaussian has extent (0, 0) and exact zeros in every output; its gradient is exactly zero.
- Every guard is written positively, `if not (x >= limit)`, so that NaN fails it.
- Broken input is culled before any arithmetic: the adjoint of a product multiplies by the other factor, and
  zero times infinity or NaN would reach the camera's gradient.
- The camera comes in rows, one for `POSE_GROUP` gaussians, all equal: each row collects the gradient of its
  own group.
"""

from __future__ import annotations

from functools import cache

import warp as wp

from diga3d_warp.config import POSE_GROUP, SPLATTING
from diga3d_warp.kernels.cameras import lens_model
from diga3d_warp.kernels.launch import DIFFERENTIABLE, launch

_S = SPLATTING


@wp.func
def rotation_of(q: wp.vec4) -> wp.mat33:
    """Rotation of a quaternion (w, x, y, z), not necessarily of unit length."""
    n = q * (1.0 / wp.length(q))
    w = n[0]
    x = n[1]
    y = n[2]
    z = n[3]
    return wp.mat33(
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y),
        2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x),
        2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y),
    )  # fmt: skip


@wp.func
def within(v: wp.vec3, limit: float) -> bool:
    return wp.abs(v[0]) < limit and wp.abs(v[1]) < limit and wp.abs(v[2]) < limit


@wp.func
def sigmoid(x: float) -> float:
    return 1.0 / (1.0 + wp.exp(-x))


@cache
def projection_kernel(lens_kind: str) -> wp.Kernel:
    """The kernel for one kind of lens: "none", "brown" or "fisheye"."""
    lens = lens_model(lens_kind)
    distort = lens.distort
    distort_jacobian = lens.distort_jacobian

    @wp.kernel(module="unique", module_options=DIFFERENTIABLE)
    def project(
        offset: int,
        means: wp.array(dtype=wp.vec3),
        log_scales: wp.array(dtype=wp.vec3),
        quaternions: wp.array(dtype=wp.vec4),
        opacity_logits: wp.array(dtype=float),
        poses: wp.array(dtype=wp.mat44),
        intrinsics: wp.array(dtype=wp.vec4),
        coefficients: wp.vec4,
        lower: wp.vec2,
        upper: wp.vec2,
        radius_max: float,
        # outputs
        centers: wp.array(dtype=wp.vec2),
        depths: wp.array(dtype=float),
        conics: wp.array(dtype=wp.vec3),
        extents: wp.array(dtype=wp.vec2),
        opacities: wp.array(dtype=float),
    ):
        i = wp.tid() + offset
        group = i // wp.static(POSE_GROUP)
        pose = poses[group]
        f = intrinsics[group]

        mean = means[i]
        scale = log_scales[i]
        q = quaternions[i]
        logit = opacity_logits[i]
        limit = wp.static(_S.coordinate_max)
        if not within(mean, limit) or not within(scale, wp.static(_S.log_scale_max)):
            return
        if not within(wp.vec3(q[0], q[1], q[2]), limit) or not (wp.abs(q[3]) < limit):
            return
        if not (logit > wp.static(_S.logit_min)):  # no upper end: infinity is opacity 1
            return

        p = wp.transform_point(pose, mean)
        if not (p[2] >= wp.static(_S.near)):
            return
        if not (wp.dot(q, q) >= wp.static(_S.quaternion_min)):
            return
        opacity = sigmoid(logit)
        if not (opacity >= wp.static(_S.alpha_min)):
            return

        inv_z = 1.0 / p[2]
        x = p[0] * inv_z
        y = p[1] * inv_z
        if not (x * x + y * y < radius_max * radius_max):
            return

        # Jacobian of the pixel in camera coordinates, no further out than the margin.
        xj = wp.clamp(x, lower[0], upper[0])
        yj = wp.clamp(y, lower[1], upper[1])
        d = distort_jacobian(xj, yj, coefficients)
        dx = wp.vec3(inv_z, 0.0, -xj * inv_z)
        dy = wp.vec3(0.0, inv_z, -yj * inv_z)
        row_u = f[0] * (d[0, 0] * dx + d[0, 1] * dy)
        row_v = f[1] * (d[1, 0] * dx + d[1, 1] * dy)

        # Rows of J W R S, whose Gram matrix is the projected covariance.
        world = wp.transpose(wp.mat33(
            pose[0, 0], pose[0, 1], pose[0, 2],
            pose[1, 0], pose[1, 1], pose[1, 2],
            pose[2, 0], pose[2, 1], pose[2, 2],
        ))  # fmt: skip
        axes = wp.transpose(rotation_of(q))
        scales = wp.vec3(wp.exp(scale[0]), wp.exp(scale[1]), wp.exp(scale[2]))
        a = wp.cw_mul(axes * (world * row_u), scales)
        b = wp.cw_mul(axes * (world * row_v), scales)

        aa = wp.dot(a, a)
        bb = wp.dot(b, b)
        ab = wp.dot(a, b)
        if not (aa + bb < wp.static(_S.variance_max)):
            return
        n = wp.cross(a, b)
        low_pass = wp.static(_S.low_pass)
        det = wp.dot(n, n) + low_pass * (aa + bb) + low_pass * low_pass
        if not (det >= wp.static(_S.determinant_min)):
            return
        var_x = aa + low_pass
        var_y = bb + low_pass
        inv_det = 1.0 / det

        uv = distort(x, y, coefficients)
        # Half width and height of the ellipse on which alpha falls to alpha_min.
        reach = wp.sqrt(2.0 * wp.log(wp.max(opacity * wp.static(1.0 / _S.alpha_min), 1.0)) + 1.0e-6)

        centers[i] = wp.vec2(f[0] * uv[0] + f[2], f[1] * uv[1] + f[3])
        depths[i] = p[2]
        conics[i] = wp.vec3(var_y * inv_det, -ab * inv_det, var_x * inv_det)
        extents[i] = wp.vec2(reach * wp.sqrt(var_x), reach * wp.sqrt(var_y))
        opacities[i] = opacity

    return project


def project(lens_kind: str, count: int, inputs: list, outputs: list, *, device: object) -> None:
    """Project `count` gaussians; outputs must hold zeros. Arguments as in the kernel."""
    launch(projection_kernel(lens_kind), count, inputs, outputs, device=device, work=4, align=POSE_GROUP)


def project_adjoint(
    lens_kind: str,
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
        projection_kernel(lens_kind), count, inputs, outputs,
        adj_inputs=adj_inputs, adj_outputs=adj_outputs, adjoint=True, device=device, work=8, align=POSE_GROUP,
    )  # fmt: skip
