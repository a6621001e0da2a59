"""What kernels of the renderer exchange: projected gaussians, blended images, and their gradients.

All are named tuples of Warp arrays. Kernels list their arguments one by one; launchers take these.
"""

from __future__ import annotations

from typing import NamedTuple

import warp as wp


class Splats(NamedTuple):
    """N gaussians in the image plane, zeros where culled; see `splatting.project.Projection`.

    Attributes:
        centers: shape (N,), vec2.
        depths: shape (N,).
        factors: Cholesky factors of the inverse covariances, shape (N,), vec3.
        extents: shape (N,), vec2. Has no gradient.
        opacities: shape (N,).
        depth_slopes: shape (N,), vec2; None where nothing asks for them.
    """

    centers: wp.array
    depths: wp.array
    factors: wp.array
    extents: wp.array
    opacities: wp.array
    depth_slopes: wp.array | None = None

    @property
    def slopes(self) -> wp.array:
        """`depth_slopes`, or an empty array, for kernels that read them in pixel order alone."""
        if self.depth_slopes is not None:
            return self.depth_slopes
        return wp.empty(0, dtype=self.centers.dtype, device=self.centers.device)


class Images(NamedTuple):
    """Blended images of H * W pixels; see `splatting.composite.Composite`.

    What is not asked for may be empty.

    Attributes:
        color: shape (H * W,), vec3.
        depth_sum, transmittance: shape (H * W,).
        normal_sum: shape (H * W,), vec3.
        median_depth: shape (H * W,).
    """

    color: wp.array
    depth_sum: wp.array
    transmittance: wp.array
    normal_sum: wp.array
    median_depth: wp.array


class BlendGradients(NamedTuple):
    """Where the adjoint of blending adds the gradients of what it blended, for N gaussians.

    Attributes:
        centers, factors, opacities, depths: Of the splats, shape (N,), in their types.
        colors, normals: shape (N,), vec3.
    """

    centers: wp.array
    factors: wp.array
    opacities: wp.array
    colors: wp.array
    depths: wp.array
    normals: wp.array
