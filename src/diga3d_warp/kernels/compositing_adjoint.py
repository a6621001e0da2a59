"""Adjoint of compositing: gradients of the splats from those of colour, transmittance, depth and normal.

Blocks, lanes and the order of gaussians are those of `compositing`. Blocks that a gaussian did not change are
skipped.

Invariants
- It walks front to back like the forward pass, and keeps R, the part of the pixel's weighted sum that is
  still behind: R = g.C + T_end g_T at first, then R -= w (c.g). No index of the last gaussian and no division
  by a small T is needed; 1 - alpha is at least 1 - alpha_max.
- On CPU a pair belongs to one region: its gradient row is written once, or stays zero.
- The median depth is the depth of one gaussian: its gradient goes to that depth alone.
"""

from functools import cache

import warp as wp

from diga3d_warp.config import SPLATTING, TILE
from diga3d_warp.kernels import ordering
from diga3d_warp.kernels.binning import Bins
from diga3d_warp.kernels.blending import Blending, rules
from diga3d_warp.kernels.cells import aligned_function, cells_of
from diga3d_warp.kernels.gradient_rows import GEOMETRY, gather, gradient_row
from diga3d_warp.kernels.lanes import total_function
from diga3d_warp.kernels.launch import OPTIONS, launch
from diga3d_warp.kernels.pixel_lanes import (
    AHEAD,
    PixelLanes,
    fetch_function,
    lanes_for,
    lowest_bit,
    places_function,
    reached_function,
)
from diga3d_warp.kernels.precision import types_of
from diga3d_warp.kernels.splats import BlendGradients, Images, Splats


