"""DIBR: carry an image along its depth into another camera (paper Eq. 5), with a z-buffer.

The source is a mesh: every pixel centre is a vertex at its depth, every square of four neighbours two
triangles. So there are no cracks where the target is nearer, and a plane is carried by its exact homography.

Invariants
- Positions are float64 inside: the same camera gives the image back to float32 precision, and the order of
  surfaces does not depend on rounding.
- Every guard is written positively, so that NaN fails it. A vertex without a valid position is NaN, and a
  triangle with such a vertex covers nothing.
- A pixel on the far side of a depth step is no vertex: its colour is mixed with the nearer surface's and
  would float on the farther one as a ghost edge. No triangle spans a step, either.
- A triangle seen from behind (a fold) covers nothing.
- The z-buffer holds (float32 depth bits << 32 | triangle), and the smallest key wins: the nearest surface, at
  equal depth the first in the source. It does not depend on the order in which triangles are drawn.
- On CPU each index draws all triangles into a band of target rows of its own; on CUDA each index draws one
  square and the minimum is atomic.
- The gradient holds the winning triangle fixed. Its scatter to the source is one serial launch on CPU, so
  that it does not depend on the number of threads.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import warp as wp

from diga3d_warp.kernels.cameras import lens_model
from diga3d_warp.kernels.launch import DIFFERENTIABLE, OPTIONS, launch, thread_count


@dataclass(frozen=True)
class ReprojectionLimits:
    """What is carried and what is not.

    Attributes:
        depth_step: A neighbour nearer by more than this share of its own depth is another surface [ratio]. A
            surface whose normal is 87 degrees off the ray has steps of 0.05 at a focal length of 400 px: at
            such an angle it carries no texture.
        stretch: Largest side of a triangle's box in the target [px]; sixteen times magnified, the source says
            nothing about the pixels between its own.
        depth_min, depth_max: Range of usable depths [scene units]; squares and reciprocals of these are
            still numbers.
        approach: Smallest ratio of the depth in the target to the depth in the source. Nearer points, and
            those behind the target, are dropped; `stretch` would drop the rest.
        edge: How far outside a triangle a pixel centre still counts as inside [source px]. Makes up for
            rounding on the outer edge of the mesh.
        area_min: Smallest area of a drawn triangle in the target [px^2]; below, it is seen edge-on.
    """

    depth_step: float = 0.05
    stretch: float = 16.0
    depth_min: float = 1e-15
    depth_max: float = 1e15
    approach: float = 1e-3
    edge: float = 1e-6
    area_min: float = 1e-8


_L = ReprojectionLimits()
UNCOVERED = wp.constant(wp.int64(0x7FFFFFFFFFFFFFFF))
"""z-buffer key of a pixel that no triangle covers."""


@cache
def placement(lens_kind: str) -> Any:
    """Function (depth, ray, then `Motion.arguments` without the rays) -> (column, row, depth) or NaN."""
    distort = lens_model(lens_kind, wp.float64).distort

    @wp.func
    def place(
        z: wp.float64,
        ray: wp.vec2d,
        rotation: wp.mat33d,
        translation: wp.vec3d,
        intrinsics: wp.vec4d,
        coefficients: wp.vec4d,
        radius_max: wp.float64,
    ):
        nowhere = wp.vec3d(wp.float64(wp.nan), wp.float64(wp.nan), wp.float64(wp.nan))
        if not (z >= wp.float64(wp.static(_L.depth_min)) and z <= wp.float64(wp.static(_L.depth_max))):
            return nowhere
        if not (wp.isfinite(ray[0]) and wp.isfinite(ray[1])):
            return nowhere
        p = rotation * wp.vec3d(ray[0] * z, ray[1] * z, z) + translation
        if not (p[2] >= wp.float64(wp.static(_L.approach)) * z):
            return nowhere
        x = p[0] / p[2]
        y = p[1] / p[2]
        if not (x * x + y * y < radius_max * radius_max):
            return nowhere
        d = distort(x, y, coefficients)
        return wp.vec3d(intrinsics[0] * d[0] + intrinsics[2], intrinsics[1] * d[1] + intrinsics[3], p[2])

    return place


@cache
def position_kernel(lens_kind: str, scalar: Any = wp.float32) -> wp.Kernel:
    """Kernel over source pixels: where each lies in the target camera, as (column, row, depth) or NaN.

    Args:
        lens_kind: Lens of the target.
        scalar: Type of the depth.
    """
    place = placement(lens_kind)

    @wp.kernel(module="unique", module_options=DIFFERENTIABLE)
    def position(
        offset: int,
        depth: wp.array(dtype=scalar),
        rays: wp.array(dtype=wp.vec2d),
        rotation: wp.mat33d,
        translation: wp.vec3d,
        intrinsics: wp.vec4d,
        coefficients: wp.vec4d,
        radius_max: wp.float64,
        # outputs
        positions: wp.array(dtype=wp.vec3d),
    ):
        i = wp.tid() + offset
        positions[i] = place(
            wp.float64(depth[i]), rays[i], rotation, translation, intrinsics, coefficients, radius_max
        )

    return position


@cache
def steps_kernel(scalar: Any = wp.float32) -> wp.Kernel:
    """Kernel over source pixels: 1 where a neighbour is nearer by more than a depth step, else 0."""

    @wp.kernel(module="unique", module_options=OPTIONS)
    def behind_step(
        offset: int,
        depth: wp.array(dtype=scalar),
        width: int,
        # outputs
        behind: wp.array(dtype=wp.uint8),
    ):
        i = wp.tid() + offset
        height = depth.shape[0] // width
        row = i // width
        column = i % width
        limit = depth[i] * scalar(wp.static(1.0 - _L.depth_step))
        found = wp.uint8(0)
        for r in range(wp.max(row - 1, 0), wp.min(row + 2, height)):
            for c in range(wp.max(column - 1, 0), wp.min(column + 2, width)):
                z = depth[r * width + c]
                if z >= scalar(wp.static(_L.depth_min)) and z < limit:
                    found = wp.uint8(1)
        behind[i] = found

    return behind_step


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
                depth_bits = wp.int64(wp.cast(wp.float32(z), wp.int32))
                key = (depth_bits << wp.int64(32)) | wp.int64(triangle)
                wp.atomic_min(front, row * width + column, key)


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
        triangle = int(key & wp.int64(0x7FFFFFFF))
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


@dataclass(frozen=True, eq=False)
class Motion:
    """From the pixels of a source camera to those of a target camera.

    Attributes:
        width, height: Size of the source [px].
        rays: (x/z, y/z) of every source pixel, shape [H * W], 2-vectors of float64; NaN where there is none.
        rotation, translation: Source camera space to target camera space.
        target_width, target_height: Size of the target [px].
        lens_kind, intrinsics, coefficients, radius_max: Optics of the target: (fx, fy, cx, cy) [px], lens
            coefficients, and `valid_radius`.
    """

    width: int
    height: int
    rays: wp.array
    rotation: wp.mat33d
    translation: wp.vec3d
    target_width: int
    target_height: int
    lens_kind: str
    intrinsics: wp.vec4d
    coefficients: wp.vec4d
    radius_max: float

    @property
    def arguments(self) -> list[Any]:
        """The arguments of the position kernel after the depth."""
        return [
            self.rays, self.rotation, self.translation, self.intrinsics, self.coefficients, self.radius_max
        ]  # fmt: skip


def reproject(
    image: wp.array, depth: wp.array, motion: Motion, outputs: list[wp.array]
) -> tuple[wp.array, wp.array]:
    """Carry an image into the target camera.

    To put it on a `wp.Tape`, follow the call with
    `tape.record_func(lambda: reproject_adjoint(...), [image, depth])`.

    Args:
        image: RGB of the source, shape [H * W], 3-vectors of float32 or float64.
        depth: Depth of the source [scene units], shape [H * W], the same scalar type.
        motion: From source to target.
        outputs: Image, depth and visibility in the target, shape [h * w]: 3-vectors, scalars, bool. They must
            hold zeros; where nothing is visible they keep them.

    Returns:
        Positions of the source pixels and the z-buffer, which `reproject_adjoint` takes.
    """
    device, pixels = depth.device, motion.target_width * motion.target_height
    positions = wp.empty(depth.size, dtype=wp.vec3d, device=device)
    behind = wp.empty(depth.size, dtype=wp.uint8, device=device)
    front = wp.full(pixels, UNCOVERED, dtype=wp.int64, device=device)
    launch(
        position_kernel(motion.lens_kind, depth.dtype),
        depth.size,
        [depth, *motion.arguments],
        [positions],
        device=device,
    )
    launch(steps_kernel(depth.dtype), depth.size, [depth, motion.width], [behind], device=device)
    triangles = 2 * max(motion.width - 1, 0) * max(motion.height - 1, 0)
    mesh = [positions, behind, motion.width, motion.target_width]
    if device.is_cpu:
        bands = min(thread_count(), motion.target_height)
        launch(draw_bands, bands, [*mesh, bands], [front], device=device, work=max(triangles, 1))
    else:
        launch(draw_triangles, triangles, mesh, [front], device=device)
    launch(
        resolve_kernel(depth.dtype),
        pixels,
        [image, positions, front, motion.width, motion.target_width],
        outputs,
        device=device,
    )
    return positions, front


def reproject_adjoint(
    image: wp.array,
    depth: wp.array,
    motion: Motion,
    outputs: list[wp.array],
    positions: wp.array,
    front: wp.array,
    adj_outputs: list[wp.array],
    adj_image: wp.array,
    adj_depth: wp.array,
) -> None:
    """Add the gradients of image and depth.

    Args:
        image, depth, motion, outputs: As in `reproject`.
        positions, front: What `reproject` returned.
        adj_outputs: Gradients of the image and the depth in the target.
        adj_image, adj_depth: Outputs, added to.
    """
    device = depth.device
    adj_positions = wp.zeros_like(positions)
    wp.launch(
        resolve_kernel(depth.dtype),
        front.size,
        inputs=[0, image, positions, front, motion.width, motion.target_width],
        outputs=outputs,
        adj_inputs=[0, adj_image, adj_positions, None, 0, 0],
        adj_outputs=[*adj_outputs, None],
        adjoint=True,
        device=device,
        record_tape=False,
    )
    launch(
        position_kernel(motion.lens_kind, depth.dtype),
        depth.size,
        [depth, *motion.arguments],
        [positions],
        adj_inputs=[adj_depth, None, *motion.arguments[1:]],
        adj_outputs=[adj_positions],
        adjoint=True,
        device=device,
    )
