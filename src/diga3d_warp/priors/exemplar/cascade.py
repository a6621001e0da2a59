"""Fill a hole from coarse to fine by deterministic DDIM steps, the denoiser looking at one scale at a time.

With noise of standard deviation s on a clean image x, a step from s to s' is x' = x0 + s' / s (x - x0), where
x0 is the denoiser's estimate (Song et al. 2021, Eq. 12, in units of the clean image).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import torch
import torch.nn.functional as F

from diga3d_warp.priors.exemplar.posterior import (
    Estimate,
    attend_all,
    attend_candidates,
    no_candidates,
    upsampled_candidates,
)
from diga3d_warp.priors.exemplar.query import QueryScale, query_at
from diga3d_warp.priors.exemplar.scales import enlarged, scale_sizes
from diga3d_warp.priors.exemplar.settings import FILL, PATCHES, FillSettings, PatchSettings
from diga3d_warp.priors.exemplar.source import Source, SourceScale


@dataclass(frozen=True, eq=False)
class Scale:
    """One scale of a fill: what is sought, and the patches to draw from."""

    query: QueryScale
    source: SourceScale


@dataclass(frozen=True, eq=False)
class State:
    """How far a fill has come: a scale, its image without noise, and each query's candidates."""

    scale: Scale
    estimate: Estimate


def scales_of(source: Source, patches: PatchSettings = PATCHES, settings: FillSettings = FILL) -> list[Scale]:
    """The scales at which a source can fill its own unusable part, the coarsest first; may be none."""
    scales = []
    for size, shrink in scale_sizes(source.usable.shape, settings.coarsest):
        query, keys = query_at(source, size, shrink, patches), source.at(size, patches)
        if shrink >= settings.compared:
            query = replace(query, smooth=settings.smooth)
        if query.missing.any() and keys.count >= settings.keys_min:
            scales.append(Scale(query, keys))
    return scales


def start(scale: Scale, seed: int, settings: FillSettings = FILL) -> State:
    """Fill the coarsest scale from noise."""
    query = scale.query
    mean = query.known[~query.missing].mean(0).expand_as(query.known)
    return _denoise(scale, mean, no_candidates(query), settings.levels(first=True), seed, settings)


def refine(state: State, scale: Scale, seed: int, settings: FillSettings = FILL) -> State:
    """Fill a finer scale from the fill of a coarser one."""
    query, coarse = scale.query, state.scale
    image = enlarged(state.estimate.image, query.size)
    candidates = upsampled_candidates(
        state.estimate.candidates, coarse.query, query, coarse.source.size, scale.source.size
    )
    return _denoise(scale, image, candidates, settings.levels(), seed, settings)


def _denoise(
    scale: Scale,
    image: torch.Tensor,
    candidates: torch.Tensor,
    levels: Sequence[float],
    seed: int,
    settings: FillSettings,
) -> State:
    """Add the first level's noise to an image where it is missing, and take it away level by level."""
    query, source = scale.query, scale.source
    random = torch.Generator().manual_seed(seed)
    noise = torch.randn(image.shape, generator=random).to(image.device)
    noisy = query.pasted(image + levels[0] * noise)
    pairs = len(query.pixels) * source.count
    repeats: torch.Tensor | None = None
    for level, following in pairwise([*levels, 0.0]):
        if pairs <= settings.everything:
            estimate = attend_all(query, source, noisy, level)
        else:
            draws = int(torch.randint(2**31 - 1, (), generator=random))
            estimate = attend_candidates(query, source, noisy, level, candidates, seed=draws, scale=repeats)
            candidates = estimate.candidates
            repeats = _repeats(candidates, source, settings)
        noisy = query.pasted(torch.lerp(estimate.image, noisy, following / level))
    return State(scale, estimate)


def _repeats(candidates: torch.Tensor, source: SourceScale, settings: FillSettings) -> torch.Tensor:
    """Factor on distances that grows with how often patches around one are taken, shape (h, w)."""
    taken = candidates[:, 0][candidates[:, 0] >= 0].long()
    count = torch.bincount(taken, minlength=source.centers.numel()).float().view(1, 1, *source.size)
    around = F.avg_pool2d(count, 5, 1, 2)[0, 0]
    return 1.0 + settings.repeat * (around - settings.repeat_free).clamp(min=0.0)
