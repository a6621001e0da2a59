"""Normals: a gaussian flat enough to be a surface has the direction of its shortest axis.

Invariants
- Normals are in camera space (x right, y down, z forward), of unit length, and face the camera: their product
  with the direction from the camera to the mean is not positive. One seen exactly edge-on keeps its sign.
- Which axis is shortest, and its sign, are choices: they carry no gradient. So scales and means get none, and
  quaternions and the pose do. Of equally short axes the first is taken.
- Gaussians with extent (0, 0) are culled: normal zero, gradient zero.
"""

from functools import cache
from typing import Any, NamedTuple

import warp as wp

from diga3d_warp.config import POSE_GROUP
from diga3d_warp.kernels.footprint import rotation_function
from diga3d_warp.kernels.gaussian_lanes import GaussianLanes, lanes_for, moves_of
from diga3d_warp.kernels.lanes import total_function
from diga3d_warp.kernels.launch import OPTIONS, launch
from diga3d_warp.kernels.precision import REALS, precision_of, types_of


class Facing(NamedTuple):
    """Warp functions from a gaussian to its normal.

    Attributes:
        normal: (mean, log_scale, quaternion, pose) -> x, y, z.
        weighted: The same, then weights of x, y and z -> the weighted sum, whose derivative pulls gradients
            back to quaternion and pose.
    """

    normal: Any
    weighted: Any


@cache
def facing(real: Any) -> Facing:
    """The functions for one precision."""
    _, vec3, vec4, _, mat33, mat44 = types_of(real)
    rotation_of = rotation_function(real)
    zero, one = real(0.0), real(1.0)

    @wp.func
    def normal(mean: vec3, scale: vec3, q: vec4, pose: mat44):
        axes = wp.transpose(rotation_of(q))
        second = scale[1] < scale[0] and scale[1] <= scale[2]
        third = scale[2] < scale[0] and scale[2] < scale[1]
        x = wp.where(third, axes[2, 0], wp.where(second, axes[1, 0], axes[0, 0]))
        y = wp.where(third, axes[2, 1], wp.where(second, axes[1, 1], axes[0, 1]))
        z = wp.where(third, axes[2, 2], wp.where(second, axes[1, 2], axes[0, 2]))
        to_camera = mat33(
            pose[0, 0], pose[0, 1], pose[0, 2],
            pose[1, 0], pose[1, 1], pose[1, 2],
            pose[2, 0], pose[2, 1], pose[2, 2],
        )  # fmt: skip
        turned = to_camera * vec3(x, y, z)
        away = wp.dot(turned, wp.transform_point(pose, mean)) > zero
        sign = wp.where(away, -one, one)
        return sign * turned[0], sign * turned[1], sign * turned[2]

    @wp.func
    def weighted(mean: vec3, scale: vec3, q: vec4, pose: mat44, of_x: real, of_y: real, of_z: real) -> real:
        x, y, z = normal(mean, scale, q, pose)
        return of_x * x + of_y * y + of_z * z

    return Facing(normal, weighted)


