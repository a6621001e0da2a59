"""DDIM inversion: the noise from which sampling returns to an image (paper Sec. 3.3)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch

from diga3d_warp.priors.conditioning import Conditioning, Control
from diga3d_warp.priors.protocol import DiffusionPrior


@torch.no_grad()
def invert(
    prior: DiffusionPrior,
    z: torch.Tensor,
    text: Any,
    cond: Conditioning | None = None,
    controls: Sequence[Control] = (),
    *,
    steps: int,
    strength: float = 1.0,
    fixed_point: bool = True,
) -> torch.Tensor:
    """Run DDIM backwards, from clean latents to noise, without guidance.

    A step up needs the noise estimate at its end, which is not yet known. The plain inversion (Song et al.
    2021) takes the estimate for the latents at its start; one fixed-point iteration repeats the step with the
    estimate for the latents that it led to, and costs as much again.

    Args:
        prior: The diffusion prior.
        z: Clean latents, shape (B, C, h, w).
        text: `Prompts.positive` or `Prompts.negative` of a prompt for the image as it is, before the edit.
        cond: Known part, B rows.
        controls: Control images, B rows each; as in the sampling that follows.
        steps: DDIM steps; must equal those of the sampling that follows.
        strength: Part of the schedule up to pure noise [1]; as in the sampling that follows.
        fixed_point: Whether to iterate once.

    Returns:
        Latents at the first timestep of that sampling, shape (B, C, h, w).
    """
    t: int | None = None
    for to in reversed(prior.schedule.timesteps(steps, strength)):
        there = prior.schedule.step(z, prior.predict_noise(z, to, text, cond, controls), t, to)
        if fixed_point:
            noise = prior.predict_noise(there, to, text, cond, controls)
            there = prior.schedule.step(z, noise, t, to)
        z, t = there, to
    return z
