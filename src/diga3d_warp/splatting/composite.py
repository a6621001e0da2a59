"""Differentiable blending of projected gaussians into an image."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
import warp as wp

from diga3d_warp.config import Accuracy, Effects
from diga3d_warp.kernels import compositing, compositing_adjoint
from diga3d_warp.kernels.binning import Bins, bin_gaussians
from diga3d_warp.kernels.blending import Blending
from diga3d_warp.kernels.splats import BlendGradients, Images, Splats
from diga3d_warp.splatting.arrays import like, vector_arrays
from diga3d_warp.splatting.project import Projection


class Composite(NamedTuple):
    """Blended image, before any background.

    Attributes:
        color: Sum of colours by weight, shape (H, W, 3).
        depth_sum: Sum of depths by weight [scene units], shape (H, W); zeros if not asked for.
        transmittance: Transmittance behind all gaussians, in [0, 1], shape (H, W).
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

    Gradients reach centers, factors, opacities and colours; normals; depths with `effects.depth` or
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
    splats = in_precision(projection, blending)
    colors = colors.to(splats.centers)
    normals = colors.new_empty((0, 3)) if normals is None else normals.to(colors)
    bins = bin_projection(splats, width, height)
    color, depth_sum, transmittance, normal_sum, median = _Composite.apply(
        *splats, colors, normals, bins, width, height, blending
    )
    return Composite(
        color.view(height, width, 3),
        depth_sum.view(height, width),
        transmittance.view(height, width),
        normal_sum.view(height, width, 3) if blending.normals else None,
        median.view(height, width) if blending.median else None,
    )


def in_precision(projection: Projection, blending: Blending) -> Projection:
    """The projection as kernels of one kind read it: slopes are empty unless each pixel has its own order.

    Raises:
        ValueError: slopes are needed, but the projection has none.
    """
    if not blending.pixel_order:
        projection = projection._replace(depth_slopes=projection.centers.new_empty((0, 2)))
    elif projection.depth_slopes is None:
        raise ValueError("per-pixel order needs depth_slopes: project with the same accuracy and effects")
    dtype = getattr(torch, blending.precision)
    return Projection(*(tensor.to(dtype) for tensor in projection.tensors))


def bin_projection(projection: Projection, width: int, height: int) -> Bins:
    """List the gaussians of each tile, nearest first."""
    centers, depths, extents = vector_arrays([projection.centers, projection.depths, projection.extents])
    return bin_gaussians(centers, depths, extents, width, height)


class _Composite(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx, centers, depths, factors, extents, opacities, depth_slopes, colors, normals, bins: Bins, width,
        height, blending: Blending,
    ):  # fmt: skip
        inputs = tuple(
            tensor.detach().contiguous()
            for tensor in (
                centers, depths, factors, extents, opacities, depth_slopes, colors, normals
            )
        )  # fmt: skip
        pixels = height * width
        images = (
            centers.new_empty((pixels, 3)),
            centers.new_zeros(pixels),
            centers.new_empty(pixels),
            centers.new_empty((pixels if blending.normals else 0, 3)),
            centers.new_empty(pixels if blending.median else 0),
        )
        ctx.changes = compositing.composite(
            bins, width, height, *_blended(inputs), Images(*vector_arrays(images)), blending
        )
        ctx.save_for_backward(*inputs, *images)
        ctx.task = bins, width, height, blending
        return images

    @staticmethod
    def backward(ctx, *given):
        inputs, images = ctx.saved_tensors[:-5], ctx.saved_tensors[-5:]
        bins, width, height, blending = ctx.task
        adj_images = [like(gradient, image) for gradient, image in zip(given, images, strict=True)]
        centers, depths, factors, _extents, opacities, _slopes, colors, normals = inputs
        adj_centers, adj_factors, adj_opacities, adj_colors, adj_depths, adj_normals = gradients = [
            torch.zeros_like(tensor) for tensor in (centers, factors, opacities, colors, depths, normals)
        ]
        compositing_adjoint.composite_adjoint(
            bins, width, height, *_blended(inputs), Images(*vector_arrays(images)), ctx.changes,
            Images(*vector_arrays(adj_images)), BlendGradients(*vector_arrays(gradients)), blending,
        )  # fmt: skip
        return (
            adj_centers, adj_depths, adj_factors, None, adj_opacities, None, adj_colors, adj_normals,
            None, None, None, None,
        )  # fmt: skip


def _blended(inputs: Sequence[torch.Tensor]) -> tuple[Splats, wp.array, wp.array]:
    """Splats, colours and normals as Warp arrays, from the tensors of `_Composite` in order."""
    *splats, colors, normals = vector_arrays(inputs)
    return Splats(*splats), colors, normals