@cache
def normals_kernel(lanes: GaussianLanes, precision: str = "float32") -> wp.Kernel:
    """The kernel for one precision."""
    real, size = REALS[precision], lanes.size
    vec2, vec3, vec4, _, _, mat44 = types_of(real)
    pairs, triples, quadruples = (moves_of(dtype, size) for dtype in (vec2, vec3, vec4))
    load_vec2, load_vec3, load_vec4, store_vec3 = pairs.load, triples.load, quadruples.load, triples.store
    in_3 = wp.types.matrix(shape=(3, size), dtype=real)
    normal_of = facing(real).normal
    zero = real(0.0)

    @wp.kernel(module="unique", module_options=OPTIONS)
    def orient(
        offset: int,
        count: int,
        means: wp.array(dtype=vec3),
        log_scales: wp.array(dtype=vec3),
        quaternions: wp.array(dtype=vec4),
        poses: wp.array(dtype=mat44),
        extents: wp.array(dtype=vec2),
        # outputs
        normals: wp.array(dtype=vec3),
    ):
        begin = (wp.tid() + offset) * wp.static(lanes.span)
        end = wp.min(begin + wp.static(lanes.span), count)
        pose = poses[begin // wp.static(POSE_GROUP)]
        for first in range(begin, end, wp.static(size)):
            used = wp.min(wp.static(size), end - first)
            mean = load_vec3(means, first, used)
            scale = load_vec3(log_scales, first, used)
            q = load_vec4(quaternions, first, used)
            extent = load_vec2(extents, first, used)
            normal = in_3()
            for t in range(size):
                x, y, z = normal_of(
                    vec3(mean[0, t], mean[1, t], mean[2, t]),
                    vec3(scale[0, t], scale[1, t], scale[2, t]),
                    vec4(q[0, t], q[1, t], q[2, t], q[3, t]),
                    pose,
                )
                visible = extent[0, t] > zero
                normal[0, t] = wp.where(visible, x, zero)
                normal[1, t] = wp.where(visible, y, zero)
                normal[2, t] = wp.where(visible, z, zero)
            store_vec3(normals, first, used, normal)

    return orient


@cache
def adjoint_kernel(lanes: GaussianLanes, precision: str = "float32") -> wp.Kernel:
    """The kernel that pulls gradients of the normals back."""
    real, size = REALS[precision], lanes.size
    vec2, vec3, vec4, _, _, mat44 = types_of(real)
    pairs, triples, quadruples = (moves_of(dtype, size) for dtype in (vec2, vec3, vec4))
    load_vec2, load_vec3, load_vec4, store_vec4 = pairs.load, triples.load, quadruples.load, quadruples.store
    in_4 = wp.types.matrix(shape=(4, size), dtype=real)
    rotation = wp.types.matrix(shape=(9, size), dtype=real)
    pulled = wp.grad(facing(real).weighted)
    total = total_function(size, real)
    zero = real(0.0)

    @wp.kernel(module="unique", module_options=OPTIONS)
    def orient_adjoint(
        offset: int,
        count: int,
        means: wp.array(dtype=vec3),
        log_scales: wp.array(dtype=vec3),
        quaternions: wp.array(dtype=vec4),
        poses: wp.array(dtype=mat44),
        extents: wp.array(dtype=vec2),
        adj_normals: wp.array(dtype=vec3),
        # outputs
        adj_quaternions: wp.array(dtype=vec4),
        adj_poses: wp.array(dtype=mat44),
    ):
        begin = (wp.tid() + offset) * wp.static(lanes.span)
        end = wp.min(begin + wp.static(lanes.span), count)
        group = begin // wp.static(POSE_GROUP)
        pose = poses[group]
        of_pose = rotation()
        for first in range(begin, end, wp.static(size)):
            used = wp.min(wp.static(size), end - first)
            mean = load_vec3(means, first, used)
            scale = load_vec3(log_scales, first, used)
            q = load_vec4(quaternions, first, used)
            extent = load_vec2(extents, first, used)
            g = load_vec3(adj_normals, first, used)
            g_q = in_4()
            for t in range(size):
                _mean, _scale, d_q, d_pose, _x, _y, _z = pulled(
                    vec3(mean[0, t], mean[1, t], mean[2, t]),
                    vec3(scale[0, t], scale[1, t], scale[2, t]),
                    vec4(q[0, t], q[1, t], q[2, t], q[3, t]),
                    pose,
                    g[0, t],
                    g[1, t],
                    g[2, t],
                )
                visible = extent[0, t] > zero
                g_q[0, t] = wp.where(visible, d_q[0], zero)
                g_q[1, t] = wp.where(visible, d_q[1], zero)
                g_q[2, t] = wp.where(visible, d_q[2], zero)
                g_q[3, t] = wp.where(visible, d_q[3], zero)
                of_pose[0, t] += wp.where(visible, d_pose[0, 0], zero)
                of_pose[1, t] += wp.where(visible, d_pose[0, 1], zero)
                of_pose[2, t] += wp.where(visible, d_pose[0, 2], zero)
                of_pose[3, t] += wp.where(visible, d_pose[1, 0], zero)
                of_pose[4, t] += wp.where(visible, d_pose[1, 1], zero)
                of_pose[5, t] += wp.where(visible, d_pose[1, 2], zero)
                of_pose[6, t] += wp.where(visible, d_pose[2, 0], zero)
                of_pose[7, t] += wp.where(visible, d_pose[2, 1], zero)
                of_pose[8, t] += wp.where(visible, d_pose[2, 2], zero)
            store_vec4(adj_quaternions, first, used, g_q)
        g_pose = mat44(zero)
        for c in range(3):
            g_pose[0, wp.static(c)] = total(of_pose[wp.static(c)])
            g_pose[1, wp.static(c)] = total(of_pose[wp.static(3 + c)])
            g_pose[2, wp.static(c)] = total(of_pose[wp.static(6 + c)])
        if adj_poses:
            wp.atomic_add(adj_poses, group, g_pose)

    return orient_adjoint


def orient(
    means: wp.array, log_scales: wp.array, quaternions: wp.array, poses: wp.array, extents: wp.array,
    normals: wp.array,
) -> None:  # fmt: skip
    """Find the normals of N gaussians, in the precision of the arrays.

    Args:
        means, log_scales, quaternions, poses: As in `projection.Parameters`.
        extents: From `projection`, shape (N,), vec2.
        normals: Output, shape (N,), vec3.
    """
    count, device, precision = means.shape[0], means.device, precision_of(means)
    lanes = lanes_for(device, calls=precision == "float64")
    launch(
        normals_kernel(lanes, precision), -(-count // lanes.span),
        [count, means, log_scales, quaternions, poses, extents], [normals],
        device=device, work=lanes.span,
    )  # fmt: skip


def orient_adjoint(
    means: wp.array, log_scales: wp.array, quaternions: wp.array, poses: wp.array, extents: wp.array,
    adj_normals: wp.array, adj_quaternions: wp.array | None, adj_poses: wp.array | None,
) -> None:  # fmt: skip
    """Write the gradients of quaternions, and add those of poses.

    Args:
        means, log_scales, quaternions, poses, extents: As in `orient`.
        adj_normals: Gradients of the normals.
        adj_quaternions, adj_poses: Outputs; None for those that are not needed.
    """
    count, device, precision = means.shape[0], means.device, precision_of(means)
    lanes = lanes_for(device, calls=precision == "float64")
    launch(
        adjoint_kernel(lanes, precision), -(-count // lanes.span),
        [count, means, log_scales, quaternions, poses, extents, adj_normals], [adj_quaternions, adj_poses],
        device=device, work=lanes.span,
    )  # fmt: skip
