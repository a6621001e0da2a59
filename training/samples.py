"""What a network is shown of a window: flipped, as blurred as a small capture, in [0, 1]."""

from __future__ import annotations

import numpy as np
import torch
from numpy.random import Generator

from diga3d_warp.perception.resampling import resize_images
from training.recipe import SampleRecipe


def as_seen(rng: Generator, image: np.ndarray, recipe: SampleRecipe) -> tuple[torch.Tensor, bool]:
    """An image as a capture may show it.

    Args:
        rng: Picks.
        image: RGB, shape (H, W, 3), uint8.
        recipe: Shares and sizes.

    Returns:
        RGB in [0, 1], shape (H, W, 3), float32, and whether it is mirrored.
    """
    mirrored = bool(rng.random() < 0.5)
    seen = torch.from_numpy(image[:, ::-1].copy() if mirrored else image.copy()).float() / 255
    if rng.random() < recipe.blurred:
        side = image.shape[0]
        small = round(side / rng.uniform(1.0, recipe.enlarged))
        seen = resize_images(resize_images(seen[None], (small, small)), (side, side))[0].clamp(0, 1)
    return seen, mirrored


def grown(mask: torch.Tensor, pixels: int) -> torch.Tensor:
    """A mask that reaches some pixels further, shape (H, W), bool."""
    import cv2

    square = np.ones((2 * pixels + 1,) * 2, np.uint8)
    return torch.from_numpy(cv2.dilate(mask.numpy().astype(np.uint8), square) > 0)


def free_form(rng: Generator, side: int) -> torch.Tensor:
    """Some ellipses and a stroke, covering 5 to 40 % of a square, shape (side, side), bool."""
    y, x = np.mgrid[:side, :side] / side
    mask = np.zeros((side, side), bool)
    for _ in range(int(rng.integers(1, 4))):
        middle, axes = rng.uniform(0.2, 0.8, 2), rng.uniform(0.08, 0.25, 2)
        turn = rng.uniform(0, np.pi)
        u = (x - middle[0]) * np.cos(turn) + (y - middle[1]) * np.sin(turn)
        v = (y - middle[1]) * np.cos(turn) - (x - middle[0]) * np.sin(turn)
        mask |= (u / axes[0]) ** 2 + (v / axes[1]) ** 2 < 1
    if rng.random() < 0.5:
        place, heading = rng.uniform(0.2, 0.8, 2), rng.uniform(0, 2 * np.pi)
        width = rng.uniform(0.03, 0.08)
        for _ in range(int(rng.integers(8, 20))):
            mask |= (x - place[0]) ** 2 + (y - place[1]) ** 2 < width**2
            heading += rng.normal(0, 0.5)
            place = np.clip(place + 0.8 * width * np.array([np.cos(heading), np.sin(heading)]), 0.05, 0.95)
    return torch.from_numpy(mask)
