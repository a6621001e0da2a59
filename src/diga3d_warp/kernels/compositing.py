"""Compositing: colour, depth, normal and transmittance of each pixel, front to back.

    C = sum_i c_i alpha_i T_i,   D = sum_i z_i alpha_i T_i,   T_i = prod_{j<i} (1 - alpha_j)   (paper Eq. 1)

For each listed gaussian a thread visits the blocks of its region that the gaussian reaches, and blends their
pixels in one loop over lanes, which the compiler turns into vector instructions.

Invariants
- Lane loops are dynamic, without `break` or `continue`: lanes that are finished or skipped are masked with
  `wp.where`. Lane state is a vector copied out and back.
- A finished pixel keeps its transmittance with a minus sign: what follows would leave a negative one, and so
  does not survive.
- A tile records, one bit for each block, where a listed gaussian changed a live pixel. The adjoint visits
  only those blocks. On CUDA, where a thread owns one pixel, nothing is recorded.
- Colour, depth and normal are features alike: each is the sum of the same weights times its own number.
"""

from functools import cache

import warp as wp

from diga3d_warp.kernels import ordering
from diga3d_warp.kernels.binning import Bins
from diga3d_warp.kernels.blending import Blending, rules
from diga3d_warp.kernels.cells import aligned_function, cells_of
from diga3d_warp.kernels.launch import OPTIONS, launch
from diga3d_warp.kernels.pixel_lanes import (
    AHEAD,
    PixelLanes,
    fetch_function,
    lanes_for,
    lowest_bit,
    places_function,
    reached_function,
    region_function,
)
from diga3d_warp.kernels.precision import types_of
from diga3d_warp.kernels.splats import Images, Splats


