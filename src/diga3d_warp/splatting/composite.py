"""Differentiable blending of projected gaussians into an image."""

from __future__ import annotations

from typing import NamedTuple

import torch
import warp as wp

from diga3d_warp.kernels import compositing, compositing_adjoint
from diga3d_warp.kernels.binning import Bins, bin_gaussians
from diga3d_warp.splatting.arrays import like, warp_array
from diga3d_warp.splatting.project import Projection

_SPLATS = (wp.vec2, wp.vec2, wp.vec3, wp.float32, wp.vec3, wp.float32)
_OUTPUTS = (wp.vec3, wp.float32, wp.float32)


class Composite(NamedTuple):
    """Blended image, before any background.

    Attributes:
        color: Sum of colours by weight, shape (H, W, 3).
        depth_sum: Sum of depths by weight [scene units], shape (H, W); zeros if not asked for.
        transmittance: What is left of the light behind all gaussians, in [0, 1], shape (H, W).
    """

    color: torch.Tensor
    depth_sum: torch.Tensor
    transmittance: torch.Tensor


def composite(
    projection: Projection, colors: torch.Tensor, width: int, height: int, *, with_depth: bool = True
) -> Composite:
    """Blend front to back (paper Eq. 1) with the cut-offs of `config.Splatting`.

    Gradients reach centers, conics, opacities, colours, and depths with `with_depth`.

    Args:
        projection: From `project`.
        colors: shape (N, 3).
        width, height: Image size [px].
        with_depth: Blend depths too; without, that code is not in the kernel.
    """
    bins = bin_gaussians(
        warp_array(projection.centers, wp.vec2),
        warp_array(projection.depths, wp.float32),
        warp_array(projection.extents, wp.vec2),
        width,
        height,
    )
    return Composite(
        *_Composite.apply(
            projection.centers, projection.extents, projection.conics, projection.opacities,
            colors, projection.depths, bins, width, height, with_depth,
        )
    )  # fmt: skip


class _Composite(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx, centers, extents, conics, opacities, colors, depths, bins: Bins, width, height, with_depth
    ):
        splats = tuple(
            tensor.detach().contiguous() for tensor in (centers, extents, conics, opacities, colors, depths)
        )
        color = centers.new_empty((height, width, 3))
        depth_sum = centers.new_zeros((height, width))
        transmittance = centers.new_empty((height, width))
        outputs = (color, depth_sum, transmittance)
        ctx.changes = compositing.composite(
            bins, width, height, *_arguments(splats, outputs), with_depth=with_depth
        )
        ctx.save_for_backward(*splats, *outputs)
        ctx.bins, ctx.with_depth = bins, with_depth
        return outputs

    @staticmethod
    def backward(ctx, adj_color, adj_depth_sum, adj_transmittance):
        splats, outputs = ctx.saved_tensors[:6], ctx.saved_tensors[6:]
        centers, _, conics, opacities, colors, depths = splats
        given = (adj_color, adj_depth_sum, adj_transmittance)
        adj_outputs = [like(grad, output) for grad, output in zip(given, outputs, strict=True)]
        adj_splats = [torch.zeros_like(t) for t in (centers, conics, opacities, colors, depths)]
        compositing_adjoint.composite_adjoint(
            ctx.bins,
            outputs[0].shape[1],
            outputs[0].shape[0],
            *_arguments(splats, outputs),
            ctx.changes,
            _flat(adj_outputs),
            [
                warp_array(grad, dtype)
                for grad, dtype in zip(
                    adj_splats, (wp.vec2, wp.vec3, wp.float32, wp.vec3, wp.float32), strict=True
                )
            ],
            with_depth=ctx.with_depth,
        )
        adj_centers, adj_conics, adj_opacities, adj_colors, adj_depths = adj_splats
        return adj_centers, None, adj_conics, adj_opacities, adj_colors, adj_depths, None, None, None, None


def _arguments(splats, outputs) -> tuple[list[wp.array], list[wp.array]]:
    return [warp_array(t, dtype) for t, dtype in zip(splats, _SPLATS, strict=True)], _flat(outputs)


def _flat(images) -> list[wp.array]:
    color, depth_sum, transmittance = images
    return [
        warp_array(color.reshape(-1, 3), wp.vec3),
        warp_array(depth_sum.reshape(-1), wp.float32),
        warp_array(transmittance.reshape(-1), wp.float32),
    ]
