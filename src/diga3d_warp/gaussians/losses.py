"""Losses of a fit: colour, and depth with or without alignment (paper Sec. 3.5)."""

from __future__ import annotations

import torch

from diga3d_warp.splatting.ssim import ssim

FLAT = 1e-6
"""Variance of depth, relative to its mean square, under which a scale cannot be told from a shift."""


def photometric_loss(
    color: torch.Tensor, wanted: torch.Tensor, weight: torch.Tensor | None, ssim_weight: float
) -> torch.Tensor:
    """(1 - w) L1 + w (1 - SSIM) over the trusted pixels (paper Eq. 7), a scalar.

    Args:
        color: Rendered RGB, shape (H, W, 3).
        wanted: The image to reach, shape (H, W, 3).
        weight: Trust in each pixel in [0, 1], shape (H, W); None for 1 everywhere.
        ssim_weight: w in [0, 1]. Paper and 3DGS: 0.2.
    """
    if weight is not None:
        color = torch.lerp(wanted, color, weight[..., None])
    l1 = (color - wanted).abs().mean()
    return (1.0 - ssim_weight) * l1 + ssim_weight * (1.0 - ssim(color, wanted))


def depth_loss(
    depth: torch.Tensor, wanted: torch.Tensor, weight: torch.Tensor | None, *, aligned: bool = False
) -> torch.Tensor:
    """L1 of depth over the mean wanted depth, where that is known (paper Eq. 8), a scalar.

    The gradient reaches `depth`. Zero, without gradient, where nothing is known.

    Args:
        depth: Rendered z [scene units], shape (H, W).
        wanted: Depth to reach, shape (H, W); 0, or not finite, where it is not known.
        weight: Pixels of weight 0 do not count, shape (H, W); None for all.
        aligned: Fit scale and shift of `wanted` to `depth` first.
    """
    known = (wanted > 0.0) & wanted.isfinite() & (depth.detach() > 0.0)
    if weight is not None:
        known &= weight > 0.0
    if not known.any():
        return depth.new_zeros(())
    target = wanted[known]
    if aligned:
        scale, shift = align_depth(target, depth.detach()[known])
        target = scale * target + shift
    return (depth[known] - target).abs().mean() / target.abs().mean().clamp_min(1e-12)


def align_depth(depth: torch.Tensor, reference: torch.Tensor) -> tuple[float, float]:
    """Scale and shift that bring one depth to another by least squares (paper Sec. 3.5).

    Args:
        depth: Depth up to scale and shift, shape (M,), finite.
        reference: Depth of the same pixels [scene units], shape (M,), finite.

    Returns:
        Scale and shift [scene units]. Where `depth` is flat, the scale is 1 and the shift joins the means; a
        scale that would turn depth around is refused the same way.
    """
    x, y = depth.double(), reference.double()
    centered = x - x.mean()
    variance = float((centered**2).mean())
    scale = 1.0
    if variance > FLAT * float((x**2).mean()):
        fitted = float((centered * (y - y.mean())).mean()) / variance
        scale = fitted if fitted > 0.0 else 1.0
    return scale, float(y.mean()) - scale * float(x.mean())
