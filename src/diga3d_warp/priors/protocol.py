"""What the pipelines ask of a prior: fill the masked part of one image."""

from __future__ import annotations

from typing import Protocol

import torch

from diga3d_warp.errors import InputError


class Prior(Protocol):
    """Knowledge of what images look like, used to invent what no photograph shows.

    `fill` is all that the classical prior has. Diffusion priors also offer noise estimates, for attention
    propagation and score distillation; a pipeline that needs them asks for them, not for a class.
    """

    @property
    def name(self) -> str:
        """Name on the command line."""
        ...

    def fill(self, image: torch.Tensor, mask: torch.Tensor, *, seed: int = 0) -> torch.Tensor:
        """Invent the masked pixels so that they continue the others.

        Args:
            image: RGB in [0, 1], shape (H, W, 3), float32. Masked pixels are not looked at.
            mask: True where to fill, shape (H, W), bool. May be empty.
            seed: Same image, mask and seed: same bytes.

        Returns:
            Filled image, shape (H, W, 3), float32 in [0, 1]; unmasked pixels are exactly those of `image`.

        Raises:
            InputError: the mask covers everything, or the shapes do not fit.
        """
        ...


def check_fill(image: torch.Tensor, mask: torch.Tensor) -> None:
    """Refuse what no prior can fill.

    Raises:
        InputError: the mask covers everything, or the shapes do not fit.
    """
    if image.ndim != 3 or image.shape[2] != 3 or mask.shape != image.shape[:2]:
        raise InputError(
            f"image {tuple(image.shape)} and mask {tuple(mask.shape)} do not fit: give (H, W, 3) and (H, W)"
        )
    if bool(mask.all()):
        raise InputError(
            "the mask covers the whole image, which leaves nothing to continue from: give a smaller mask"
        )
