"""Compositing: colour, depth and transmittance of each pixel, front to back.

    C = sum_i c_i alpha_i T_i,   D = sum_i z_i alpha_i T_i,   T_i = prod_{j<i} (1 - alpha_j)   (paper Eq. 1)

A thread owns a region of pixels, cut into small blocks; for each listed gaussian it visits the blocks that
the gaussian's box touches, and blends their pixels in one loop over lanes, which the compiler turns into
vector instructions. On CPU a region is a tile of 4 x 4 px blocks; on CUDA it is one pixel.

Invariants
- Lane loops are dynamic, without `break` or `continue`: lanes that are finished or skipped are masked with
  `wp.where`, and their liveness is kept as integers. Lane state is a vector copied out and back.
- No `wp.exp` in a lane: it is a scalar library call. `falloff` stands for it.
- Forward and adjoint make the same comparisons in the same order, so they skip, clamp and stop at the same
  gaussians.
- A tile notes, one bit a block, where each listed gaussian changed a live pixel. The adjoint visits those
  blocks alone: about half of what the boxes touch. On CUDA, where a thread owns one pixel, nothing is noted.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import warp as wp
from numpy.polynomial import Chebyshev, Polynomial

from diga3d_warp.config import SPLATTING, TILE
from diga3d_warp.kernels.binning import Bins
from diga3d_warp.kernels.launch import OPTIONS, launch

wp.set_module_options(OPTIONS)

_S = SPLATTING

EXP = tuple(float(c) for c in Chebyshev.interpolate(np.exp, 6, domain=[-1, 0]).convert(kind=Polynomial).coef)
"""exp on [-1, 0] as a polynomial of degree 6, error 2.4e-8: a float32 holds no more."""


@dataclass(frozen=True)
class Lanes:
    """How pixels are dealt to threads: side of a thread's region and of a lane block [px]."""

    region: int
    block_width: int
    block_height: int


CPU_LANES = Lanes(region=TILE, block_width=4, block_height=4)
"""16 lanes fill one AVX-512 register; a 4 x 4 block follows the shape of a splat better than a 16 x 1 row."""

CUDA_LANES = Lanes(region=1, block_width=1, block_height=1)


def lanes_of(device: wp.Device) -> Lanes:
    return CPU_LANES if device.is_cpu else CUDA_LANES


@wp.func
def falloff(power: float) -> float:
    """exp(power) for power in [-8, 0], as p(power / 8)^8.

    Below -8 alpha is under alpha_min whatever the opacity; above 0 lies only rounding.
    """
    x = wp.where(power > -8.0, power, -8.0)
    x = wp.where(x < 0.0, x, 0.0) * 0.125
    p = (
        (((((wp.static(EXP[6]) * x + wp.static(EXP[5])) * x + wp.static(EXP[4])) * x + wp.static(EXP[3])) * x
        + wp.static(EXP[2])) * x + wp.static(EXP[1])) * x + wp.static(EXP[0])
    )  # fmt: skip
    p = p * p
    p = p * p
    return p * p


@wp.func
def block_range(center: wp.vec2, extent: wp.vec2, x: int, y: int, width: int, height: int) -> wp.vec4i:
    """Blocks of the region at pixel (x, y) that a gaussian's box touches: first and end column and row."""
    left = wp.ceil(wp.clamp(center[0] - extent[0] - 0.5, -1.0e6, 1.0e6)) - float(x)
    right = wp.floor(wp.clamp(center[0] + extent[0] - 0.5, -1.0e6, 1.0e6)) - float(x)
    top = wp.ceil(wp.clamp(center[1] - extent[1] - 0.5, -1.0e6, 1.0e6)) - float(y)
    bottom = wp.floor(wp.clamp(center[1] + extent[1] - 0.5, -1.0e6, 1.0e6)) - float(y)
    side = wp.static(float(TILE))
    return wp.vec4i(
        int(wp.clamp(left, 0.0, side)) // width,
        int(wp.clamp(right, -1.0, side - 1.0) + float(width)) // width,
        int(wp.clamp(top, 0.0, side)) // height,
        int(wp.clamp(bottom, -1.0, side - 1.0) + float(height)) // height,
    )


def notes_changes(lanes: Lanes) -> bool:
    """Whether a thread sees all that a pair changes, and so can note it."""
    return lanes.region == TILE


