"""DIBR: warp an image by its depth into another camera (paper Eq. 5), with a z-buffer.

Here every source pixel gets its place in the target; `mesh` or `points` then draw. A mesh has no cracks where
the target is nearer and maps a plane by its exact homography; points are cheaper.

Invariants
- Positions are float64 inside: the same camera gives the image back to float32 precision, and the order of
  surfaces does not depend on rounding.
- Every guard is written positively, so that NaN fails it. A pixel without a valid position is NaN.
- A pixel on the far side of a depth step is not drawn: its colour is mixed with the nearer surface's and
  would float on the farther one as a ghost edge.
- The gradient holds the winner of each target pixel fixed. Its scatter to the source is one serial launch on
  CPU, so that it does not depend on the number of threads.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import warp as wp

from diga3d_warp.kernels import mesh, points
from diga3d_warp.kernels.cameras import lens_model
from diga3d_warp.kernels.depth_buffer import UNCOVERED
from diga3d_warp.kernels.launch import DIFFERENTIABLE, OPTIONS, launch


@dataclass(frozen=True)
class ReprojectionLimits:
    """Which pixels are warped.

    Attributes:
        depth_step: A neighbour nearer by more than this share of its own depth is another surface [ratio]. A
            surface whose normal is 87 degrees off the ray has steps of 0.05 at a focal length of 400 px: at
            such an angle it has no texture.
        depth_min, depth_max: Range of usable depths [scene units]; squares and reciprocals of these are
            still numbers.
        approach: Smallest ratio of the depth in the target to the depth in the source. Nearer points, and
            those behind the target, are dropped; `mesh.MeshLimits.stretch` would drop the rest.
    """

    depth_step: float = 0.05
    depth_min: float = 1e-15
    depth_max: float = 1e15
    approach: float = 1e-3


_L = ReprojectionLimits()


@cache
def placement(lens_kind: str) -> Any:
    """Function (depth, ray, then `Motion.arguments` without the rays) -> (column, row, depth) or NaN."""
    lens = lens_model(lens_kind, wp.float64)
    vector, distort = lens.vector, lens.distort

    @wp.func
    def place(
        z: wp.float64,
        ray: wp.vec2d,
        rotation: wp.mat33d,
        translation: wp.vec3d,
        intrinsics: wp.vec4d,
        coefficients: vector,
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
        u, v = distort(x, y, coefficients)
        return wp.vec3d(intrinsics[0] * u + intrinsics[2], intrinsics[1] * v + intrinsics[3], p[2])

    return place


@cache
def position_kernel(lens_kind: str, scalar: Any = wp.float32) -> wp.Kernel:
    """Kernel over source pixels: the position of each in the target camera, as (column, row, depth) or NaN.

    Args:
        lens_kind: Lens of the target.
        scalar: Type of the depth.
    """
    place = placement(lens_kind)
    vector = lens_model(lens_kind, wp.float64).vector

    @wp.kernel(module="unique", module_options=DIFFERENTIABLE)
    def position(
        offset: int,
        depth: wp.array(dtype=scalar),
        rays: wp.array(dtype=wp.vec2d),
        rotation: wp.mat33d,
        translation: wp.vec3d,
        intrinsics: wp.vec4d,
        coefficients: vector,
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
    coefficients: Any
    radius_max: float

    @property
    def arguments(self) -> list[Any]:
        """The arguments of the position kernel after the depth."""
        return [
            self.rays, self.rotation, self.translation, self.intrinsics, self.coefficients, self.radius_max
        ]  # fmt: skip


def reproject(
    image: wp.array, depth: wp.array, motion: Motion, outputs: list[wp.array], sampling: str = "bilinear"
) -> tuple[wp.array, wp.array]:
    """Warp an image into the target camera.

    To put it on a `wp.Tape`, follow the call with
    `tape.record_func(lambda: reproject_adjoint(...), [image, depth])`.

    Args:
        image: RGB of the source, shape [H * W], 3-vectors of float32 or float64.
        depth: Depth of the source [scene units], shape [H * W], the same scalar type.
        motion: From source to target.
        outputs: Image, depth and visibility in the target, shape [h * w]: 3-vectors, scalars, bool. They must
            hold zeros; where nothing is visible they keep them.
        sampling: "bilinear" draws a mesh, "nearest" points.

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
    if sampling == "nearest":
        points.draw_points(positions, behind, motion.target_width, front)
    else:
        mesh.draw_mesh(positions, behind, (motion.width, motion.height), motion.target_width, front)
    kernel, sizes = _resolving(motion, depth.dtype, sampling)
    launch(kernel, pixels, [image, positions, front, *sizes], outputs, device=device)
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
    sampling: str = "bilinear",
) -> None:
    """Add the gradients of image and depth.

    Args:
        image, depth, motion, outputs: As in `reproject`.
        positions, front: What `reproject` returned.
        adj_outputs: Gradients of the image and the depth in the target.
        adj_image, adj_depth: Outputs, added to.
        sampling: As in `reproject`.
    """
    device = depth.device
    adj_positions = wp.zeros_like(positions)
    kernel, sizes = _resolving(motion, depth.dtype, sampling)
    wp.launch(
        kernel,
        front.size,
        inputs=[0, image, positions, front, *sizes],
        outputs=outputs,
        adj_inputs=[0, adj_image, adj_positions, None, *(0 for _ in sizes)],
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


def _resolving(motion: Motion, scalar: Any, sampling: str) -> tuple[wp.Kernel, list[int]]:
    """The kernel that reads the z-buffer, and its arguments after it."""
    if sampling == "nearest":
        return points.pick_kernel(scalar), []
    return mesh.resolve_kernel(scalar), [motion.width, motion.target_width]
