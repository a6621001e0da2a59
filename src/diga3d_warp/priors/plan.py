"""Estimate of the time and memory of a sampling, measured on one view before it starts."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from diga3d_warp.priors.attention import AttentionBank
from diga3d_warp.priors.conditioning import Control, Guidance
from diga3d_warp.priors.protocol import DiffusionPrior
from diga3d_warp.priors.sampling import ViewLatents
from diga3d_warp.priors.settings import SamplingSettings


@dataclass(frozen=True)
class SamplingPlan:
    """Time and memory of `sample_views`.

    Attributes:
        views: Number of views N, references among them.
        references: Number K of references.
        steps: Timesteps.
        halves: Noise estimates for each view and timestep: 2 with guidance, 1 without.
        own_seconds: One estimate of one view with its own attention [s].
        reading_seconds: One estimate of one view that also attends to the references [s].
        bank_bytes: Keys and values of all references at one timestep. Independent of N.
        device_bytes: Most memory in use during one estimate of one view, weights and bank included; None
            where it cannot be measured (CPU).
        host_bytes: Latents, conditions and controls of all views.
    """

    views: int
    references: int
    steps: int
    halves: int
    own_seconds: float
    reading_seconds: float
    bank_bytes: int
    device_bytes: int | None
    host_bytes: int

    @property
    def attention_ratio(self) -> float:
        """How many times longer an estimate takes with propagation than without."""
        return self.reading_seconds / self.own_seconds

    @property
    def seconds(self) -> float:
        """Time of the whole sampling, views taken one by one [s]; batches are faster on a GPU."""
        once = self.references * self.own_seconds + (self.views - self.references) * self.reading_seconds
        return self.steps * self.halves * once

    def __str__(self) -> str:
        estimates = self.views * self.steps * self.halves
        device = "" if self.device_bytes is None else f", device at its peak {_gib(self.device_bytes)}"
        return (
            f"{self.views} views, {self.references} of them references, {self.steps} steps: "
            f"{estimates} noise estimates in about {_duration(self.seconds)} "
            f"(attention to the references: x{self.attention_ratio:.2f}); "
            f"keys of the references {_gib(self.bank_bytes)}{device}, "
            f"views on the host {_gib(self.host_bytes)}"
        )


@torch.no_grad()
def plan_sampling(
    prior: DiffusionPrior,
    views: ViewLatents,
    guidance: Guidance,
    settings: SamplingSettings,
    references: Sequence[int] = (),
) -> SamplingPlan:
    """Measure one view with its own attention, and one that reads K references.

    Takes K + 5 noise estimates, a small part of any sampling that is worth planning for.
    """
    count = len(references)
    bank = AttentionBank(settings.afp_weight, settings.afp_joined)
    timesteps = prior.schedule.timesteps(settings.steps, settings.strength)
    z = views.start[:1].to(prior.device)
    cond = views.cond.rows([0], prior.device)
    controls: list[Control] = [control.rows([0], prior.device) for control in views.controls]
    on_cuda = prior.device.type == "cuda"

    def estimate() -> float:
        start = time.perf_counter()
        prior.predict_noise(z, timesteps[0], guidance.prompts.positive, cond, controls, guidance.image_embeds)
        if on_cuda:
            torch.cuda.synchronize(prior.device)
        return time.perf_counter() - start

    if on_cuda:
        torch.cuda.reset_peak_memory_stats(prior.device)
    prior.install_attention(bank)
    try:
        estimate()  # the first allocates, and compiles what has to be compiled
        own = reading = min(estimate(), estimate())
        for _ in range(count):
            with bank.writing():
                estimate()
        if count:
            with bank.reading():
                reading = min(estimate(), estimate())
    finally:
        prior.install_attention(None)
    halves = 1 if guidance.scale == 1.0 else 2
    kept = [views.start, views.cond.latent, views.cond.mask, *(control.image for control in views.controls)]
    kept += [part for part in (views.cond.channels, views.noise) if part is not None]
    return SamplingPlan(
        views=len(views),
        references=count,
        steps=len(timesteps),
        halves=halves,
        own_seconds=own,
        reading_seconds=reading,
        bank_bytes=bank.size * halves,
        device_bytes=torch.cuda.max_memory_allocated(prior.device) if on_cuda else None,
        host_bytes=sum(part.nbytes for part in kept),
    )


def _gib(count: int) -> str:
    return f"{count / 2**30:.2f} GiB" if count >= 2**30 else f"{count / 2**20:.1f} MiB"


def _duration(seconds: float) -> str:
    return f"{seconds / 60:.0f} min" if seconds >= 120 else f"{seconds:.0f} s"
