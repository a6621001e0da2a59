"""Pixels in SIMD lanes: how they are shared among threads, and which of them a gaussian reaches.

A thread owns a region of pixels, cut into blocks whose pixels are blended in SIMD lanes: on CPU a tile of
4 x 4 px blocks, on CUDA one pixel.

Invariants
- Blocks are numbered row by row; a set of blocks is the bits of an integer.
- A block that holds a pixel where alpha reaches `alpha_min` is reached, whatever rounding does.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import warp as wp

from diga3d_warp.config import TILE
from diga3d_warp.kernels.blending import Blending
from diga3d_warp.kernels.cells import cells_of
from diga3d_warp.kernels.precision import types_of

AHEAD = 4
"""Pairs by which a thread prefetches: one to two hundred nanoseconds, the latency of memory. 2 and 8 are as
fast within noise; without prefetching, a million gaussians take twice the time."""

MARGIN = 2.0**-6
"""Distance that a block's edge is moved outwards [px]. Offsets up to 1e5 px round by less."""

ROUNDING = 2.0**-20
"""Share of an offset by which the edge is moved too: rounding of offsets beyond that."""


@dataclass(frozen=True)
class PixelLanes:
    """How pixels are shared among threads: side of a thread's region and of a lane block [px]."""

    region: int
    block_width: int
    block_height: int

    @property
    def across(self) -> int:
        """Blocks in a row of the region."""
        return self.region // self.block_width

    @property
    def blocks(self) -> int:
        """Blocks of the region."""
        return self.across * (self.region // self.block_height)

    @property
    def size(self) -> int:
        """Pixels of a block."""
        return self.block_width * self.block_height

    @property
    def owns_tile(self) -> bool:
        """Whether one thread sees all that a pair of tile and gaussian does."""
        return self.region == TILE


CPU_LANES = PixelLanes(region=TILE, block_width=4, block_height=4)
"""16 lanes fill one AVX-512 register; a 4 x 4 block follows the shape of a splat better than a 16 x 1 row."""

CUDA_LANES = PixelLanes(region=1, block_width=1, block_height=1)


def lanes_for(device: wp.Device, blending: Blending) -> PixelLanes:
    return CPU_LANES if device.is_cpu or blending.deterministic else CUDA_LANES


@cache
def region_function(region: int) -> Any:
    """Warp function: (index of a thread, columns of tiles) -> tile, and x and y of the region's first pixel.

    Threads are numbered tile after tile, in a tile row by row.
    """
    per_tile = TILE // region

    @wp.func
    def region_of(index: int, columns: int):
        tile = index // wp.static(per_tile * per_tile)
        part = index % wp.static(per_tile * per_tile)
        x = (tile % columns) * wp.static(TILE) + (part % wp.static(per_tile)) * wp.static(region)
        y = (tile // columns) * wp.static(TILE) + (part // wp.static(per_tile)) * wp.static(region)
        return tile, x, y

    return region_of


@cache
def places_function(lanes: PixelLanes, real: Any) -> Any:
    """Warp function: x and y of a block's pixels in their region [px], a vector each.

    Reading them from arrays takes two instructions for each block; computing them takes ten.
    """
    width, height, across, size = lanes.block_width, lanes.block_height, lanes.across, lanes.size
    vec = wp.types.vector(size, real)

    @wp.func
    def places(block: int):
        x = vec(real(0.0))
        y = vec(real(0.0))
        for q in range(size):
            x[q] = real((block % across) * width + q % width)
            y[q] = real((block // across) * height + q // width)
        return x, y

    return places


LOWEST_BIT = """
#ifdef __CUDA_ARCH__
return __ffs(bits) - 1;
#else
return __builtin_ctz(bits);
#endif
"""


@wp.func_native(LOWEST_BIT)
def lowest_bit(bits: int) -> int: ...


@cache
def reached_function(blending: Blending, lanes: PixelLanes) -> Any:
    """Warp function: blocks of the region at pixel (x, y) that a gaussian reaches.

    With (u, v) the offset from a pixel to the centre in standard deviations, as in `Rules.response`, the
    smallest |u| and |v| of a block are found separately: their squares sum to less than the smallest
    u^2 + v^2, so no block is lost, and few are kept without need: less than a tenth, as a test requires. The
    box alone would keep all blocks beside a slanted needle.
    """
    real = blending.real
    vec2, vec3, *_ = types_of(real)
    width, height, across, blocks = lanes.block_width, lanes.block_height, lanes.across, lanes.blocks

    @wp.func
    def reached(
        i: int,
        centers: wp.array(dtype=vec2),
        extents: wp.array(dtype=vec2),
        factors: wp.array(dtype=vec3),
        x: int,
        y: int,
    ) -> int:
        center = centers[i]
        extent = extents[i]
        factor = factors[i]
        # From the middle of the first block to the centre, and from a block's middle to its outermost pixels.
        gx = center[0] - real(x) - real(wp.static(0.5 * width))
        gy = center[1] - real(y) - real(wp.static(0.5 * height))
        margin = real(wp.static(MARGIN)) + real(wp.static(ROUNDING)) * (wp.abs(gx) + wp.abs(gy))
        half_x = real(wp.static(0.5 * (width - 1))) + margin
        half_y = real(wp.static(0.5 * (height - 1))) + margin
        half_u = factor[0] * half_x + wp.abs(factor[1]) * half_y
        half_v = factor[2] * half_y
        reach = extent[1] * factor[2]  # the box's height is that many standard deviations
        bits = int(0)
        for block in range(blocks):
            dx = gx - real((block % across) * width)
            dy = gy - real((block // across) * height)
            near = wp.where(wp.abs(dx) <= extent[0] + half_x, 1, 0)
            near = near & wp.where(wp.abs(dy) <= extent[1] + half_y, 1, 0)
            if wp.static(not blending.boxed):
                u = wp.abs(factor[0] * dx + factor[1] * dy) - half_u
                v = wp.abs(factor[2] * dy) - half_v
                u = wp.where(u > real(0.0), u, real(0.0))
                v = wp.where(v > real(0.0), v, real(0.0))
                near = near & wp.where(u * u + v * v <= reach * reach, 1, 0)
            bits = bits | (near << block)
        return bits

    return reached


@cache
def fetch_function(blending: Blending) -> Any:
    """Warp function: prefetch what blending reads of a gaussian."""
    real = blending.real
    vec2, vec3, *_ = types_of(real)
    fetch_vec2, fetch_vec3, fetch_real = (cells_of(dtype).fetch for dtype in (vec2, vec3, real))

    @wp.func
    def fetch(
        i: int,
        centers: wp.array(dtype=vec2),
        extents: wp.array(dtype=vec2),
        factors: wp.array(dtype=vec3),
        opacities: wp.array(dtype=real),
        colors: wp.array(dtype=vec3),
    ):
        fetch_vec2(centers, i)
        fetch_vec2(extents, i)
        fetch_vec3(factors, i)
        fetch_real(opacities, i)
        fetch_vec3(colors, i)

    return fetch
