"""Classifier-free guidance: away from the negative prompt, towards the positive one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any, Literal

import torch

from diga3d_warp.priors.protocol import Conditioning, Control, DiffusionPrior, Prompts

GUIDANCE = 7.5
"""Guidance scale (paper, appendix)."""

Half = Literal["negative", "positive"]


@dataclass(frozen=True)
class Guidance:
    """What an image shall show, and how strongly.

    Attributes:
        prompts: Tp and Tn, from `DiffusionPrior.encode_prompts`.
        scale: Guidance scale [1]; at 1 the negative prompt does nothing and costs nothing.
        image_embeds: The image that the result should look like, from `DiffusionPrior.embed_images`. Only the
            positive half sees it, so that guidance also pulls towards it.
    """

    prompts: Prompts
    scale: float = GUIDANCE
    image_embeds: Any = None


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
        prior: What estimates.
        z: Noisy latents, shape (B, C, h, w).
        t: Timestep.
        guidance: Prompts and scale.
        cond: Known part, B rows.
        controls: Images to follow, B rows each.
        within: Context that each half is estimated in: `AttentionBank.writing`, `AttentionBank.reading`.

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
