"""Images and masks at the size at which a network is given them."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F


def resize_images(images: torch.Tensor, size: Sequence[int]) -> torch.Tensor:
    """Images (B, H, W, C) at another size (height, width) [px], without aliasing; carries gradient."""
    if tuple(images.shape[1:3]) == tuple(size):
        return images
    channels_first = images.permute(0, 3, 1, 2)
    return F.interpolate(channels_first, tuple(size), mode="bilinear", antialias=True).permute(0, 2, 3, 1)


def resize_masks(masks: torch.Tensor, size: Sequence[int]) -> torch.Tensor:
    """Masks (B, H, W) at another size: a pixel is masked where any part of it was."""
    if tuple(masks.shape[1:3]) == tuple(size):
        return masks
    return resize_images(masks[..., None].float(), size)[..., 0] > 1e-6
