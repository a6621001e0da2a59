"""Projection: gaussians become splats in the image plane, and gradients of splats those of gaussians.

Invariants
- A gaussian is visible if it passes all guards of `footprint` and its box touches a tile of the image, by the
  very function that bins it. Every other one is culled: extent (0, 0), exact zeros in every output, and a
  gradient of exactly zero. Its lane may compute NaN: results are chosen, never multiplied by zero, before
  they are stored or added up.
- The camera comes in rows, one for `POSE_GROUP` gaussians, all equal: each row collects the gradient of its
  own group. On CPU a group is one thread's.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import warp as wp

from diga3d_warp.config import POSE_GROUP
from diga3d_warp.kernels.cameras import lens_model
from diga3d_warp.kernels.footprint import Projecting, footprint
from diga3d_warp.kernels.gaussian_lanes import GaussianLanes, lanes_for, moves_of
from diga3d_warp.kernels.lanes import total_function
from diga3d_warp.kernels.launch import OPTIONS, launch
from diga3d_warp.kernels.precision import types_of
from diga3d_warp.kernels.splats import Splats
from diga3d_warp.kernels.tiles import tile_range


class Parameters(NamedTuple):
    """What a projection depends on and has gradients for: N gaussians and a camera.

    Attributes:
        means, log_scales: shape (N,), vec3.
        quaternions: (w, x, y, z), shape (N,), vec4.
        opacity_logits: shape (N,).
        poses: World to camera, one equal row for each `POSE_GROUP` gaussians, shape (G,), mat44. The gradient
            of the pose is the sum of the rows'.
        intrinsics: (fx, fy, cx, cy) [px], rows likewise, shape (G,), vec4.
    """

    means: wp.array | None
    log_scales: wp.array | None
    quaternions: wp.array | None
    opacity_logits: wp.array | None
    poses: wp.array | None
    intrinsics: wp.array | None


@dataclass(frozen=True, eq=False)
class Lens:
    """Lens, field of view and size of a camera's image.

    Attributes:
        lens_kind: "none", "brown" or "fisheye".
        coefficients: Lens coefficients, zeros for a pinhole.
        radius_max: Undistorted radius below which the lens is one to one [focal lengths]; at most 1e6.
        lower, upper: Undistorted (x/z, y/z) beyond which the EWA Jacobian is not followed.
        width, height: Image size [px]; gaussians that lie outside are culled.
    """

    lens_kind: str
    coefficients: tuple[float, ...]
    radius_max: float
    lower: tuple[float, float]
    upper: tuple[float, float]
    width: int
    height: int

    def arguments(self, real: Any) -> list[Any]:
        """What kernels of a scalar type take: coefficients, lower, upper, radius_max."""
        vec2 = types_of(real).vec2
        coefficients = lens_model(self.lens_kind, real).vector(*self.coefficients)
        return [coefficients, vec2(*self.lower), vec2(*self.upper), self.radius_max]


@cache
def projection_kernel(kind: Projecting, lanes: GaussianLanes) -> wp.Kernel:
    """The kernel for one way of projecting."""
    real, size = kind.real, lanes.size
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
        factors: wp.array(dtype=vec3),
        extents: wp.array(dtype=vec2),
        opacities: wp.array(dtype=real),
        depth_slopes: wp.array(dtype=vec2),
    ):
        begin = (wp.tid() + offset) * wp.static(lanes.span)
        end = wp.min(begin + wp.static(lanes.span), count)
        pose = poses[begin // wp.static(POSE_GROUP)]
        f = intrinsics[begin // wp.static(POSE_GROUP)]
        for first in range(begin, end, wp.static(size)):
            used = wp.min(wp.static(size), end - first)
            mean = load_vec3(means, first, used)
            scale = load_vec3(log_scales, first, used)
            q = load_vec4(quaternions, first, used)
            logit = load_real(opacity_logits, first, used)
            center = in_2(zero)
            depth = in_1(zero)
            factor = in_3(zero)
            extent = in_2(zero)
            opacity = in_1(zero)
            slope = in_2(zero)
            for t in range(size):
                x, y, z, factor_t, o, slope_x, slope_y, variances, seen = splat(
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
                factor[0, t] = wp.where(visible, factor_t[0], zero)
                factor[1, t] = wp.where(visible, factor_t[1], zero)
                factor[2, t] = wp.where(visible, factor_t[2], zero)
                extent[0, t] = wp.where(visible, half_width, zero)
                extent[1, t] = wp.where(visible, half_height, zero)
                opacity[0, t] = wp.where(visible, o, zero)
                if wp.static(kind.slopes):
                    slope[0, t] = wp.where(visible, slope_x, zero)
                    slope[1, t] = wp.where(visible, slope_y, zero)
            store_vec2(centers, first, used, center)
            store_real(depths, first, used, depth)
            store_vec3(factors, first, used, factor)
            store_vec2(extents, first, used, extent)
            store_real(opacities, first, used, opacity)
            if wp.static(kind.slopes):
                store_vec2(depth_slopes, first, used, slope)

    return project


@cache
def adjoint_kernel(kind: Projecting, lanes: GaussianLanes) -> wp.Kernel:
    """The kernel that pulls gradients back through one way of projecting."""
    real, size = kind.real, lanes.size
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
        adj_factors: wp.array(dtype=vec3),
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
        begin = (wp.tid() + offset) * wp.static(lanes.span)
        end = wp.min(begin + wp.static(lanes.span), count)
        group = begin // wp.static(POSE_GROUP)
        pose = poses[group]
        f = intrinsics[group]
        of_camera = camera(zero)
        for first in range(begin, end, wp.static(size)):
            used = wp.min(wp.static(size), end - first)
            mean = load_vec3(means, first, used)
            scale = load_vec3(log_scales, first, used)
            q = load_vec4(quaternions, first, used)
            logit = load_real(opacity_logits, first, used)
            extent = load_vec2(extents, first, used)
            of_center = load_vec2(adj_centers, first, used)
            of_depth = load_real(adj_depths, first, used)
            of_factor = load_vec3(adj_factors, first, used)
            of_opacity = load_real(adj_opacities, first, used)
            of_slope = in_2(zero)
            if wp.static(kind.slopes):
                of_slope = load_vec2(adj_depth_slopes, first, used)
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
                    vec3(of_factor[0, t], of_factor[1, t], of_factor[2, t]),
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
            store_vec3(adj_means, first, used, g_mean)
            store_vec3(adj_log_scales, first, used, g_scale)
            store_vec4(adj_quaternions, first, used, g_q)
            store_real(adj_opacity_logits, first, used, g_logit)
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


def project(kind: Projecting, parameters: Parameters, lens: Lens, splats: Splats) -> None:
    """Project gaussians.

    Args:
        kind: What to compile.
        parameters: N gaussians and the camera, of the precision of `kind`.
        lens: Lens, field of view and image size.
        splats: Outputs; slopes where `kind` asks for them.
    """
    count, device = parameters.means.shape[0], parameters.means.device
    lanes = lanes_for(device, calls=kind.calls)
    launch(
        projection_kernel(kind, lanes), -(-count // lanes.span),
        [count, *parameters, *lens.arguments(kind.real), lens.width, lens.height],
        [
            splats.centers, splats.depths, splats.factors, splats.extents, splats.opacities,
            splats.depth_slopes,
        ],
        device=device, work=lanes.span,
    )  # fmt: skip


def project_adjoint(
    kind: Projecting, parameters: Parameters, lens: Lens, extents: wp.array, adj_splats: Splats,
    adj_parameters: Parameters,
) -> None:  # fmt: skip
    """Write the gradients of the parameters, given those of the splats.

    Args:
        kind, parameters, lens: As in `project`.
        extents: From `project`.
        adj_splats: Gradients of what it made; that of the extents is not read.
        adj_parameters: Outputs; None for those that are not needed. Gradients of poses and intrinsics are
            added to what is there.
    """
    count, device = parameters.means.shape[0], parameters.means.device
    lanes = lanes_for(device, calls=kind.calls)
    launch(
        adjoint_kernel(kind, lanes), -(-count // lanes.span),
        [
            count, *parameters, *lens.arguments(kind.real), extents, adj_splats.centers, adj_splats.depths,
            adj_splats.factors, adj_splats.opacities, adj_splats.depth_slopes,
        ],
        adj_parameters, device=device, work=2 * lanes.span,
    )  # fmt: skip
