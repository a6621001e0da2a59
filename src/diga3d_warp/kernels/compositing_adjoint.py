"""Adjoint of compositing: gradients of the splats from those of colour, depth and transmittance.

Blocks, lanes and the order of gaussians are those of `compositing`; blocks that a gaussian did not change are
not visited.

Invariants
- It walks front to back like the forward pass, and keeps R, the part of the pixel's weighted sum that is
  still behind: R = g.C + T_end g_T at first, then R -= w (c.g). No index of the last gaussian and no division
  by a small T is needed; 1 - alpha is at least 1 - alpha_max.
- On CPU a pair belongs to one region: its gradient row is written once, or stays zero. Rows of one gaussian
  are then added in the order of its emissions.
"""

from __future__ import annotations

from functools import cache

import warp as wp

from diga3d_warp.config import SPLATTING, TILE
from diga3d_warp.kernels.binning import Bins
from diga3d_warp.kernels.compositing import Lanes, block_range, falloff, lanes_of, notes_changes
from diga3d_warp.kernels.launch import OPTIONS, launch

wp.set_module_options(OPTIONS)

_S = SPLATTING

GradientRow = wp.types.vector(10, float)
"""Gradient of one (tile, gaussian) pair: centre (2), conic (3), opacity, colour (3), depth."""


@wp.func_native("""
#ifdef __CUDA_ARCH__
return __ffs(bits) - 1;
#else
return __builtin_ctz(bits);
#endif
""")
def lowest_bit(bits: int) -> int: ...


