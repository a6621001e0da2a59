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
from diga3d_warp.kernels.columns import Columns, columns_for, moves_of
from diga3d_warp.kernels.footprint import rotation_function
from diga3d_warp.kernels.lanes import total_function
from diga3d_warp.kernels.launch import OPTIONS, launch
from diga3d_warp.kernels.precision import REALS, types_of


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
def normals_kernel(columns: Columns, precision: str = "float32") -> wp.Kernel:
    """The kernel for one precision."""
    real, size = REALS[precision], columns.size
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
        begin = (wp.tid() + offset) * wp.static(columns.span)
        end = wp.min(begin + wp.static(columns.span), count)
        pose = poses[begin // wp.static(POSE_GROUP)]
        for first in range(begin, end, wp.static(size)):
            lanes = wp.min(wp.static(size), end - first)
            mean = load_vec3(means, first, lanes)
            scale = load_vec3(log_scales, first, lanes)
            q = load_vec4(quaternions, first, lanes)
            extent = load_vec2(extents, first, lanes)
            normal = in_3()
            for t in range(size):
                x, y, z = normal_of(
                    vec3(mean[0, t], mean[1, t], mean[2, t]),
                    vec3(scale[0, t], scale[1, t], scale[2, t]),
                    vec4(q[0, t], q[1, t], q[2, t], q[3, t]),
                    pose,
                )
                shown = extent[0, t] > zero
                normal[0, t] = wp.where(shown, x, zero)
                normal[1, t] = wp.where(shown, y, zero)
                normal[2, t] = wp.where(shown, z, zero)
            store_vec3(normals, first, lanes, normal)

    return orient


@cache
def adjoint_kernel(columns: Columns, precision: str = "float32") -> wp.Kernel:
    """The kernel that pulls gradients of the normals back."""
    real, size = REALS[precision], columns.size
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
        begin = (wp.tid() + offset) * wp.static(columns.span)
        end = wp.min(begin + wp.static(columns.span), count)
        group = begin // wp.static(POSE_GROUP)
        pose = poses[group]
        of_pose = rotation()
        for first in range(begin, end, wp.static(size)):
            lanes = wp.min(wp.static(size), end - first)
            mean = load_vec3(means, first, lanes)
            scale = load_vec3(log_scales, first, lanes)
            q = load_vec4(quaternions, first, lanes)
            extent = load_vec2(extents, first, lanes)
            g = load_vec3(adj_normals, first, lanes)
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
                shown = extent[0, t] > zero
                g_q[0, t] = wp.where(shown, d_q[0], zero)
                g_q[1, t] = wp.where(shown, d_q[1], zero)
                g_q[2, t] = wp.where(shown, d_q[2], zero)
                g_q[3, t] = wp.where(shown, d_q[3], zero)
                of_pose[0, t] += wp.where(shown, d_pose[0, 0], zero)
                of_pose[1, t] += wp.where(shown, d_pose[0, 1], zero)
                of_pose[2, t] += wp.where(shown, d_pose[0, 2], zero)
                of_pose[3, t] += wp.where(shown, d_pose[1, 0], zero)
                of_pose[4, t] += wp.where(shown, d_pose[1, 1], zero)
                of_pose[5, t] += wp.where(shown, d_pose[1, 2], zero)
                of_pose[6, t] += wp.where(shown, d_pose[2, 0], zero)
                of_pose[7, t] += wp.where(shown, d_pose[2, 1], zero)
                of_pose[8, t] += wp.where(shown, d_pose[2, 2], zero)
            store_vec4(adj_quaternions, first, lanes, g_q)
        g_pose = mat44(zero)
        for c in range(3):
            g_pose[0, wp.static(c)] = total(of_pose[wp.static(c)])
            g_pose[1, wp.static(c)] = total(of_pose[wp.static(3 + c)])
            g_pose[2, wp.static(c)] = total(of_pose[wp.static(6 + c)])
        if adj_poses:
            wp.atomic_add(adj_poses, group, g_pose)

    return orient_adjoint


def orient(count: int, inputs: list, outputs: list, *, device: object, precision: str = "float32") -> None:
    """Normals of `count` gaussians. Arguments as in the kernel."""
    columns = columns_for(device, calls=precision == "float64")
    launch(
        normals_kernel(columns, precision), -(-count // columns.span), [count, *inputs], outputs,
        device=device, work=columns.span,
    )  # fmt: skip


def orient_adjoint(
    count: int, inputs: list, outputs: list, *, device: object, precision: str = "float32"
) -> None:
    """Write the gradients of quaternions, and add those of poses.

    Arguments as in the kernel; None for what nobody wants.
    """
    columns = columns_for(device, calls=precision == "float64")
    launch(
        adjoint_kernel(columns, precision), -(-count // columns.span), [count, *inputs], outputs,
        device=device, work=columns.span,
    )  # fmt: skip