@cache
def forward_kernel(blending: Blending, lanes: PixelLanes) -> wp.Kernel:
    """Blend the features that are asked for."""
    width, height, across = lanes.block_width, lanes.block_height, lanes.across
    blocks, size = lanes.blocks, lanes.size
    notes = lanes.owns_tile
    real, count = blending.real, blending.features
    vec2, vec3, *_ = types_of(real)
    vec = wp.types.vector(size, real)
    read, write, *_ = cells_of(vec)
    unit, response, clipped, survives, features = rules(blending)
    aligned, places = aligned_function(vec), places_function(lanes, real)
    region_of, reached = region_function(lanes.region), reached_function(blending, lanes)
    fetch = fetch_function(blending)

    @wp.kernel(module="unique", module_options=OPTIONS)
    def composite(
        offset: int,
        columns: int,
        image_width: int,
        image_height: int,
        starts: wp.array(dtype=int),
        gaussians: wp.array(dtype=int),
        centers: wp.array(dtype=vec2),
        extents: wp.array(dtype=vec2),
        factors: wp.array(dtype=vec3),
        opacities: wp.array(dtype=real),
        colors: wp.array(dtype=vec3),
        depths: wp.array(dtype=real),
        normals: wp.array(dtype=vec3),
        # outputs
        image: wp.array(dtype=vec3),
        depth_sum: wp.array(dtype=real),
        transmittance: wp.array(dtype=real),
        normal_sum: wp.array(dtype=vec3),
        median_depth: wp.array(dtype=real),
        changes: wp.array(dtype=int),
    ):
        tile, x0, y0 = region_of(wp.tid() + offset, columns)

        T = aligned(wp.zeros(shape=wp.static(blocks + 1), dtype=vec))
        sums = aligned(wp.zeros(shape=wp.static(count * blocks + 1), dtype=vec))
        median = wp.zeros(shape=wp.static(blocks if blending.median else 1), dtype=vec)
        xs = aligned(wp.zeros(shape=wp.static(blocks + 1), dtype=vec))
        ys = aligned(wp.zeros(shape=wp.static(blocks + 1), dtype=vec))
        live = int(0)
        for block in range(wp.static(blocks)):
            write(T, block, vec(real(1.0)))
            x_b, y_b = places(block)
            write(xs, block, x_b)
            write(ys, block, y_b)
            inside = (x0 + (block % across) * width < image_width) and (
                y0 + (block // across) * height < image_height
            )
            live = live | (wp.where(inside, 1, 0) << block)

        start = starts[tile]
        last = starts[tile + 1] - 1
        upcoming = int(0)
        if start <= last:
            upcoming = reached(gaussians[start], centers, extents, factors, x0, y0)
        for j in range(start, last + 1):
            if live == 0:
                break
            # Which blocks the next gaussian reaches is known before this one is blended: the loop below then
            # does not wait for it.
            remaining = live & upcoming
            upcoming = reached(gaussians[wp.min(j + 1, last)], centers, extents, factors, x0, y0)
            fetch(gaussians[wp.min(j + AHEAD, last)], centers, extents, factors, opacities, colors)
            i = gaussians[j]
            center = centers[i]
            extent = extents[i]
            factor = real(wp.static(unit)) * factors[i]
            opacity = opacities[i]
            value = features(i, colors, depths, normals)
            gx = center[0] - real(x0) - real(0.5)
            gy = center[1] - real(y0) - real(0.5)
            changed = int(0)
            while remaining != 0:
                block = lowest_bit(remaining)
                remaining = remaining & (remaining - 1)
                x_b = read(xs, block)
                y_b = read(ys, block)
                T_b = read(T, block)
                left = vec(real(0.0))
                weight = vec(real(0.0))
                any_live = int(0)
                any_change = int(0)
                for q in range(size):
                    dx = gx - x_b[q]
                    dy = gy - y_b[q]
                    w = clipped(response(opacity, factor, dx, dy, extent)) * T_b[q]
                    alive = survives(T_b[q] - w, 1)
                    left[q] = wp.where(alive > 0, T_b[q] - w, -wp.abs(T_b[q]))
                    weight[q] = wp.where(alive > 0, w, real(0.0))
                    any_live = any_live | alive
                    # Not 1: a union of known bits is compiled to shuffles, one of unknown ones to a test.
                    any_change = any_change | wp.where(w > real(0.0), columns, 0)
                write(T, block, left)
                for k in range(count):
                    plane = wp.static(k * blocks)  # naming k in a constant unrolls the loop
                    write(sums, plane + block, read(sums, plane + block) + weight * value[k])
                if wp.static(blending.median):
                    median_b = read(median, block)
                    z = depths[i]
                    for q in range(size):
                        here = wp.where(T_b[q] >= real(0.5), z, median_b[q])
                        median_b[q] = wp.where(T_b[q] - weight[q] < real(0.5), here, median_b[q])
                    write(median, block, median_b)
                changed = changed | (wp.where(any_change != 0, 1, 0) << block)
                if any_live == 0:
                    live = live & ~(1 << block)
            if wp.static(notes):
                changes[j] = changed

        for block in range(wp.static(blocks)):
            for q in range(size):
                x = x0 + (block % across) * width + q % width
                y = y0 + (block // across) * height + q // width
                if x < image_width and y < image_height:
                    pixel = y * image_width + x
                    image[pixel] = vec3(
                        sums[block][q],
                        sums[wp.static(blocks) + block][q],
                        sums[wp.static(2 * blocks) + block][q],
                    )
                    transmittance[pixel] = wp.abs(T[block][q])
                    if wp.static(blending.depth):
                        depth_sum[pixel] = sums[wp.static(3 * blocks) + block][q]
                    if wp.static(blending.normals):
                        first = wp.static(blending.normal_at * blocks) + block
                        normal_sum[pixel] = vec3(
                            sums[first][q],
                            sums[first + wp.static(blocks)][q],
                            sums[first + wp.static(2 * blocks)][q],
                        )
                    if wp.static(blending.median):
                        median_depth[pixel] = median[block][q]

    return composite


def composite(
    bins: Bins, width: int, height: int, splats: Splats, colors: wp.array, normals: wp.array, images: Images,
    blending: Blending,
) -> wp.array:  # fmt: skip
    """Blend a binned image.

    Args:
        bins: Pairs of this image.
        width, height: Image size [px].
        splats: N gaussians; slopes are read with `blending.pixel_order` alone.
        colors, normals: shape (N,), vec3. Normals may be empty where `blending` does not ask for them.
        images: Outputs. What is not asked for is left alone and may be empty.
        blending: What to compile.

    Returns:
        Blocks that each pair changed, one bit each, shape (P,), int32, for `composite_adjoint`; empty on CUDA
        and with `pixel_order`.
    """
    device = bins.starts.device
    if blending.pixel_order:
        ordering.composite(bins, width, height, splats, colors, normals, images, blending)
        return wp.zeros(0, dtype=int, device=device)
    lanes = lanes_for(device, blending)
    changes = wp.zeros(bins.pair_count if lanes.owns_tile else 0, dtype=int, device=device)
    launch(
        forward_kernel(blending, lanes), bins.regions(lanes.region),
        [
            bins.columns, width, height, bins.starts, bins.gaussians, splats.centers, splats.extents,
            splats.factors, splats.opacities, colors, splats.depths, normals,
        ],
        [*images, changes],
        device=device, work=100, uneven=True,
    )  # fmt: skip
    return changes