@cache
def adjoint_kernel(lanes: Lanes, with_depth: bool) -> wp.Kernel:
    """Gradient rows of all pairs, from the gradients of colour, depth and transmittance."""
    width, height = lanes.block_width, lanes.block_height
    across, down = lanes.region // width, lanes.region // height
    blocks, size = across * down, width * height
    per_tile = TILE // lanes.region
    notes = notes_changes(lanes)
    shared = per_tile > 1
    vec = wp.types.vector(length=size, dtype=float)
    ints = wp.types.vector(length=size, dtype=int)

    @wp.kernel(module="unique", module_options=OPTIONS)
    def composite_adjoint(
        offset: int,
        columns: int,
        image_width: int,
        image_height: int,
        starts: wp.array(dtype=int),
        gaussians: wp.array(dtype=int),
        centers: wp.array(dtype=wp.vec2),
        extents: wp.array(dtype=wp.vec2),
        conics: wp.array(dtype=wp.vec3),
        opacities: wp.array(dtype=float),
        colors: wp.array(dtype=wp.vec3),
        depths: wp.array(dtype=float),
        image: wp.array(dtype=wp.vec3),
        depth_sum: wp.array(dtype=float),
        transmittance: wp.array(dtype=float),
        changes: wp.array(dtype=int),
        adj_image: wp.array(dtype=wp.vec3),
        adj_depth_sum: wp.array(dtype=float),
        adj_transmittance: wp.array(dtype=float),
        # outputs
        gradients: wp.array(dtype=GradientRow),
    ):
        index = wp.tid() + offset
        tile = index // wp.static(per_tile * per_tile)
        part = index % wp.static(per_tile * per_tile)
        x0 = (tile % columns) * wp.static(TILE) + (part % wp.static(per_tile)) * wp.static(lanes.region)
        y0 = (tile // columns) * wp.static(TILE) + (part // wp.static(per_tile)) * wp.static(lanes.region)

        T = wp.zeros(shape=wp.static(blocks), dtype=vec)
        R = wp.zeros(shape=wp.static(blocks), dtype=vec)
        g_red = wp.zeros(shape=wp.static(blocks), dtype=vec)
        g_green = wp.zeros(shape=wp.static(blocks), dtype=vec)
        g_blue = wp.zeros(shape=wp.static(blocks), dtype=vec)
        g_far = wp.zeros(shape=wp.static(blocks), dtype=vec)
        live = wp.zeros(shape=wp.static(blocks), dtype=ints)
        inside = int(0)
        for block in range(wp.static(blocks)):
            R_b = vec(0.0)
            gr = vec(0.0)
            gg = vec(0.0)
            gb = vec(0.0)
            gf = vec(0.0)
            for q in range(size):
                x = x0 + (block % across) * width + q % width
                y = y0 + (block // across) * height + q // width
                if x < image_width and y < image_height:
                    pixel = y * image_width + x
                    g = adj_image[pixel]
                    gr[q] = g[0]
                    gg[q] = g[1]
                    gb[q] = g[2]
                    behind = wp.dot(image[pixel], g) + transmittance[pixel] * adj_transmittance[pixel]
                    if wp.static(with_depth):
                        gf[q] = adj_depth_sum[pixel]
                        behind += depth_sum[pixel] * adj_depth_sum[pixel]
                    R_b[q] = behind
                    inside = 1
            T[block] = vec(1.0)
            live[block] = ints(1)
            R[block] = R_b
            g_red[block] = gr
            g_green[block] = gg
            g_blue[block] = gb
            g_far[block] = gf

        for j in range(starts[tile], starts[tile + 1]):
            remaining = inside
            if wp.static(notes):
                remaining = changes[j]
            i = gaussians[j]
            if wp.static(not notes):
                box = block_range(centers[i], extents[i], x0, y0, width, height)
                if box[0] >= box[1] or box[2] >= box[3]:
                    remaining = 0
            if remaining == 0:
                continue
            center = centers[i]
            conic = conics[i]
            color = colors[i]
            opacity = opacities[i]
            a = -0.5 * conic[0]
            b = -conic[1]
            c = -0.5 * conic[2]
            gx = center[0] - float(x0) - 0.5
            gy = center[1] - float(y0) - 0.5
            z = float(0.0)
            if wp.static(with_depth):
                z = depths[i]
            sum_p = vec(0.0)
            sum_x = vec(0.0)
            sum_y = vec(0.0)
            sum_xx = vec(0.0)
            sum_xy = vec(0.0)
            sum_yy = vec(0.0)
            sum_r = vec(0.0)
            sum_g = vec(0.0)
            sum_b = vec(0.0)
            sum_z = vec(0.0)
            while remaining != 0:
                block = lowest_bit(remaining)
                remaining = remaining & (remaining - 1)
                bx = block % across
                by = block // across
                bgx = gx - float(bx * width)
                bgy = gy - float(by * height)
                T_b = T[block]
                R_b = R[block]
                live_b = live[block]
                gr = g_red[block]
                gg = g_green[block]
                gb = g_blue[block]
                gf = g_far[block]
                any_live = int(0)
                for q in range(size):
                    dx = bgx - float(q % width)
                    dy = bgy - float(q // width)
                    raw = opacity * falloff((a * dx + b * dy) * dx + c * dy * dy)
                    alpha = wp.where(raw < wp.static(_S.alpha_max), raw, wp.static(_S.alpha_max))
                    alpha = wp.where(alpha < wp.static(_S.alpha_min), 0.0, alpha)
                    w = alpha * T_b[q]
                    alive = wp.where(T_b[q] - w < wp.static(_S.transmittance_min), 0, live_b[q])
                    live_b[q] = alive
                    w = wp.where(alive > 0, w, 0.0)
                    along = color[0] * gr[q] + color[1] * gg[q] + color[2] * gb[q]
                    if wp.static(with_depth):
                        along = along + z * gf[q]
                    behind = R_b[q] - w * along
                    R_b[q] = behind
                    g_alpha = T_b[q] * along - behind / (1.0 - alpha)
                    T_b[q] = T_b[q] - w
                    g_power = wp.where(raw < wp.static(_S.alpha_max), raw * g_alpha, 0.0)
                    g_power = wp.where(w > 0.0, g_power, 0.0)
                    sum_p[q] = sum_p[q] + g_power
                    sum_x[q] = sum_x[q] + g_power * dx
                    sum_y[q] = sum_y[q] + g_power * dy
                    sum_xx[q] = sum_xx[q] + g_power * dx * dx
                    sum_xy[q] = sum_xy[q] + g_power * dx * dy
                    sum_yy[q] = sum_yy[q] + g_power * dy * dy
                    sum_r[q] = sum_r[q] + w * gr[q]
                    sum_g[q] = sum_g[q] + w * gg[q]
                    sum_b[q] = sum_b[q] + w * gb[q]
                    if wp.static(with_depth):
                        sum_z[q] = sum_z[q] + w * gf[q]
                    any_live = any_live | alive
                T[block] = T_b
                R[block] = R_b
                live[block] = live_b
                if wp.static(not notes):
                    inside = any_live

            p = float(0.0)
            px = float(0.0)
            py = float(0.0)
            pxx = float(0.0)
            pxy = float(0.0)
            pyy = float(0.0)
            w_red = float(0.0)
            w_green = float(0.0)
            w_blue = float(0.0)
            w_far = float(0.0)
            for q in range(size):
                p += sum_p[q]
                px += sum_x[q]
                py += sum_y[q]
                pxx += sum_xx[q]
                pxy += sum_xy[q]
                pyy += sum_yy[q]
                w_red += sum_r[q]
                w_green += sum_g[q]
                w_blue += sum_b[q]
                w_far += sum_z[q]
            # power = -0.5 (A dx^2 + C dy^2) - B dx dy with dx = center - pixel
            row = GradientRow(
                -(conic[0] * px + conic[1] * py), -(conic[1] * px + conic[2] * py),
                -0.5 * pxx, -pxy, -0.5 * pyy, p / opacity, w_red, w_green, w_blue, w_far,
            )  # fmt: skip
            if wp.static(shared):
                wp.atomic_add(gradients, j, row)
            else:
                gradients[j] = row

    return composite_adjoint


@wp.kernel
def gather_gradients(
    offset: int,
    order: wp.array(dtype=int),
    first: wp.array(dtype=int),
    slots: wp.array(dtype=int),
    gradients: wp.array(dtype=GradientRow),
    # outputs
    adj_centers: wp.array(dtype=wp.vec2),
    adj_conics: wp.array(dtype=wp.vec3),
    adj_opacities: wp.array(dtype=float),
    adj_colors: wp.array(dtype=wp.vec3),
    adj_depths: wp.array(dtype=float),
):
    k = wp.tid() + offset
    row = GradientRow(0.0)
    for emission in range(first[k], first[k + 1]):
        row = row + gradients[slots[emission]]
    i = order[k]
    adj_centers[i] = adj_centers[i] + wp.vec2(row[0], row[1])
    adj_conics[i] = adj_conics[i] + wp.vec3(row[2], row[3], row[4])
    adj_opacities[i] = adj_opacities[i] + row[5]
    adj_colors[i] = adj_colors[i] + wp.vec3(row[6], row[7], row[8])
    adj_depths[i] = adj_depths[i] + row[9]


def composite_adjoint(
    bins: Bins, width: int, height: int, splats: list, outputs: list, changes: wp.array, adj_outputs: list,
    adj_splats: list, *, with_depth: bool,
) -> None:  # fmt: skip
    """Add the gradients of the splats, given those of the outputs of `composite`.

    Args:
        bins, width, height, splats, outputs: As in `composite`, after it ran.
        changes: What it returned.
        adj_outputs: Gradients of image, depth_sum and transmittance.
        adj_splats: Gradients of centers, conics, opacities, colors and depths, added to.
    """
    device = bins.starts.device
    lanes = lanes_of(device)
    rows = wp.zeros(bins.pair_count, dtype=GradientRow, device=device)
    launch(
        adjoint_kernel(lanes, with_depth),
        bins.columns * bins.rows * (TILE // lanes.region) ** 2,
        [bins.columns, width, height, bins.starts, bins.gaussians, *splats, *outputs, changes, *adj_outputs],
        [rows],
        device=device,
        work=100,
        uneven=True,
    )
    launch(
        gather_gradients, bins.order.shape[0], [bins.order, bins.first, bins.slots, rows], adj_splats,
        device=device, work=2,
    )  # fmt: skip
