"""DDIM sampling of many views at once, with attention propagation from the reference views.

The timestep is the outermost loop: at each, the references write their keys and values, the other views read
them in mini-batches, and the bank is emptied. So the bank holds one timestep of K references, however many
views there are; latents and conditions of the views stay on the host. Where the prior is on several devices,
each takes mini-batches of its own and reads a copy of the bank.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace

import torch

from diga3d_warp.errors import InputError
from diga3d_warp.priors.attention import AttentionBank
from diga3d_warp.priors.conditioning import Conditioning, Control, Guidance
from diga3d_warp.priors.guidance import Half, guided_noise
from diga3d_warp.priors.protocol import DiffusionPrior, Replicated
from diga3d_warp.priors.settings import SamplingSettings


@dataclass(frozen=True)
class ViewLatents:
    """Latents and conditions of N views, on the host; sampling moves a few at a time to the prior's device.

    Attributes:
        start: Latents to start from, noise or inverted images, shape (N, C, h, w).
        cond: Known parts, N rows.
        controls: Control images, N rows each.
        noise: Noise of the known part, for a prior that is not `mask_aware`; `start` if None.
        inpainted: The references are inpainted already: they end as they are, and each timestep starts from
            their clean latents, unless `SamplingSettings.resampled`.
    """

    start: torch.Tensor
    cond: Conditioning
    controls: tuple[Control, ...] = ()
    noise: torch.Tensor | None = None
    inpainted: bool = False

    def __len__(self) -> int:
        return len(self.start)


def initial_noise(shape: Sequence[int], seed: int) -> torch.Tensor:
    """Standard normal noise of one view, the same on every device, shape as asked, float32 on the host."""
    return torch.randn(tuple(shape), generator=torch.Generator().manual_seed(seed))


@torch.no_grad()
def sample_views(
    prior: DiffusionPrior,
    views: ViewLatents,
    guidance: Guidance,
    settings: SamplingSettings | None = None,
    *,
    references: Sequence[int] = (),
    progress: Callable[[int], None] | None = None,
) -> torch.Tensor:
    """Denoise all views; all but the references attend to the references.

    Args:
        prior: The diffusion prior.
        views: Start latents and conditions of each view.
        guidance: Prompts and guidance scale, for all views.
        settings: Steps, strength, batch size and weight of propagation.
        references: Indices of the reference views; without any, each view is sampled for itself.
        progress: Called after each timestep with the number of finished timesteps.

    Returns:
        Clean latents, shape (N, C, h, w), on the host.

    Raises:
        InputError: a reference that is not among the views, or is named twice.
    """
    settings = settings or SamplingSettings()
    if len(set(references)) != len(references) or not all(0 <= r < len(views) for r in references):
        raise InputError(f"references {list(references)} are not distinct indices of {len(views)} views")
    team = [prior, *(prior.replicas if isinstance(prior, Replicated) else ())]
    banks = [AttentionBank(settings.afp_weight, settings.afp_joined) for _ in team]
    others = [index for index in range(len(views)) if index not in set(references)]
    z = views.start.clone()
    timesteps = prior.schedule.timesteps(settings.steps, settings.strength)
    inpainted = list(references) if views.inpainted else []
    clean, started = views.cond.latent[inpainted], views.start[inpainted]
    inpainted_noise = prior.schedule.noise_between(started, clean, timesteps[0])
    try:
        for member, bank in zip(team, banks, strict=True):
            member.install_attention(bank)
        for done, t in enumerate(timesteps, start=1):
            to = timesteps[done] if done < len(timesteps) else None
            if not settings.resampled:
                z[inpainted] = prior.schedule.add_noise(clean, inpainted_noise, t)
            fixed = views.inpainted and not settings.resampled
            for rows in _batches(references, settings.batch):
                z[rows] = _step(prior, views, z[rows], rows, t, to, guidance, banks[0].writing, fixed)
            for member, bank in zip(team[1:], banks[1:], strict=True):
                bank.copy(banks[0], member.device)
            _share(team, banks, views, z, others, t, to, guidance, settings.batch, bool(references))
            for bank in banks:
                bank.clear()
            if progress is not None:
                progress(done)
    finally:
        for member in team:
            member.install_attention(None)
    z[inpainted] = clean
    return z


def _batches(indices: Sequence[int], size: int) -> list[list[int]]:
    return [list(indices[first : first + size]) for first in range(0, len(indices), size)]


def _share(
    team: Sequence[DiffusionPrior],
    banks: Sequence[AttentionBank],
    views: ViewLatents,
    z: torch.Tensor,
    indices: Sequence[int],
    t: int,
    to: int | None,
    guidance: Guidance,
    size: int,
    attend: bool,
) -> None:
    """One denoising step of many views, in mini-batches that the devices of a team take in turn.

    A mini-batch is computed alike on every device of one kind, so results do not depend on who takes it.

    Args:
        team: The prior on each device.
        banks: The bank of each; they hold the references.
        views, z, t, to, guidance: As in `_step`; rows of `z` are written.
        indices: The views.
        size: Views of a mini-batch.
        attend: Whether the views read the banks.
    """
    waiting = deque(_batches(indices, size))

    @torch.no_grad()  # which is of each thread
    def work(member: DiffusionPrior, bank: AttentionBank) -> None:
        reading = bank.reading if attend else nullcontext
        while True:
            try:
                rows = waiting.popleft()
            except IndexError:
                return
            z[rows] = _step(member, views, z[rows], rows, t, to, guidance, reading, False)

    if len(team) == 1:
        work(team[0], banks[0])
        return
    with ThreadPoolExecutor(len(team), "sampling") as pool:
        for done in [pool.submit(work, member, bank) for member, bank in zip(team, banks, strict=True)]:
            done.result()


def _step(
    prior: DiffusionPrior,
    views: ViewLatents,
    z: torch.Tensor,
    rows: list[int],
    t: int,
    to: int | None,
    guidance: Guidance,
    within: Callable[[Half], AbstractContextManager[object]],
    inpainted: bool,
) -> torch.Tensor:
    """One denoising step of some views; takes and returns latents on the host."""
    cond = replace(views.cond.rows(rows, prior.device), inpainted=inpainted)
    controls = [control.rows(rows, prior.device) for control in views.controls]
    here = z.to(prior.device)
    noise = guided_noise(prior, here, t, guidance, cond, controls, within)
    there = prior.schedule.step(here, noise, t, to)
    if not prior.mask_aware:
        known_noise = (views.start if views.noise is None else views.noise)[rows].to(prior.device)
        # the stock pipeline ends with the clean known part, not with abar_0's touch of noise
        known = cond.latent if to is None else prior.schedule.add_noise(cond.latent, known_noise, to)
        there = torch.lerp(known, there, cond.mask)
    return there.to(z.device)
