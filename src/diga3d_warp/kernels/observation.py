"""What another camera saw of the surfaces behind some pixels: one look-up per pixel.

Invariants
- Each index owns one pixel: its count of observations, and the rows of samples at that index.
- A point counts as observed if it is the first surface in the other view (the depths agree), that view's
  pixel there is clear of its mask, and the two directions towards the point differ by a bounded angle.
- Guards are positive, so that a NaN depth or ray observes nothing.
"""

from functools import cache

import warp as wp

from diga3d_warp.kernels.cameras import lens_model
from diga3d_warp.kernels.launch import OPTIONS, launch
from diga3d_warp.kernels.reprojection import Motion, placement


@cache
def look_up_kernel(lens_kind: str) -> wp.Kernel:
    """The kernel for one lens of the other view: "none", "brown", "brown5" or "fisheye"."""
    place = placement(lens_kind)
    vector = lens_model(lens_kind, wp.float64).vector

    @wp.kernel(module="unique", module_options=OPTIONS)
    def look_up(
        offset: int,
        depth: wp.array(dtype=float),
        rays: wp.array(dtype=wp.vec2d),
        rotation: wp.mat33d,
        translation: wp.vec3d,
        intrinsics: wp.vec4d,
        coefficients: vector,
        radius_max: wp.float64,
        surface: wp.array2d(dtype=float),
        clear: wp.array2d(dtype=wp.bool),
        image: wp.array2d(dtype=wp.vec3ub),
        depth_tolerance: float,
        cosine_min: float,
        # outputs
        count: wp.array(dtype=int),
        samples: wp.array2d(dtype=wp.vec3),
    ):
        i = wp.tid() + offset
        n = count[i]
        if n >= samples.shape[0]:
            return
        z = wp.float64(depth[i])
        ray = rays[i]
        p = place(z, ray, rotation, translation, intrinsics, coefficients, radius_max)
        column = p[0] - wp.float64(0.5)
        row = p[1] - wp.float64(0.5)
        height = surface.shape[0]
        width = surface.shape[1]
        if not (column >= wp.float64(0.0) and column <= wp.float64(width - 1)):
            return
        if not (row >= wp.float64(0.0) and row <= wp.float64(height - 1)):
            return
        near_row = int(wp.rint(row))
        near_column = int(wp.rint(column))
        if not clear[near_row, near_column]:
            return
        there = float(p[2])
        if not (wp.abs(surface[near_row, near_column] - there) <= depth_tolerance * there):
            return
        point = wp.vec3d(ray[0] * z, ray[1] * z, z)
        eye = -(wp.transpose(rotation) * translation)  # the other camera, in this camera's space
        cosine = wp.dot(wp.normalize(point), wp.normalize(point - eye))
        if not (cosine >= wp.float64(cosine_min)):
            return
        left = wp.min(int(column), width - 2)
        top = wp.min(int(row), height - 2)
        x = float(column) - float(left)
        y = float(row) - float(top)
        upper = (1.0 - x) * color_at(image, top, left) + x * color_at(image, top, left + 1)
        lower = (1.0 - x) * color_at(image, top + 1, left) + x * color_at(image, top + 1, left + 1)
        samples[n, i] = ((1.0 - y) * upper + y * lower) / 255.0
        count[i] = n + 1

    return look_up


@wp.func
def color_at(image: wp.array2d(dtype=wp.vec3ub), row: int, column: int):
    c = image[row, column]
    return wp.vec3(float(c[0]), float(c[1]), float(c[2]))


def look_up(
    depth: wp.array,
    motion: Motion,
    surface: wp.array,
    clear: wp.array,
    image: wp.array,
    depth_tolerance: float,
    cosine_min: float,
    count: wp.array,
    samples: wp.array,
) -> None:
    """Add one view's observations of some pixels.

    Args:
        depth: Depth of the pixels in their own camera [scene units], shape [P].
        motion: From that camera to the other; its rays are those of the same P pixels.
        surface: Depth of the other view [scene units], shape [H, W]; NaN where it is not solid.
        clear: Where the other view's photograph may be used, shape [H, W], bool.
        image: The other view's photograph, shape [H, W], 3-vectors of 8 bits, at least 2 x 2 px.
        depth_tolerance: Largest difference of depths that are the same surface [ratio].
        cosine_min: Cosine of the largest angle between the directions.
        count: Output, observations so far, shape [P], added to.
        samples: Output, the first observed colours in [0, 1], shape [S, P], 3-vectors.
    """
    launch(
        look_up_kernel(motion.lens_kind), depth.size,
        [depth, *motion.arguments, surface, clear, image, depth_tolerance, cosine_min], [count, samples],
        device=depth.device, work=4,
    )  # fmt: skip
