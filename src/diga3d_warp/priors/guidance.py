"""Classifier-free guidance: away from the negative prompt, towards the positive one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Literal

import torch

from diga3d_warp.priors.conditioning import Conditioning, Control, Guidance
from diga3d_warp.priors.protocol import DiffusionPrior

Half = Literal["negative", "positive"]


def guided_noise(
    prior: DiffusionPrior,
    z: torch.Tensor,
    t: int,
    guidance: Guidance,
    cond: Conditioning | None = None,
    controls: Sequence[Control] = (),
    within: Callable[[Half], AbstractContextManager[object]] = nullcontext,
) -> torch.Tensor:
    """Noise estimate under guidance: negative + scale (positive - negative).

    Ho and Salimans 2022, "Classifier-free diffusion guidance", with the negative prompt in place of none.

    Args:
        prior: The diffusion prior.
        z: Noisy latents, shape (B, C, h, w).
        t: Timestep.
        guidance: Prompts and scale.
        cond: Known part, B rows.
        controls: Control images, B rows each.
        within: Context manager around the estimate of each half: `AttentionBank.writing` or `.reading`.

    Returns:
        Noise, shape (B, C, h, w).
    """
    with within("positive"):
        positive = prior.predict_noise(z, t, guidance.prompts.positive, cond, controls, guidance.image_embeds)
    if guidance.scale == 1.0:
        return positive
    with within("negative"):
        negative = prior.predict_noise(z, t, guidance.prompts.negative, cond, controls)
    return negative + guidance.scale * (positive - negative)
