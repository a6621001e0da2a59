"""The scales of an image, each half the size of the next."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
import torch.nn.functional as F


def scale_sizes(size: Sequence[int], coarsest: int) -> list[tuple[tuple[int, int], float]]:
    """Height and width of each scale [px], and how many times smaller it is than the image.

    The coarsest comes first, the image itself last.

    Args:
        size: Height and width of the image [px].
        coarsest: Least side of the coarsest scale [px], unless the image is smaller.
    """
    count = 1 + int(np.log2(max(min(size) / coarsest, 1.0)))
    shrinks = [2.0**power for power in reversed(range(count))]
    return [((max(round(size[0] / s), 1), max(round(size[1] / s), 1)), s) for s in shrinks]


def shrunk(
    image: torch.Tensor, usable: torch.Tensor, size: tuple[int, int]
) -> tuple[torch.Tensor, torch.Tensor]:
    """Area means of the usable pixels.

    Args:
        image: shape (H, W, c).
        usable: shape (H, W), bool.
        size: New height and width [px].

    Returns:
        Image, shape (h, w, c), zero where nothing is usable; and the usable share, shape (h, w).
    """
    if size == tuple(usable.shape):
        return torch.where(usable[..., None], image, 0.0), usable.float()
    weights = usable.float()[None, None]
    share = F.interpolate(weights, size, mode="area")
    means = F.interpolate(image.movedim(-1, 0)[None] * weights, size, mode="area")
    means = means / share.clamp(min=1e-6)
    return means[0].movedim(0, -1).contiguous(), share[0, 0]


RIM = 2
"""Width of the known rim from which colours go on [px]: one pixel alone is more texture than tone."""

SAME_CONTROL = 0.15
"""Deviation within which controls are of one surface [1]: a depth that differs by about an eighth."""


def continued(image: torch.Tensor, usable: torch.Tensor, controls: torch.Tensor) -> torch.Tensor:
    """The known colours at the rim going on smoothly into what is not usable, along each surface.

    A mean over the rim with weights 1 / r^2: along a straight rim, that is the harmonic continuation
    (Poisson's kernel). What differs in controls counts less.

    Args:
        image: shape (H, W, c).
        usable: Where colours are known, shape (H, W), bool; not empty.
        controls: Of all pixels, shape (H, W, d).

    Returns:
        shape (H, W, c); usable pixels as they are.
    """
    near = F.max_pool2d((~usable)[None, None].float(), 2 * RIM + 1, 1, RIM)[0, 0] > 0.0
    rim, missing = (near & usable).nonzero(), (~usable).nonzero()
    if len(rim) == 0 or len(missing) == 0:
        return image
    (y, x), (rim_y, rim_x) = missing.T, rim.T
    score = -torch.log(torch.cdist(missing.float(), rim.float()).square())
    apart = torch.cdist(controls[y, x].float(), controls[rim_y, rim_x].float())
    score -= 0.5 * (apart / SAME_CONTROL).square()
    result = image.clone()
    result[y, x] = torch.softmax(score, 1) @ image[rim_y, rim_x]
    return result


def enlarged(image: torch.Tensor, size: Sequence[int]) -> torch.Tensor:
    """An image (h, w, c) at a larger size [px]."""
    if tuple(image.shape[:2]) == tuple(size):
        return image
    planes = F.interpolate(image.movedim(-1, 0)[None], tuple(size), mode="bicubic", align_corners=False)
    return planes[0].movedim(0, -1).contiguous()
