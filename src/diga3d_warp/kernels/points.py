"""Reprojected pixels as points: each source pixel colours the one target pixel that it falls into.

Cheaper than a mesh, and off by up to half a pixel; where the target is nearer than the source, cracks open
through which farther surfaces show.

Invariants
- A pixel whose position is NaN, outside the target or behind a depth step covers nothing.
- On CPU each index draws all points into a band of target rows of its own; on CUDA each index draws one point
  and the minimum is atomic.
"""

from functools import cache
from typing import Any

import warp as wp

from diga3d_warp.kernels.depth_buffer import UNCOVERED, index_of, key_of
from diga3d_warp.kernels.launch import DIFFERENTIABLE, OPTIONS, launch, thread_count
from diga3d_warp.kernels.precision import types_of


@wp.func
def draw(
    pixel: int,
    positions: wp.array(dtype=wp.vec3d),
    behind: wp.array(dtype=wp.uint8),
    width: int,
    first_row: int,
    end_row: int,
    front: wp.array(dtype=wp.int64),
):
    """Draw one point into rows [first_row, end_row) of the z-buffer."""
    p = positions[pixel]
    if not (p[0] >= wp.float64(0.0) and p[0] < wp.float64(width)):
        return
    if not (p[1] >= wp.float64(first_row) and p[1] < wp.float64(end_row)):
        return
    if behind[pixel] > wp.uint8(0):
        return
    wp.atomic_min(front, int(p[1]) * width + int(p[0]), key_of(p[2], pixel))


@wp.kernel(module="unique", module_options=OPTIONS)
def draw_point_bands(
    offset: int,
    positions: wp.array(dtype=wp.vec3d),
    behind: wp.array(dtype=wp.uint8),
    width: int,
    bands: int,
    # outputs
    front: wp.array(dtype=wp.int64),
):
    band = wp.tid() + offset
    height = front.shape[0] // width
    for pixel in range(positions.shape[0]):
        draw(pixel, positions, behind, width, height * band // bands, height * (band + 1) // bands, front)


@wp.kernel(module="unique", module_options=OPTIONS)
def draw_each_point(
    offset: int,
    positions: wp.array(dtype=wp.vec3d),
    behind: wp.array(dtype=wp.uint8),
    width: int,
    # outputs
    front: wp.array(dtype=wp.int64),
):
    draw(wp.tid() + offset, positions, behind, width, 0, front.shape[0] // width, front)


@cache
def pick_kernel(scalar: Any = wp.float32) -> wp.Kernel:
    """Kernel over target pixels: colour and depth of the winning point."""
    vec3 = types_of(scalar).vec3

    @wp.kernel(module="unique", module_options=DIFFERENTIABLE)
    def pick(
        offset: int,
        image: wp.array(dtype=vec3),
        positions: wp.array(dtype=wp.vec3d),
        front: wp.array(dtype=wp.int64),
        # outputs
        warped: wp.array(dtype=vec3),
        depth: wp.array(dtype=scalar),
        visible: wp.array(dtype=wp.bool),
    ):
        i = wp.tid() + offset
        key = front[i]
        if key == UNCOVERED:
            return
        pixel = index_of(key)
        warped[i] = image[pixel]
        depth[i] = scalar(positions[pixel][2])
        visible[i] = True

    return pick


def draw_points(positions: wp.array, behind: wp.array, width: int, front: wp.array) -> None:
    """Draw source pixels into the z-buffer of a target `width` px wide."""
    if front.device.is_cpu:
        bands = min(thread_count(), front.size // width)
        launch(
            draw_point_bands, bands, [positions, behind, width, bands], [front],
            device=front.device, work=max(positions.size, 1),
        )  # fmt: skip
    else:
        launch(draw_each_point, positions.size, [positions, behind, width], [front], device=front.device)
