"""Compositing: colour, depth, normal and transmittance of each pixel, front to back.

    C = sum_i c_i alpha_i T_i,   D = sum_i z_i alpha_i T_i,   T_i = prod_{j<i} (1 - alpha_j)   (paper Eq. 1)

A thread owns a region of pixels, cut into small blocks; for each listed gaussian it visits the blocks that
the gaussian's box touches, and blends their pixels in one loop over lanes, which the compiler turns into
vector instructions. On CPU a region is a tile of 4 x 4 px blocks; on CUDA it is one pixel.

Invariants
- Lane loops are dynamic, without `break` or `continue`: lanes that are finished or skipped are masked with
  `wp.where`, and their liveness is kept as integers. Lane state is a vector copied out and back.
- A tile notes, one bit a block, where each listed gaussian changed a live pixel. The adjoint visits those
  blocks alone: about half of what the boxes touch. On CUDA, where a thread owns one pixel, nothing is noted.
- Colour, depth and normal are features alike: each is the sum of the same weights times its own number.
"""

from functools import cache

import warp as wp

from diga3d_warp.config import TILE
from diga3d_warp.kernels import ordering
from diga3d_warp.kernels.binning import Bins
from diga3d_warp.kernels.blending import Blending, Lanes, lanes_of, notes_changes, rules
from diga3d_warp.kernels.launch import OPTIONS, launch
from diga3d_warp.kernels.precision import types_of


@cache
def forward_kernel(blending: Blending, lanes: Lanes) -> wp.Kernel:
    """Blend the features that are asked for."""
    width, height = lanes.block_width, lanes.block_height
    across, down = lanes.region // width, lanes.region // height
    blocks, size = across * down, width * height
    per_tile = TILE // lanes.region
    notes = notes_changes(lanes)
    real, count = blending.real, blending.features
    vec2, vec3, *_ = types_of(real)
    vec = wp.types.vector(size, real)
    ints = wp.types.vector(size, int)
    unit, response, clipped, survives, features, block_range = rules(blending)

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
        roots: wp.array(dtype=vec3),
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
        index = wp.tid() + offset
        tile = index // wp.static(per_tile * per_tile)
        part = index % wp.static(per_tile * per_tile)
        x0 = (tile % columns) * wp.static(TILE) + (part % wp.static(per_tile)) * wp.static(lanes.region)
        y0 = (tile // columns) * wp.static(TILE) + (part // wp.static(per_tile)) * wp.static(lanes.region)

        T = wp.zeros(shape=wp.static(blocks), dtype=vec)
        sums = wp.zeros(shape=wp.static(count * blocks), dtype=vec)
        median = wp.zeros(shape=wp.static(blocks if blending.median else 1), dtype=vec)
        live = wp.zeros(shape=wp.static(blocks), dtype=ints)
        block_live = wp.zeros(shape=wp.static(blocks), dtype=int)
        left = int(0)
        for block in range(wp.static(blocks)):
            T[block] = vec(real(1.0))
            live[block] = ints(1)
            inside = (x0 + (block % across) * width < image_width) and (
                y0 + (block // across) * height < image_height
            )
            block_live[block] = wp.where(inside, 1, 0)
            left += block_live[block]

        for j in range(starts[tile], starts[tile + 1]):
            if left == 0:
                break
            i = gaussians[j]
            center = centers[i]
            extent = extents[i]
            root = real(wp.static(unit)) * roots[i]
            opacity = opacities[i]
            value = features(i, colors, depths, normals)
            gx = center[0] - real(x0) - real(0.5)
            gy = center[1] - real(y0) - real(0.5)
            box = block_range(center, extent, x0, y0, width, height)
            changed = int(0)
            for by in range(wp.max(box[2], 0), wp.min(box[3], down)):
                for bx in range(wp.max(box[0], 0), wp.min(box[1], across)):
                    block = by * across + bx
                    if block_live[block] != 0:
                        bgx = gx - real(bx * width)
                        bgy = gy - real(by * height)
                        T_b = T[block]
                        live_b = live[block]
                        weight = vec(real(0.0))
                        any_live = int(0)
                        any_change = int(0)
                        for q in range(size):
                            dx = bgx - real(q % width)
                            dy = bgy - real(q // width)
                            alpha = clipped(response(opacity, root, dx, dy, extent))
                            w = alpha * T_b[q]
                            any_change = any_change | wp.where(alpha > real(0.0), live_b[q], 0)
                            alive = survives(T_b[q] - w, live_b[q])
                            live_b[q] = alive
                            weight[q] = wp.where(alive > 0, w, real(0.0))
                            any_live = any_live | alive
                        live[block] = live_b
                        T[block] = T_b - weight
                        for k in range(count):
                            plane = wp.static(k * blocks)  # naming k in a constant unrolls the loop
                            sums[plane + block] = sums[plane + block] + weight * value[k]
                        if wp.static(blending.median):
                            median_b = median[block]
                            z = depths[i]
                            for q in range(size):
                                here = wp.where(T_b[q] >= real(0.5), z, median_b[q])
                                median_b[q] = wp.where(T_b[q] - weight[q] < real(0.5), here, median_b[q])
                            median[block] = median_b
                        changed = changed | (any_change << block)
                        if any_live == 0:
                            block_live[block] = 0
                            left -= 1
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
                    transmittance[pixel] = T[block][q]
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
    bins: Bins, width: int, height: int, splats: list, outputs: list, blending: Blending
) -> wp.array:
    """Blend a binned image.

    Args:
        bins: Pairs of this image.
        width, height: Image size [px].
        splats: centers (N,) vec2, extents (N,) vec2, roots (N,) vec3, opacities (N,), colors (N,) vec3,
            depths (N,), normals (N,) vec3, depth_slopes (N,) vec2. What nothing asks for may be empty:
            depths, normals, and slopes, which `blending.pixel_order` alone reads.
        outputs: image (H*W,) vec3, depth_sum (H*W,), transmittance (H*W,), normal_sum (H*W,) vec3,
            median_depth (H*W,). What is not asked for is left alone and may be empty.
        blending: What to compile.

    Returns:
        What `composite_adjoint` wants to know: blocks that each pair changed, one bit each, shape (P,),
        int32; empty on CUDA and with `pixel_order`.
    """
    device = bins.starts.device
    if blending.pixel_order:
        ordering.composite(bins, width, height, splats, outputs, blending)
        return wp.zeros(0, dtype=int, device=device)
    lanes = lanes_of(device, blending)
    changes = wp.zeros(bins.pair_count if notes_changes(lanes) else 0, dtype=int, device=device)
    launch(
        forward_kernel(blending, lanes),
        bins.columns * bins.rows * (TILE // lanes.region) ** 2,
        [bins.columns, width, height, bins.starts, bins.gaussians, *splats[:7]],
        [*outputs, changes],
        device=device,
        work=100,
        uneven=True,
    )
    return changes
