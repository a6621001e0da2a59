"""Differentiable structural similarity of a rendered image and a photograph."""

from __future__ import annotations

import torch
import warp as wp

from diga3d_warp.kernels import ssim as kernels
from diga3d_warp.splatting.arrays import like, warp_array


def ssim(image: torch.Tensor, target: torch.Tensor, *, reduce: bool = True) -> torch.Tensor:
    """Structural similarity (Wang et al. 2004) with the window of 3DGS: 11 px, sigma 1.5, zero padding.

    The gradient reaches `image` alone.

    Args:
        image, target: RGB in [0, 1], shape (H, W, 3), float32, on one device.
        reduce: Give the mean over pixels and channels, a scalar; otherwise the map, shape (H, W, 3).

    Raises:
        ValueError: the shapes differ, or are not (H, W, 3).
    """
    if image.ndim != 3 or image.shape[2] != 3 or image.shape != target.shape:
        raise ValueError(
            f"image {tuple(image.shape)} and target {tuple(target.shape)} must have one shape (H, W, 3)"
        )
    similarities = _Similarity.apply(image, target)
    return similarities.mean() if reduce else similarities


class _Similarity(torch.autograd.Function):
    @staticmethod
    def forward(ctx, image, target):
        inputs = tuple(like(tensor.detach(), tensor) for tensor in (image, target))
        similarities, *derivatives = (torch.empty_like(inputs[0]) for _ in range(4))
        height, width, _ = image.shape
        kernels.similarity(_flat(*inputs), width, height, _flat(similarities, *derivatives))
        ctx.save_for_backward(*inputs, *derivatives)
        return similarities

    @staticmethod
    def backward(ctx, adj_similarities):
        image, target, *derivatives = ctx.saved_tensors
        height, width, _ = image.shape
        adj_image = torch.zeros_like(image)
        kernels.similarity_adjoint(
            _flat(image, target),
            width,
            height,
            _flat(*derivatives),
            *_flat(like(adj_similarities, image), adj_image),
        )
        return adj_image, None


def _flat(*images: torch.Tensor) -> list[wp.array]:
    return [warp_array(image.view(-1), wp.float32) for image in images]
