"""Differentiable blending of projected gaussians into an image."""

from __future__ import annotations

from typing import NamedTuple

import torch

from diga3d_warp.config import Accuracy, Effects
from diga3d_warp.kernels import compositing, compositing_adjoint
from diga3d_warp.kernels.binning import Bins, bin_gaussians
from diga3d_warp.kernels.blending import Blending
from diga3d_warp.kernels.precision import types_of
from diga3d_warp.splatting.arrays import REALS, like, vector_arrays, warp_array
from diga3d_warp.splatting.project import Projection


class Composite(NamedTuple):
    """Blended image, before any background.

    Attributes:
        color: Sum of colours by weight, shape (H, W, 3).
        depth_sum: Sum of depths by weight [scene units], shape (H, W); zeros if not asked for.
        transmittance: What is left of the light behind all gaussians, in [0, 1], shape (H, W).
        normal_sum: Sum of normals by weight, shape (H, W, 3); None if not asked for.
        median_depth: Depth of the gaussian at which transmittance falls below a half [scene units], 0 where
            it never does, shape (H, W); None if not asked for.
    """

    color: torch.Tensor
    depth_sum: torch.Tensor
    transmittance: torch.Tensor
    normal_sum: torch.Tensor | None = None
    median_depth: torch.Tensor | None = None


def composite(
    projection: Projection,
    colors: torch.Tensor,
    width: int,
    height: int,
    *,
    accuracy: Accuracy = Accuracy.STANDARD,
    effects: Effects = Effects(),
    normals: torch.Tensor | None = None,
    median_depth: bool = False,
) -> Composite:
    """Blend front to back (paper Eq. 1) with the cut-offs of `accuracy`.

    Gradients reach centers, roots, opacities and colours; normals; depths with `effects.depth` or
    `median_depth`. What is not asked for is not in the compiled kernel.

    Args:
        projection: N gaussians, from `project`.
        colors: shape (N, 3).
        width, height: Image size [px].
        accuracy: Cut-offs, polynomial, precision, order. With "float64", tensors are converted to it.
        effects: Whether depths are blended, and whether each pixel has its own order.
        normals: Blended too where given, shape (N, 3).
        median_depth: Whether to find the median depth; its gradient goes to the depth of that one gaussian.

    Raises:
        ValueError: a cut-off or a degree that no kernel can be compiled for; `projection.depth_slopes` is
            None where each pixel has its own order.
    """
    blending = Blending.of(accuracy, effects, normals=normals is not None, median=median_depth)
    dtype = getattr(torch, blending.precision)
    centers, extents, roots, opacities, colors, depths = (
        tensor.to(dtype)
        for tensor in (
            projection.centers, projection.extents, projection.roots, projection.opacities, colors,
            projection.depths,
        )
    )  # fmt: skip
    normals = colors.new_empty((0, 3)) if normals is None else normals.to(dtype)
    slopes = slopes_of(projection, blending).to(dtype)
    bins = bin_projection(projection, width, height, dtype)
    color, depth_sum, transmittance, normal_sum, median = _Composite.apply(
        centers, extents, roots, opacities, colors, depths, normals, slopes, bins, width, height, blending
    )
    return Composite(
        color.view(height, width, 3),
        depth_sum.view(height, width),
        transmittance.view(height, width),
        normal_sum.view(height, width, 3) if blending.normals else None,
        median.view(height, width) if blending.median else None,
    )


def slopes_of(projection: Projection, blending: Blending) -> torch.Tensor:
    """Slopes of depth (N, 2) if the blending needs them, otherwise none, shape (0, 2).

    Raises:
        ValueError: it needs them, but the projection has none.
    """
    if not blending.pixel_order:
        return projection.centers.new_empty((0, 2))
    if projection.depth_slopes is None:
        raise ValueError("per-pixel order needs depth_slopes: project with the same accuracy and effects")
    return projection.depth_slopes


def bin_projection(projection: Projection, width: int, height: int, dtype: torch.dtype) -> Bins:
    """List the gaussians of each tile, nearest first, by positions of a floating-point type."""
    vec2 = types_of(REALS[dtype]).vec2
    return bin_gaussians(
        warp_array(projection.centers.to(dtype), vec2),
        warp_array(projection.depths.to(dtype), REALS[dtype]),
        warp_array(projection.extents.to(dtype), vec2),
        width,
        height,
    )


class _Composite(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx, centers, extents, roots, opacities, colors, depths, normals, slopes, bins: Bins, width, height,
        blending: Blending,
    ):  # fmt: skip
        splats = tuple(
            tensor.detach().contiguous()
            for tensor in (centers, extents, roots, opacities, colors, depths, normals, slopes)
        )
        pixels = height * width
        outputs = (
            centers.new_empty((pixels, 3)),
            centers.new_zeros(pixels),
            centers.new_empty(pixels),
            centers.new_empty((pixels if blending.normals else 0, 3)),
            centers.new_empty(pixels if blending.median else 0),
        )
        ctx.changes = compositing.composite(
            bins, width, height, vector_arrays(splats), vector_arrays(outputs), blending
        )
        ctx.save_for_backward(*splats, *outputs)
        ctx.task = bins, width, height, blending
        return outputs

    @staticmethod
    def backward(ctx, *given):
        splats, outputs = ctx.saved_tensors[:8], ctx.saved_tensors[8:]
        bins, width, height, blending = ctx.task
        adj_outputs = [like(grad, output) for grad, output in zip(given, outputs, strict=True)]
        adj_centers, *adj_others = (torch.zeros_like(splats[k]) for k in (0, 2, 3, 4, 5, 6))
        compositing_adjoint.composite_adjoint(
            bins, width, height, vector_arrays(splats), vector_arrays(outputs), ctx.changes,
            vector_arrays(adj_outputs), vector_arrays([adj_centers, *adj_others]), blending,
        )  # fmt: skip
        return adj_centers, None, *adj_others, None, None, None, None, None
