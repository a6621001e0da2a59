"""Texture maps: the edges that a ControlNet follows (paper Sec. 3.4)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from diga3d_warp.files import to_bytes
from diga3d_warp.perception.resampling import resize_images, resize_masks

CANNY_LOW, CANNY_HIGH = 100.0, 200.0
"""Hysteresis thresholds on the gradient of 8-bit brightness; those of ControlNet's annotator."""

RIM = 3
"""Edges nearer than this to a pixel without colour are left out [px]: Canny's smoothing and gradient together
see 2 px far, and a warped image would be outlined where it ends."""


def canny_edges(
    image: torch.Tensor, valid: torch.Tensor | None = None, size: Sequence[int] | None = None
) -> torch.Tensor:
    """Canny's edges of an image, found at the size at which they are wanted.

    Resizing the edges instead would blur thin lines to grey, or break them. Enlarging an image s times makes
    its slopes s times less steep, so the thresholds fall as much: an enlarged image keeps its edges.

    Args:
        image: RGB in [0, 1], shape (H, W, 3).
        valid: False where a warped image has no colour, shape (H, W), bool; everywhere valid if None.
        size: Height and width of the result [px]; those of the image if None.

    Returns:
        1 on edges, 0 elsewhere, shape (*size), float32, on the image's device.
    """
    import cv2

    size = tuple(image.shape[:2] if size is None else size)
    enlarged = max(1.0, min(new / old for new, old in zip(size, image.shape[:2], strict=True)))
    brightness = cv2.cvtColor(to_bytes(resize_images(image[None], size)[0]), cv2.COLOR_RGB2GRAY)
    edges = cv2.Canny(brightness, CANNY_LOW / enlarged, CANNY_HIGH / enlarged) > 0
    if valid is not None:
        side = 2 * RIM + 1
        gone = resize_masks(~valid[None], size)[0].cpu().numpy().astype(np.uint8)
        edges &= cv2.dilate(gone, np.ones((side, side), np.uint8)) == 0
    return torch.from_numpy(edges.astype(np.float32)).to(image.device)
