"""Compositing in each pixel's own order of depth, forward and adjoint.

A gaussian's depth on the ray of a pixel p is

    z(p) = z + s . (p - u),   s = Sigma'^-1 cov(pixel, depth),

u its centre, z the depth there, s the slope from `projection`: the affine camera makes pixel and depth
jointly gaussian, and on the ray the gaussian is densest at the mean of depth given the pixel. One order by z
for the whole image lets large gaussians pop to the front as a camera turns, and draws one that leans through
another on one side of it. (StopThePop, Radl et al. 2024, sorts likewise, but within a window of fixed size.)

A thread takes the nearest `WINDOW` gaussians that touch its pixel, blends them, then the next, until the
pixel is finished or no gaussian is left. Each round reads the tile's whole list.

Invariants
- The order is exact, however far it is from the list's: a round takes what comes after the last gaussian of
  the round before. Equal depths keep the order of the list.
- Forward and adjoint take gaussians by the same function, and skip, clamp and stop by the same rules.
- The order has no gradient, nor have slopes; blended depths are those of centres, as without.
"""

from functools import cache
from typing import Any

import warp as wp

from diga3d_warp.config import SPLATTING, TILE
from diga3d_warp.kernels.binning import Bins
from diga3d_warp.kernels.blending import Blending, rules
from diga3d_warp.kernels.gradient_rows import GEOMETRY, gather, gradient_row
from diga3d_warp.kernels.launch import OPTIONS, launch
from diga3d_warp.kernels.pixel_lanes import region_function
from diga3d_warp.kernels.precision import types_of
from diga3d_warp.kernels.splats import BlendGradients, Images, Splats

WINDOW = 16
"""Gaussians of one round. Opaque scenes finish most pixels in one or two; a larger one costs moves."""


@cache
def nearest_function(blending: Blending) -> Any:
    """Warp function: the next gaussians of a pixel, by depth on its ray.

    Takes the tile's range of pairs, their gaussians, the splats, the pixel's centre, and depth and pair of
    the last gaussian before. Returns pairs (-1 where there are no more), their depths and their responses.
    """
    real = blending.real
    vec2, vec3, *_ = types_of(real)
    window = wp.types.vector(length=WINDOW, dtype=real)
    pairs = wp.types.vector(length=WINDOW, dtype=int)
    unit, response, clipped, *_ = rules(blending)

    @wp.func
    def nearest(
        start: int,
        end: int,
        gaussians: wp.array(dtype=int),
        centers: wp.array(dtype=vec2),
        extents: wp.array(dtype=vec2),
        factors: wp.array(dtype=vec3),
        opacities: wp.array(dtype=real),
        depths: wp.array(dtype=real),
        slopes: wp.array(dtype=vec2),
        pixel: vec2,
        last_depth: real,
        last_pair: int,
    ):
        js = pairs(-1)
        zs = window(real(0.0))
        raws = window(real(0.0))
        held = int(0)
        for j in range(start, end):
            i = gaussians[j]
            offset = centers[i] - pixel
            extent = extents[i]
            if wp.abs(offset[0]) <= extent[0] and wp.abs(offset[1]) <= extent[1]:
                z = depths[i] - wp.dot(slopes[i], offset)
                follows = z > last_depth or (z == last_depth and j > last_pair)
                if follows and (held < WINDOW or z < zs[WINDOW - 1]):
                    factor = real(wp.static(unit)) * factors[i]
                    raw = response(opacities[i], factor, offset[0], offset[1], extent)
                    if clipped(raw) > real(0.0):
                        held = wp.min(held + 1, WINDOW)
                        at = held - 1
                        while at > 0 and z < zs[wp.max(at - 1, 0)]:
                            js[at] = js[at - 1]
                            zs[at] = zs[at - 1]
                            raws[at] = raws[at - 1]
                            at -= 1
                        js[at] = j
                        zs[at] = z
                        raws[at] = raw
        return js, zs, raws

    return nearest