@cache
def adjoint_kernel(blending: Blending, lanes: PixelLanes) -> wp.Kernel:
    """Gradient rows of all pairs, from the gradients of the images."""
    width, height, across = lanes.block_width, lanes.block_height, lanes.across
    blocks, size = lanes.blocks, lanes.size
    per_tile = TILE // lanes.region
    notes = lanes.owns_tile
    real, count = blending.real, blending.features
    alpha_max = SPLATTING.alpha_max
    vec2, vec3, *_ = types_of(real)
    vec = wp.types.vector(size, real)
    read, write, *_ = cells_of(vec)
    row_of = gradient_row(blending)
    claim_row = cells_of(row_of).claim
    unit, response, clipped, survives, features = rules(blending)
    aligned, places = aligned_function(vec), places_function(lanes, real)
    reached = reached_function(blending, lanes)
    fetch = fetch_function(blending)
    total = total_function(size, real)

    @wp.kernel(module="unique", module_options=OPTIONS)
    def composite_adjoint(
        offset: int,
        columns: int,
        image_width: int,
        image_height: int,
        starts: wp.array(dtype=int),
        gaussians: wp.array(dtype=int),
        emissions: wp.array(dtype=int),
        centers: wp.array(dtype=vec2),
        extents: wp.array(dtype=vec2),
        factors: wp.array(dtype=vec3),
        opacities: wp.array(dtype=real),
        colors: wp.array(dtype=vec3),
        depths: wp.array(dtype=real),
        normals: wp.array(dtype=vec3),
        image: wp.array(dtype=vec3),
        depth_sum: wp.array(dtype=real),
        transmittance: wp.array(dtype=real),
        normal_sum: wp.array(dtype=vec3),
        changes: wp.array(dtype=int),
        adj_image: wp.array(dtype=vec3),
        adj_depth_sum: wp.array(dtype=real),
        adj_transmittance: wp.array(dtype=real),
        adj_normal_sum: wp.array(dtype=vec3),
        adj_median_depth: wp.array(dtype=real),
        # outputs
        gradients: wp.array(dtype=row_of),
    ):
        # Not `region_function`: with values returned by a function this kernel takes 4 % longer.
        index = wp.tid() + offset
        tile = index // wp.static(per_tile * per_tile)
        part = index % wp.static(per_tile * per_tile)
        x0 = (tile % columns) * wp.static(TILE) + (part % wp.static(per_tile)) * wp.static(lanes.region)
        y0 = (tile // columns) * wp.static(TILE) + (part // wp.static(per_tile)) * wp.static(lanes.region)

        T = aligned(wp.zeros(shape=wp.static(blocks + 1), dtype=vec))
        R = aligned(wp.zeros(shape=wp.static(blocks + 1), dtype=vec))
        g = aligned(wp.zeros(shape=wp.static(count * blocks + 1), dtype=vec))
        g_median = wp.zeros(shape=wp.static(blocks if blending.median else 1), dtype=vec)
        xs = aligned(wp.zeros(shape=wp.static(blocks + 1), dtype=vec))
        ys = aligned(wp.zeros(shape=wp.static(blocks + 1), dtype=vec))
        inside = int(0)
        for block in range(wp.static(blocks)):
            write(T, block, vec(real(1.0)))
            x_b, y_b = places(block)
            write(xs, block, x_b)
            write(ys, block, y_b)
            R_b = vec(real(0.0))
            for q in range(size):
                x = x0 + (block % across) * width + q % width
                y = y0 + (block // across) * height + q // width
                if x < image_width and y < image_height:
                    pixel = y * image_width + x
                    adj = features(pixel, adj_image, adj_depth_sum, adj_normal_sum)
                    R_b[q] = (
                        wp.dot(features(pixel, image, depth_sum, normal_sum), adj)
                        + transmittance[pixel] * adj_transmittance[pixel]
                    )
                    if wp.static(blending.median):
                        g_median[block][q] = adj_median_depth[pixel]
                    for k in range(count):
                        g[k * blocks + block][q] = adj[k]
                    inside = 1
            write(R, block, R_b)

        last = starts[tile + 1] - 1
        for j in range(starts[tile], last + 1):
            i = gaussians[j]
            emission = emissions[j]
            remaining = inside
            if wp.static(notes):
                ahead = wp.min(j + AHEAD, last)
                fetch(gaussians[ahead], centers, extents, factors, opacities, colors)
                claim_row(gradients, emissions[ahead])
                remaining = changes[j]
            else:
                remaining = inside & reached(i, centers, extents, factors, x0, y0)
            if remaining == 0:
                if wp.static(notes):
                    gradients[emission] = row_of(real(0.0))
                continue
            center = centers[i]
            extent = extents[i]
            factor = factors[i]
            scaled = real(wp.static(unit)) * factor
            opacity = opacities[i]
            value = features(i, colors, depths, normals)
            gx = center[0] - real(x0) - real(0.5)
            gy = center[1] - real(y0) - real(0.5)
            sum_p = vec(real(0.0))
            sum_u = vec(real(0.0))
            sum_y = vec(real(0.0))
            sum_ux = vec(real(0.0))
            sum_uy = vec(real(0.0))
            sum_yy = vec(real(0.0))
            sum_median = vec(real(0.0))
            sums = aligned(wp.zeros(shape=wp.static(count + 1), dtype=vec))
            while remaining != 0:
                block = lowest_bit(remaining)
                remaining = remaining & (remaining - 1)
                x_b = read(xs, block)
                y_b = read(ys, block)
                T_b = read(T, block)
                R_b = read(R, block)
                left = vec(real(0.0))
                along = vec(real(0.0))
                for k in range(count):
                    along = along + read(g, wp.static(k * blocks) + block) * value[k]
                weight = vec(real(0.0))
                any_live = int(0)
                for q in range(size):
                    dx = gx - x_b[q]
                    dy = gy - y_b[q]
                    raw = response(opacity, scaled, dx, dy, extent)
                    alpha = clipped(raw)
                    w = alpha * T_b[q]
                    alive = survives(T_b[q] - w, 1)
                    left[q] = wp.where(alive > 0, T_b[q] - w, -wp.abs(T_b[q]))
                    w = wp.where(alive > 0, w, real(0.0))
                    weight[q] = w
                    behind = R_b[q] - w * along[q]
                    R_b[q] = behind
                    g_alpha = T_b[q] * along[q] - behind / (real(1.0) - alpha)
                    g_power = wp.where(raw < real(wp.static(alpha_max)), raw * g_alpha, real(0.0))
                    g_power = wp.where(w > real(0.0), g_power, real(0.0))
                    sum_p[q] = sum_p[q] + g_power
                    g_u = g_power * (scaled[0] * dx + scaled[1] * dy)
                    sum_u[q] = sum_u[q] + g_u
                    sum_y[q] = sum_y[q] + g_power * dy
                    sum_ux[q] = sum_ux[q] + g_u * dx
                    sum_uy[q] = sum_uy[q] + g_u * dy
                    sum_yy[q] = sum_yy[q] + g_power * dy * dy
                    any_live = any_live | alive
                for k in range(count):
                    write(sums, k, read(sums, k) + wp.cw_mul(weight, read(g, wp.static(k * blocks) + block)))
                if wp.static(blending.median):
                    g_b = g_median[block]
                    for q in range(size):
                        here = wp.where(T_b[q] >= real(0.5), g_b[q], real(0.0))
                        here = wp.where(T_b[q] - weight[q] < real(0.5), here, real(0.0))
                        sum_median[q] = sum_median[q] + here
                write(T, block, left)
                write(R, block, R_b)
                if wp.static(not notes):
                    inside = any_live

            row = row_of(real(0.0))
            # power = -(u^2 + v^2) / 2 with u = l11 dx + l21 dy, v = l22 dy, (dx, dy) = center - pixel; the
            # lanes' u are in `unit`.
            g_u = real(wp.static(-1.0 / unit)) * total(sum_u)
            g_v = -factor[2] * total(sum_y)
            row[0] = factor[0] * g_u
            row[1] = factor[1] * g_u + factor[2] * g_v
            row[2] = real(wp.static(-1.0 / unit)) * total(sum_ux)
            row[3] = real(wp.static(-1.0 / unit)) * total(sum_uy)
            row[4] = -factor[2] * total(sum_yy)
            row[5] = total(sum_p) / opacity
            for k in range(count):
                row[GEOMETRY + k] = total(read(sums, k))
            if wp.static(blending.median):
                row[wp.static(GEOMETRY + count)] = total(sum_median)
            if wp.static(notes):
                gradients[emission] = row
            else:
                wp.atomic_add(gradients, emission, row)

    return composite_adjoint


def composite_adjoint(
    bins: Bins, width: int, height: int, splats: Splats, colors: wp.array, normals: wp.array, images: Images,
    changes: wp.array, adj_images: Images, gradients: BlendGradients, blending: Blending,
) -> None:  # fmt: skip
    """Add the gradients of what was blended, given those of the images.

    Args:
        bins, width, height, splats, colors, normals, images, blending: As in `composite`, after it ran. The
            median depth itself is not read.
        changes: What it returned.
        adj_images: Gradients of the images.
        gradients: Outputs, added to.
    """
    if blending.pixel_order:
        ordering.composite_adjoint(
            bins, width, height, splats, colors, normals, images, adj_images, gradients, blending
        )
        return
    device = bins.starts.device
    lanes = lanes_for(device, blending)
    rows = (wp.empty if lanes.owns_tile else wp.zeros)(
        bins.pair_count, dtype=gradient_row(blending), device=device
    )
    launch(
        adjoint_kernel(blending, lanes), bins.regions(lanes.region),
        [
            bins.columns, width, height, bins.starts, bins.gaussians, bins.emissions, splats.centers,
            splats.extents, splats.factors, splats.opacities, colors, splats.depths, normals, images.color,
            images.depth_sum, images.transmittance, images.normal_sum, changes, *adj_images,
        ],
        [rows],
        device=device, work=100, uneven=True,
    )  # fmt: skip
    gather(bins, rows, gradients, blending)
