"""Projection: gaussians become splats in the image plane, and gradients of splats those of gaussians.

Invariants
- A gaussian is visible if it passes all guards of `footprint` and its box touches a tile of the image, by the
  very function that bins it. Every other one is culled: extent (0, 0), exact zeros in every output, and a
  gradient of exactly zero. Its lane may compute NaN: results are chosen, never multiplied by zero, before
  they are stored or added up.
- The camera comes in rows, one for `POSE_GROUP` gaussians, all equal: each row collects the gradient of its
  own group. On CPU a group is one thread's.
"""

from functools import cache

import warp as wp

from diga3d_warp.config import POSE_GROUP
from diga3d_warp.kernels.cameras import lens_model
from diga3d_warp.kernels.columns import Columns, columns_for, moves_of
from diga3d_warp.kernels.footprint import Projecting, footprint
from diga3d_warp.kernels.lanes import total_function
from diga3d_warp.kernels.launch import OPTIONS, launch
from diga3d_warp.kernels.precision import types_of
from diga3d_warp.kernels.tiles import tile_range


@cache
def projection_kernel(kind: Projecting, columns: Columns) -> wp.Kernel:
    """The kernel for one way of projecting."""
    real, size = kind.real, columns.size
    vec2, vec3, vec4, _, _, mat44 = types_of(real)
    splat, box, _ = footprint(kind)
    vector = lens_model(kind.lens_kind, real).vector
    first_tile, end_tile = tile_range(real)
    pairs, triples, quadruples, singles = (moves_of(dtype, size) for dtype in (vec2, vec3, vec4, real))
    load_vec3, load_vec4, load_real = triples.load, quadruples.load, singles.load
    store_vec2, store_vec3, store_real = pairs.store, triples.store, singles.store
    in_2, in_3, in_1 = (wp.types.matrix(shape=(length, size), dtype=real) for length in (2, 3, 1))
    zero = real(0.0)

    @wp.kernel(module="unique", module_options=OPTIONS)
    def project(
        offset: int,
        count: int,
        means: wp.array(dtype=vec3),
        log_scales: wp.array(dtype=vec3),
        quaternions: wp.array(dtype=vec4),
        opacity_logits: wp.array(dtype=real),
        poses: wp.array(dtype=mat44),
        intrinsics: wp.array(dtype=vec4),
        coefficients: vector,
        lower: vec2,
        upper: vec2,
        radius_max: real,
        width: int,
        height: int,
        # outputs
        centers: wp.array(dtype=vec2),
        depths: wp.array(dtype=real),
        roots: wp.array(dtype=vec3),
        extents: wp.array(dtype=vec2),
        opacities: wp.array(dtype=real),
        depth_slopes: wp.array(dtype=vec2),
    ):
        begin = (wp.tid() + offset) * wp.static(columns.span)
        end = wp.min(begin + wp.static(columns.span), count)
        pose = poses[begin // wp.static(POSE_GROUP)]
        f = intrinsics[begin // wp.static(POSE_GROUP)]
        for first in range(begin, end, wp.static(size)):
            lanes = wp.min(wp.static(size), end - first)
            mean = load_vec3(means, first, lanes)
            scale = load_vec3(log_scales, first, lanes)
            q = load_vec4(quaternions, first, lanes)
            logit = load_real(opacity_logits, first, lanes)
            center = in_2(zero)
            depth = in_1(zero)
            root = in_3(zero)
            extent = in_2(zero)
            opacity = in_1(zero)
            slope = in_2(zero)
            for t in range(size):
                x, y, z, root_t, o, slope_x, slope_y, variances, seen = splat(
                    vec3(mean[0, t], mean[1, t], mean[2, t]),
                    vec3(scale[0, t], scale[1, t], scale[2, t]),
                    vec4(q[0, t], q[1, t], q[2, t], q[3, t]),
                    logit[0, t],
                    pose, f, coefficients, lower, upper, radius_max,
                )  # fmt: skip
                half_width, half_height = box(o, variances)
                left = first_tile(x, half_width, width)
                top = first_tile(y, half_height, height)
                seen = seen & wp.where(end_tile(x, half_width, left, width) > left, 1, 0)
                seen = seen & wp.where(end_tile(y, half_height, top, height) > top, 1, 0)
                visible = seen != 0
                center[0, t] = wp.where(visible, x, zero)
                center[1, t] = wp.where(visible, y, zero)
                depth[0, t] = wp.where(visible, z, zero)
                root[0, t] = wp.where(visible, root_t[0], zero)
                root[1, t] = wp.where(visible, root_t[1], zero)
                root[2, t] = wp.where(visible, root_t[2], zero)
                extent[0, t] = wp.where(visible, half_width, zero)
                extent[1, t] = wp.where(visible, half_height, zero)
                opacity[0, t] = wp.where(visible, o, zero)
                if wp.static(kind.slopes):
                    slope[0, t] = wp.where(visible, slope_x, zero)
                    slope[1, t] = wp.where(visible, slope_y, zero)
            store_vec2(centers, first, lanes, center)
            store_real(depths, first, lanes, depth)
            store_vec3(roots, first, lanes, root)
            store_vec2(extents, first, lanes, extent)
            store_real(opacities, first, lanes, opacity)
            if wp.static(kind.slopes):
                store_vec2(depth_slopes, first, lanes, slope)

    return project


@cache
def adjoint_kernel(kind: Projecting, columns: Columns) -> wp.Kernel:
    """The kernel that pulls gradients back through one way of projecting."""
    real, size = kind.real, columns.size
    vec2, vec3, vec4, _, _, mat44 = types_of(real)
    pulled = wp.grad(footprint(kind).weighted)
    vector = lens_model(kind.lens_kind, real).vector
    pairs, triples, quadruples, singles = (moves_of(dtype, size) for dtype in (vec2, vec3, vec4, real))
    load_vec2, load_vec3, load_vec4, load_real = pairs.load, triples.load, quadruples.load, singles.load
    store_vec3, store_vec4, store_real = triples.store, quadruples.store, singles.store
    in_3, in_4, in_1 = (wp.types.matrix(shape=(length, size), dtype=real) for length in (3, 4, 1))
    in_2 = wp.types.matrix(shape=(2, size), dtype=real)
    camera = wp.types.matrix(shape=(16, size), dtype=real)
    total = total_function(size, real)
    zero = real(0.0)

    @wp.kernel(module="unique", module_options=OPTIONS)
    def project_adjoint(
        offset: int,
        count: int,
        means: wp.array(dtype=vec3),
        log_scales: wp.array(dtype=vec3),
        quaternions: wp.array(dtype=vec4),
        opacity_logits: wp.array(dtype=real),
        poses: wp.array(dtype=mat44),
        intrinsics: wp.array(dtype=vec4),
        coefficients: vector,
        lower: vec2,
        upper: vec2,
        radius_max: real,
        extents: wp.array(dtype=vec2),
        adj_centers: wp.array(dtype=vec2),
        adj_depths: wp.array(dtype=real),
        adj_roots: wp.array(dtype=vec3),
        adj_opacities: wp.array(dtype=real),
        adj_depth_slopes: wp.array(dtype=vec2),
        # outputs
        adj_means: wp.array(dtype=vec3),
        adj_log_scales: wp.array(dtype=vec3),
        adj_quaternions: wp.array(dtype=vec4),
        adj_opacity_logits: wp.array(dtype=real),
        adj_poses: wp.array(dtype=mat44),
        adj_intrinsics: wp.array(dtype=vec4),
    ):
        begin = (wp.tid() + offset) * wp.static(columns.span)
        end = wp.min(begin + wp.static(columns.span), count)
        group = begin // wp.static(POSE_GROUP)
        pose = poses[group]
        f = intrinsics[group]
        of_camera = camera(zero)
        for first in range(begin, end, wp.static(size)):
            lanes = wp.min(wp.static(size), end - first)
            mean = load_vec3(means, first, lanes)
            scale = load_vec3(log_scales, first, lanes)
            q = load_vec4(quaternions, first, lanes)
            logit = load_real(opacity_logits, first, lanes)
            extent = load_vec2(extents, first, lanes)
            of_center = load_vec2(adj_centers, first, lanes)
            of_depth = load_real(adj_depths, first, lanes)
            of_root = load_vec3(adj_roots, first, lanes)
            of_opacity = load_real(adj_opacities, first, lanes)
            of_slope = in_2(zero)
            if wp.static(kind.slopes):
                of_slope = load_vec2(adj_depth_slopes, first, lanes)
            g_mean = in_3(zero)
            g_scale = in_3(zero)
            g_q = in_4(zero)
            g_logit = in_1(zero)
            for t in range(size):
                (
                    d_mean, d_scale, d_q, d_logit, d_pose, d_f,
                    _0, _1, _2, _3, _4, _5, _6, _7, _8, _9, _10,
                ) = pulled(
                    vec3(mean[0, t], mean[1, t], mean[2, t]),
                    vec3(scale[0, t], scale[1, t], scale[2, t]),
                    vec4(q[0, t], q[1, t], q[2, t], q[3, t]),
                    logit[0, t],
                    pose, f, coefficients, lower, upper, radius_max,
                    of_center[0, t],
                    of_center[1, t],
                    of_depth[0, t],
                    vec3(of_root[0, t], of_root[1, t], of_root[2, t]),
                    of_opacity[0, t],
                    of_slope[0, t],
                    of_slope[1, t],
                )  # fmt: skip
                visible = extent[0, t] > zero
                g_mean[0, t] = wp.where(visible, d_mean[0], zero)
                g_mean[1, t] = wp.where(visible, d_mean[1], zero)
                g_mean[2, t] = wp.where(visible, d_mean[2], zero)
                g_scale[0, t] = wp.where(visible, d_scale[0], zero)
                g_scale[1, t] = wp.where(visible, d_scale[1], zero)
                g_scale[2, t] = wp.where(visible, d_scale[2], zero)
                g_q[0, t] = wp.where(visible, d_q[0], zero)
                g_q[1, t] = wp.where(visible, d_q[1], zero)
                g_q[2, t] = wp.where(visible, d_q[2], zero)
                g_q[3, t] = wp.where(visible, d_q[3], zero)
                of_camera[0, t] += wp.where(visible, d_pose[0, 0], zero)
                of_camera[1, t] += wp.where(visible, d_pose[0, 1], zero)
                of_camera[2, t] += wp.where(visible, d_pose[0, 2], zero)
                of_camera[3, t] += wp.where(visible, d_pose[0, 3], zero)
                of_camera[4, t] += wp.where(visible, d_pose[1, 0], zero)
                of_camera[5, t] += wp.where(visible, d_pose[1, 1], zero)
                of_camera[6, t] += wp.where(visible, d_pose[1, 2], zero)
                of_camera[7, t] += wp.where(visible, d_pose[1, 3], zero)
                of_camera[8, t] += wp.where(visible, d_pose[2, 0], zero)
                of_camera[9, t] += wp.where(visible, d_pose[2, 1], zero)
                of_camera[10, t] += wp.where(visible, d_pose[2, 2], zero)
                of_camera[11, t] += wp.where(visible, d_pose[2, 3], zero)
                of_camera[12, t] += wp.where(visible, d_f[0], zero)
                of_camera[13, t] += wp.where(visible, d_f[1], zero)
                of_camera[14, t] += wp.where(visible, d_f[2], zero)
                of_camera[15, t] += wp.where(visible, d_f[3], zero)
                g_logit[0, t] = wp.where(visible, d_logit, zero)
            store_vec3(adj_means, first, lanes, g_mean)
            store_vec3(adj_log_scales, first, lanes, g_scale)
            store_vec4(adj_quaternions, first, lanes, g_q)
            store_real(adj_opacity_logits, first, lanes, g_logit)
        g_pose = mat44(zero)
        g_f = vec4(zero)
        for c in range(4):
            g_pose[0, wp.static(c)] = total(of_camera[wp.static(c)])
            g_pose[1, wp.static(c)] = total(of_camera[wp.static(4 + c)])
            g_pose[2, wp.static(c)] = total(of_camera[wp.static(8 + c)])
            g_f[wp.static(c)] = total(of_camera[wp.static(12 + c)])
        if adj_poses:
            wp.atomic_add(adj_poses, group, g_pose)
        if adj_intrinsics:
            wp.atomic_add(adj_intrinsics, group, g_f)

    return project_adjoint


def project(
    kind: Projecting, count: int, inputs: list, width: int, height: int, outputs: list, *, device: object
) -> None:
    """Project `count` gaussians into an image of `width` x `height` px.

    Arguments as in the kernel; without slopes their output is None.
    """
    columns = columns_for(device, calls=kind.calls)
    launch(
        projection_kernel(kind, columns), -(-count // columns.span), [count, *inputs, width, height],
        outputs, device=device, work=columns.span,
    )  # fmt: skip


def project_adjoint(
    kind: Projecting, count: int, inputs: list, extents: wp.array, adj_outputs: list, adj_inputs: list,
    *, device: object,
) -> None:  # fmt: skip
    """Write the gradients of the inputs, given those of the outputs.

    Args:
        kind, count, inputs: As in `project`.
        extents: From `project`.
        adj_outputs: Gradients of centers, depths, roots, opacities and depth_slopes.
        adj_inputs: Gradients of means, log_scales, quaternions and opacity_logits, and, added to what is
            there, of poses and intrinsics; each None if nobody wants it.
    """
    columns = columns_for(device, calls=kind.calls)
    launch(
        adjoint_kernel(kind, columns), -(-count // columns.span), [count, *inputs, extents, *adj_outputs],
        adj_inputs, device=device, work=2 * columns.span,
    )  # fmt: skip
