"""Noise levels of a diffusion prior, and the deterministic DDIM step between two of them."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from diga3d_warp.errors import InputError


@dataclass(frozen=True)
class Schedule:
    """Noise levels: z_t = sqrt(abar_t) x + sqrt(1 - abar_t) noise.

    Attributes:
        alphas_cumprod: abar_t, falling, shape (T,), float64 on the CPU.
        final: abar at the end of sampling [1]. Stable Diffusion ends at abar_0, not at 1.
        offset: Added to each timestep. Stable Diffusion: 1.
    """

    alphas_cumprod: torch.Tensor
    final: float
    offset: int = 1

    @staticmethod
    def scaled_linear(start: float = 0.00085, end: float = 0.012, count: int = 1000) -> Schedule:
        """Stable Diffusion's levels: the roots of beta rise linearly."""
        betas = torch.linspace(start**0.5, end**0.5, count, dtype=torch.float64) ** 2
        alphas_cumprod = torch.cumprod(1.0 - betas, 0)
        return Schedule(alphas_cumprod, final=float(alphas_cumprod[0]))

    def __len__(self) -> int:
        return len(self.alphas_cumprod)

    def timesteps(self, steps: int, strength: float = 1.0) -> list[int]:
        """Timesteps of a sampling, falling, evenly spaced from `offset` up ("leading").

        Args:
            steps: Number of them from pure noise.
            strength: Share of them to take, from the clean end [1].

        Raises:
            InputError: fewer than one step, or more than there are timesteps.
        """
        taken = int(steps * strength)
        if not 1 <= steps <= len(self):
            raise InputError(f"{steps} diffusion steps are not between 1 and {len(self)}: 20 to 50 are usual")
        if not 1 <= taken <= steps:
            raise InputError(f"strength {strength} takes none or too many of {steps} steps: give up to 1")
        stride = len(self) // steps
        return [min(k * stride + self.offset, len(self) - 1) for k in reversed(range(taken))]

    def timestep(self, share: float) -> int:
        """The timestep at a share of the schedule, 0 the least noisy, 1 the noisiest."""
        return min(int(share * len(self)), len(self) - 1)

    def alpha(self, t: int | None) -> float:
        """abar at a timestep; None is the end of sampling."""
        return self.final if t is None else float(self.alphas_cumprod[t])

    def add_noise(self, x: torch.Tensor, noise: torch.Tensor, t: int | None) -> torch.Tensor:
        """Clean latents with as much noise as timestep `t` has."""
        alpha = self.alpha(t)
        return alpha**0.5 * x + (1.0 - alpha) ** 0.5 * noise

    def denoise(self, z: torch.Tensor, noise: torch.Tensor, t: int | None) -> torch.Tensor:
        """The clean latents that `z` at `t` holds if its noise is `noise`."""
        alpha = self.alpha(t)
        return (z - (1.0 - alpha) ** 0.5 * noise) / alpha**0.5

    def noise_between(self, z: torch.Tensor, x: torch.Tensor, t: int) -> torch.Tensor:
        """The noise that makes latents `z` at `t` of clean ones `x`."""
        alpha = self.alpha(t)
        return (z - alpha**0.5 * x) / (1.0 - alpha) ** 0.5

    def step(self, z: torch.Tensor, noise: torch.Tensor, t: int | None, to: int | None) -> torch.Tensor:
        """Deterministic DDIM step (eta = 0) from one timestep to another, up or down.

        Song et al. 2021, "Denoising diffusion implicit models", Eq. 12 with sigma = 0.

        Args:
            z: Latents at `t`.
            noise: Their noise, of the same shape.
            t: Timestep of `z`; None is the end of sampling.
            to: Timestep to go to.
        """
        return self.add_noise(self.denoise(z, noise, t), noise, to)
