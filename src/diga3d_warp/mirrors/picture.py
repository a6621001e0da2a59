"""A picture of a mirror image: a photograph, what a mirror would show, and what is taken for it."""

from __future__ import annotations

import numpy as np

from diga3d_warp.materials.painting import GAMMA
from diga3d_warp.mirrors.reflection import Reflection

TINT = (1.0, 0.2, 0.6)
"""Colour of what is taken for the mirror image."""


def mirror_picture(photograph: np.ndarray, image: Reflection, mask: np.ndarray) -> np.ndarray:
    """The three side by side, RGB in [0, 1], shape (H, 3 W + gaps, 3), float32.

    Args:
        photograph: Shape (H, W, 3), uint8.
        image: The mirrored object in it.
        mask: What is taken for the mirror image, shape (H, W), bool.
    """
    plain = photograph / np.float32(255.0)
    mirrored = np.clip(image.color, 0.0, 1.0) ** (1.0 / GAMMA)
    marked = np.where(mask[..., None], 0.5 * plain + 0.5 * np.array(TINT), plain)
    gap = np.ones((photograph.shape[0], 4, 3))
    return np.concatenate([plain, gap, mirrored, gap, marked], axis=1).astype(np.float32)