@cache
def ordered_kernel(blending: Blending) -> wp.Kernel:
    """Blend the features that are asked for; one index for each pixel."""
    real = blending.real
    vec2, vec3, *_ = types_of(real)
    values = wp.types.vector(length=blending.features, dtype=real)
    _, _, clipped, survives, features = rules(blending)
    nearest = nearest_function(blending)

    @wp.kernel(module="unique", module_options=OPTIONS)
    def composite_ordered(
        offset: int,
        columns: int,
        width: int,
        starts: wp.array(dtype=int),
        gaussians: wp.array(dtype=int),
        centers: wp.array(dtype=vec2),
        extents: wp.array(dtype=vec2),
        factors: wp.array(dtype=vec3),
        opacities: wp.array(dtype=real),
        colors: wp.array(dtype=vec3),
        depths: wp.array(dtype=real),
        normals: wp.array(dtype=vec3),
        slopes: wp.array(dtype=vec2),
        # outputs
        image: wp.array(dtype=vec3),
        depth_sum: wp.array(dtype=real),
        transmittance: wp.array(dtype=real),
        normal_sum: wp.array(dtype=vec3),
        median_depth: wp.array(dtype=real),
    ):
        index = wp.tid() + offset
        x = index % width
        y = index // width
        tile = (y // TILE) * columns + x // TILE
        pixel = vec2(real(x) + real(0.5), real(y) + real(0.5))
        through = real(1.0)
        sums = values(real(0.0))
        median = real(0.0)
        last_depth = -real(wp.inf)
        last_pair = int(-1)
        live = int(1)
        while live != 0:
            js, zs, raws = nearest(
                starts[tile], starts[tile + 1], gaussians, centers, extents, factors, opacities, depths,
                slopes, pixel, last_depth, last_pair,
            )  # fmt: skip
            last_depth = zs[WINDOW - 1]
            last_pair = js[WINDOW - 1]
            for s in range(WINDOW):
                if live != 0:
                    if js[s] < 0:
                        live = 0
                    else:
                        w = clipped(raws[s]) * through
                        live = survives(through - w, live)
                        if live != 0:
                            i = gaussians[js[s]]
                            sums += w * features(i, colors, depths, normals)
                            if wp.static(blending.median):
                                if through >= real(0.5) and through - w < real(0.5):
                                    median = depths[i]
                            through -= w
        transmittance[index] = through
        image[index] = vec3(sums[0], sums[1], sums[2])
        if wp.static(blending.depth):
            depth_sum[index] = sums[3]
        if wp.static(blending.normals):
            normal_sum[index] = vec3(
                sums[wp.static(blending.normal_at)],
                sums[wp.static(blending.normal_at + 1)],
                sums[wp.static(blending.normal_at + 2)],
            )
        if wp.static(blending.median):
            median_depth[index] = median

    return composite_ordered


@cache
def ordered_adjoint_kernel(blending: Blending, region: int) -> wp.Kernel:
    """Gradient rows of all pairs; an index for each square of `region` px, a tile on CPU, a pixel on CUDA."""
    real = blending.real
    vec2, vec3, *_ = types_of(real)
    row_of = gradient_row(blending)
    _, _, clipped, survives, features = rules(blending)
    nearest = nearest_function(blending)
    region_of, count = region_function(region), blending.features
    alpha_max = SPLATTING.alpha_max

    @wp.kernel(module="unique", module_options=OPTIONS)
    def composite_ordered_adjoint(
        offset: int,
        columns: int,
        width: int,
        height: int,
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
        slopes: wp.array(dtype=vec2),
        image: wp.array(dtype=vec3),
        depth_sum: wp.array(dtype=real),
        transmittance: wp.array(dtype=real),
        normal_sum: wp.array(dtype=vec3),
        adj_image: wp.array(dtype=vec3),
        adj_depth_sum: wp.array(dtype=real),
        adj_transmittance: wp.array(dtype=real),
        adj_normal_sum: wp.array(dtype=vec3),
        adj_median_depth: wp.array(dtype=real),
        # outputs
        gradients: wp.array(dtype=row_of),
    ):
        tile, x0, y0 = region_of(wp.tid() + offset, columns)
        for q in range(wp.static(region * region)):
            x = x0 + q % region
            y = y0 + q // region
            if x < width and y < height:
                index = y * width + x
                adj = features(index, adj_image, adj_depth_sum, adj_normal_sum)
                R = (
                    wp.dot(features(index, image, depth_sum, normal_sum), adj)
                    + transmittance[index] * adj_transmittance[index]
                )
                through = real(1.0)
                last_depth = -real(wp.inf)
                last_pair = int(-1)
                live = int(1)
                pixel = vec2(real(x) + real(0.5), real(y) + real(0.5))
                while live != 0:
                    js, zs, raws = nearest(
                        starts[tile], starts[tile + 1], gaussians, centers, extents, factors, opacities,
                        depths, slopes, pixel, last_depth, last_pair,
                    )  # fmt: skip
                    last_depth = zs[WINDOW - 1]
                    last_pair = js[WINDOW - 1]
                    for s in range(WINDOW):
                        if live != 0:
                            if js[s] < 0:
                                live = 0
                            else:
                                raw = raws[s]
                                alpha = clipped(raw)
                                w = alpha * through
                                live = survives(through - w, live)
                                if live != 0:
                                    i = gaussians[js[s]]
                                    along = wp.dot(features(i, colors, depths, normals), adj)
                                    R -= w * along
                                    g_power = raw * (through * along - R / (real(1.0) - alpha))
                                    if raw >= real(wp.static(alpha_max)):
                                        g_power = real(0.0)
                                    d = centers[i] - pixel
                                    factor = factors[i]
                                    g_u = -g_power * (factor[0] * d[0] + factor[1] * d[1])
                                    g_v = -g_power * (factor[2] * d[1])
                                    row = row_of(real(0.0))
                                    row[0] = factor[0] * g_u
                                    row[1] = factor[1] * g_u + factor[2] * g_v
                                    row[2] = g_u * d[0]
                                    row[3] = g_u * d[1]
                                    row[4] = g_v * d[1]
                                    row[5] = g_power / opacities[i]
                                    for k in range(count):
                                        row[GEOMETRY + k] = w * adj[k]
                                    if wp.static(blending.median):
                                        if through >= real(0.5) and through - w < real(0.5):
                                            row[GEOMETRY + count] = adj_median_depth[index]
                                    wp.atomic_add(gradients, emissions[js[s]], row)
                                    through -= w

    return composite_ordered_adjoint


def composite(
    bins: Bins, width: int, height: int, splats: Splats, colors: wp.array, normals: wp.array, images: Images,
    blending: Blending,
) -> None:  # fmt: skip
    """Blend a binned image, each pixel in its own order. Arguments as in `compositing.composite`."""
    launch(
        ordered_kernel(blending), width * height,
        [
            bins.columns, width, bins.starts, bins.gaussians, splats.centers, splats.extents, splats.factors,
            splats.opacities, colors, splats.depths, normals, splats.slopes,
        ],
        images,
        device=bins.starts.device, work=50, uneven=True,
    )  # fmt: skip


def composite_adjoint(
    bins: Bins, width: int, height: int, splats: Splats, colors: wp.array, normals: wp.array, images: Images,
    adj_images: Images, gradients: BlendGradients, blending: Blending,
) -> None:  # fmt: skip
    """Add the gradients. Arguments as in `compositing_adjoint.composite_adjoint`."""
    device = bins.starts.device
    region = TILE if device.is_cpu else 1
    rows = wp.zeros(bins.pair_count, dtype=gradient_row(blending), device=device)
    launch(
        ordered_adjoint_kernel(blending, region), bins.regions(region),
        [
            bins.columns, width, height, bins.starts, bins.gaussians, bins.emissions, splats.centers,
            splats.extents, splats.factors, splats.opacities, colors, splats.depths, normals, splats.slopes,
            images.color, images.depth_sum, images.transmittance, images.normal_sum, *adj_images,
        ],
        [rows], device=device, work=100, uneven=True,
    )  # fmt: skip
    gather(bins, rows, gradients, blending)