@cache
def forward_kernel(lanes: Lanes, with_depth: bool) -> wp.Kernel:
    """Blend colours, and depths where asked for."""
    width, height = lanes.block_width, lanes.block_height
    across, down = lanes.region // width, lanes.region // height
    blocks, size = across * down, width * height
    per_tile = TILE // lanes.region
    notes = notes_changes(lanes)
    vec = wp.types.vector(length=size, dtype=float)
    ints = wp.types.vector(length=size, dtype=int)

    @wp.kernel(module="unique", module_options=OPTIONS)
    def composite(
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
        # outputs
        image: wp.array(dtype=wp.vec3),
        depth_sum: wp.array(dtype=float),
        transmittance: wp.array(dtype=float),
        changes: wp.array(dtype=int),
    ):
        index = wp.tid() + offset
        tile = index // wp.static(per_tile * per_tile)
        part = index % wp.static(per_tile * per_tile)
        x0 = (tile % columns) * wp.static(TILE) + (part % wp.static(per_tile)) * wp.static(lanes.region)
        y0 = (tile // columns) * wp.static(TILE) + (part // wp.static(per_tile)) * wp.static(lanes.region)

        T = wp.zeros(shape=wp.static(blocks), dtype=vec)
        red = wp.zeros(shape=wp.static(blocks), dtype=vec)
        green = wp.zeros(shape=wp.static(blocks), dtype=vec)
        blue = wp.zeros(shape=wp.static(blocks), dtype=vec)
        far = wp.zeros(shape=wp.static(blocks), dtype=vec)
        live = wp.zeros(shape=wp.static(blocks), dtype=ints)
        block_live = wp.zeros(shape=wp.static(blocks), dtype=int)
        left = int(0)
        for block in range(wp.static(blocks)):
            T[block] = vec(1.0)
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
            box = block_range(center, extents[i], x0, y0, width, height)
            changed = int(0)
            for by in range(wp.max(box[2], 0), wp.min(box[3], down)):
                for bx in range(wp.max(box[0], 0), wp.min(box[1], across)):
                    block = by * across + bx
                    if block_live[block] != 0:
                        bgx = gx - float(bx * width)
                        bgy = gy - float(by * height)
                        T_b = T[block]
                        live_b = live[block]
                        red_b = red[block]
                        green_b = green[block]
                        blue_b = blue[block]
                        far_b = far[block]
                        any_live = int(0)
                        any_change = int(0)
                        for q in range(size):
                            dx = bgx - float(q % width)
                            dy = bgy - float(q // width)
                            raw = opacity * falloff((a * dx + b * dy) * dx + c * dy * dy)
                            alpha = wp.where(raw < wp.static(_S.alpha_max), raw, wp.static(_S.alpha_max))
                            alpha = wp.where(alpha < wp.static(_S.alpha_min), 0.0, alpha)
                            w = alpha * T_b[q]
                            any_change = any_change | wp.where(alpha > 0.0, live_b[q], 0)
                            alive = wp.where(T_b[q] - w < wp.static(_S.transmittance_min), 0, live_b[q])
                            live_b[q] = alive
                            w = wp.where(alive > 0, w, 0.0)
                            red_b[q] = red_b[q] + w * color[0]
                            green_b[q] = green_b[q] + w * color[1]
                            blue_b[q] = blue_b[q] + w * color[2]
                            if wp.static(with_depth):
                                far_b[q] = far_b[q] + w * z
                            T_b[q] = T_b[q] - w
                            any_live = any_live | alive
                        T[block] = T_b
                        live[block] = live_b
                        red[block] = red_b
                        green[block] = green_b
                        blue[block] = blue_b
                        if wp.static(with_depth):
                            far[block] = far_b
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
                    image[pixel] = wp.vec3(red[block][q], green[block][q], blue[block][q])
                    transmittance[pixel] = T[block][q]
                    if wp.static(with_depth):
                        depth_sum[pixel] = far[block][q]

    return composite


def composite(
    bins: Bins, width: int, height: int, splats: list, outputs: list, *, with_depth: bool
) -> wp.array:
    """Blend a binned image.

    Args:
        bins: Pairs of this image.
        width, height: Image size [px].
        splats: centers (N,) vec2, extents (N,) vec2, conics (N,) vec3, opacities (N,), colors (N,) vec3,
            depths (N,).
        outputs: image (H*W,) vec3, depth_sum (H*W,) (left alone without `with_depth`), transmittance (H*W,).

    Returns:
        What `composite_adjoint` wants to know: blocks that each pair changed, one bit each, shape (P,),
        int32; empty on CUDA.
    """
    device = bins.starts.device
    lanes = lanes_of(device)
    changes = wp.zeros(bins.pair_count if notes_changes(lanes) else 0, dtype=int, device=device)
    launch(
        forward_kernel(lanes, with_depth),
        bins.columns * bins.rows * (TILE // lanes.region) ** 2,
        [bins.columns, width, height, bins.starts, bins.gaussians, *splats],
        [*outputs, changes],
        device=device,
        work=100,
        uneven=True,
    )
    return changes
