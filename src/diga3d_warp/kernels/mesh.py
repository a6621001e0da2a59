"""Reprojected pixels as a mesh: a vertex at every pixel centre, two triangles between any four neighbours.

Invariants
- A triangle with a vertex that is NaN or behind a depth step covers nothing, so none spans a step.
- A triangle seen from behind (a fold) covers nothing.
- On CPU each index draws all triangles into a band of target rows of its own; on CUDA each index draws one
  triangle and the minimum is atomic.
- Colours are linear on the surface, not in the image.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import warp as wp

from diga3d_warp.kernels.depth_buffer import UNCOVERED, index_of, key_of
from diga3d_warp.kernels.launch import DIFFERENTIABLE, OPTIONS, launch, thread_count


@dataclass(frozen=True)
class MeshLimits:
    """Which triangles are drawn.

    Attributes:
        stretch: Largest side of a triangle's box in the target [px]; sixteen times magnified, the source says
            nothing about the pixels between its own.
        edge: How far outside a triangle a pixel centre still counts as inside [source px]. Makes up for
            rounding on the outer edge of the mesh.
        area_min: Smallest area of a drawn triangle in the target [px^2]; below, it is seen edge-on.
    """

    stretch: float = 16.0
    edge: float = 1e-6
    area_min: float = 1e-8


_L = MeshLimits()


@wp.func
def corner(triangle: int, index: int, width: int):
    """Source pixel of a corner (0, 1, 2) of a triangle; even triangles are upper left, odd lower right."""
    square = triangle // 2
    pixel = square // (width - 1) * width + square % (width - 1)
    upper = wp.where(index == 0, pixel, wp.where(index == 1, pixel + 1, pixel + width))
    lower = wp.where(index == 0, pixel + width + 1, wp.where(index == 1, pixel + width, pixel + 1))
    return wp.where(triangle % 2 == 0, upper, lower)


@wp.func
def side(a: wp.vec3d, b: wp.vec3d, x: wp.float64, y: wp.float64):
    """Twice the signed area of (a, b, (x, y)) in the image."""
    return (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])


@wp.func
def draw(
    triangle: int,
    positions: wp.array(dtype=wp.vec3d),
    behind: wp.array(dtype=wp.uint8),
    source_width: int,
    width: int,
    first_row: int,
    end_row: int,
    front: wp.array(dtype=wp.int64),
):
    """Draw one triangle into rows [first_row, end_row) of the z-buffer."""
    i0 = corner(triangle, 0, source_width)
    i1 = corner(triangle, 1, source_width)
    i2 = corner(triangle, 2, source_width)
    a = positions[i0]
    b = positions[i1]
    c = positions[i2]
    low_y = wp.min(wp.min(a[1], b[1]), c[1])
    high_y = wp.max(wp.max(a[1], b[1]), c[1])
    if not (high_y >= wp.float64(first_row) and low_y <= wp.float64(end_row)):
        return
    if behind[i0] + behind[i1] + behind[i2] > wp.uint8(0):
        return
    low_x = wp.min(wp.min(a[0], b[0]), c[0])
    high_x = wp.max(wp.max(a[0], b[0]), c[0])
    if not (high_x >= wp.float64(0.0) and low_x <= wp.float64(width)):
        return
    stretch = wp.float64(wp.static(_L.stretch))
    if not (high_x - low_x <= stretch and high_y - low_y <= stretch):
        return
    area = side(a, b, c[0], c[1])
    if not (area >= wp.float64(wp.static(_L.area_min))):
        return
    slack = wp.float64(wp.static(-_L.edge)) * area
    half = wp.float64(0.5)
    margin = wp.float64(0.501)
    first_column = wp.max(int(wp.floor(low_x - margin)), 0)
    end_column = wp.min(int(wp.floor(high_x - half + wp.float64(0.001))) + 1, width)
    first = wp.max(int(wp.floor(low_y - margin)), first_row)
    end = wp.min(int(wp.floor(high_y - half + wp.float64(0.001))) + 1, end_row)
    for row in range(first, end):
        y = wp.float64(row) + half
        for column in range(first_column, end_column):
            x = wp.float64(column) + half
            wa = side(b, c, x, y)
            wb = side(c, a, x, y)
            wc = side(a, b, x, y)
            if wa >= slack and wb >= slack and wc >= slack:
                z = area / (wa / a[2] + wb / b[2] + wc / c[2])
                wp.atomic_min(front, row * width + column, key_of(z, triangle))


@wp.kernel(module="unique", module_options=OPTIONS)
def draw_bands(
    offset: int,
    positions: wp.array(dtype=wp.vec3d),
    behind: wp.array(dtype=wp.uint8),
    source_width: int,
    width: int,
    bands: int,
    # outputs
    front: wp.array(dtype=wp.int64),
):
    band = wp.tid() + offset
    height = front.shape[0] // width
    first_row = height * band // bands
    end_row = height * (band + 1) // bands
    squares = (source_width - 1) * (positions.shape[0] // source_width - 1)
    for triangle in range(2 * squares):
        draw(triangle, positions, behind, source_width, width, first_row, end_row, front)


@wp.kernel(module="unique", module_options=OPTIONS)
def draw_triangles(
    offset: int,
    positions: wp.array(dtype=wp.vec3d),
    behind: wp.array(dtype=wp.uint8),
    source_width: int,
    width: int,
    # outputs
    front: wp.array(dtype=wp.int64),
):
    triangle = wp.tid() + offset
    draw(triangle, positions, behind, source_width, width, 0, front.shape[0] // width, front)


@cache
def resolve_kernel(scalar: Any = wp.float32) -> wp.Kernel:
    """Kernel over target pixels: colour and depth of the winning triangle at the pixel centre."""
    vec3 = wp.types.vector(length=3, dtype=scalar)

    @wp.kernel(module="unique", module_options=DIFFERENTIABLE)
    def resolve(
        offset: int,
        image: wp.array(dtype=vec3),
        positions: wp.array(dtype=wp.vec3d),
        front: wp.array(dtype=wp.int64),
        source_width: int,
        width: int,
        # outputs
        warped: wp.array(dtype=vec3),
        depth: wp.array(dtype=scalar),
        visible: wp.array(dtype=wp.bool),
    ):
        i = wp.tid() + offset
        key = front[i]
        if key == UNCOVERED:
            return
        triangle = index_of(key)
        i0 = corner(triangle, 0, source_width)
        i1 = corner(triangle, 1, source_width)
        i2 = corner(triangle, 2, source_width)
        a = positions[i0]
        b = positions[i1]
        c = positions[i2]
        x = wp.float64(i % width) + wp.float64(0.5)
        y = wp.float64(i // width) + wp.float64(0.5)
        # Weights by area over depth: linear on the surface, not in the image.
        wa = side(b, c, x, y) / a[2]
        wb = side(c, a, x, y) / b[2]
        wc = side(a, b, x, y) / c[2]
        total = wa + wb + wc
        color = (
            scalar(wa / total) * image[i0] + scalar(wb / total) * image[i1] + scalar(wc / total) * image[i2]
        )
        warped[i] = color
        depth[i] = scalar(side(a, b, c[0], c[1]) / total)
        visible[i] = True

    return resolve


def draw_mesh(
    positions: wp.array, behind: wp.array, source: tuple[int, int], width: int, front: wp.array
) -> None:
    """Draw a source of (width, height) `source` into the z-buffer of a target `width` px wide."""
    triangles = 2 * max(source[0] - 1, 0) * max(source[1] - 1, 0)
    inputs = [positions, behind, source[0], width]
    if front.device.is_cpu:
        bands = min(thread_count(), front.size // width)
        launch(draw_bands, bands, [*inputs, bands], [front], device=front.device, work=max(triangles, 1))
    else:
        launch(draw_triangles, triangles, inputs, [front], device=front.device)
