"""Several fills at a low resolution, and which of them to go on with."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import torch
import torch.nn.functional as F

from diga3d_warp.priors.exemplar.cascade import Scale, State, refine, start
from diga3d_warp.priors.exemplar.posterior import unfolded
from diga3d_warp.priors.exemplar.query import padded
from diga3d_warp.priors.exemplar.settings import FILL, FillSettings

EVERY = 4
"""Of the source's patches near the hole, one in so many is asked: they overlap by six sevenths."""


def best_proposal(scales: Sequence[Scale], seed: int, settings: FillSettings = FILL) -> State:
    """The proposal of least energy.

    Args:
        scales: From the coarsest to the one at which proposals are compared.
        seed: Of the first proposal.
        settings: Scales and noise levels of the fill.
    """
    return min(_proposals(scales, seed, settings), key=lambda state: energy(state, settings))


def _proposals(scales: Sequence[Scale], seed: int, settings: FillSettings) -> Iterator[State]:
    """Fills from noise, each with a seed of its own."""
    random = torch.Generator().manual_seed(seed)
    for _ in range(settings.seeds):
        own = int(torch.randint(2**31 - 1, (), generator=random))
        state = start(scales[0], own, settings)
        for scale in scales[1:]:
            state = refine(state, scale, own, settings)
        yield state


def energy(state: State, settings: FillSettings = FILL) -> float:
    """How badly a fill and its surroundings go together, as a mean square difference of colours.

    The sum of two parts (bidirectional similarity, Simakov et al. 2008). Each patch of the fill, those across
    its seam among them, wants a like one in the source, near and at its depth. Each patch of the source near
    the hole wants a like one in the fill: without that, a smooth fill is always the best.
    """
    query, source = state.scale.query, state.scale.source
    coherence = state.estimate.distances[:, 0].mean() / query.unit(settings.noise_last)
    patches = unfolded(padded(state.estimate.image, query.settings.radius), query.settings.side)
    reach = max(int(float(query.missing.sum()) ** 0.5) // 2, query.settings.side)
    missing = query.missing[None, None].float()
    near = F.max_pool2d(missing, 2 * reach + 1, 1, reach)[0, 0] > 0.0
    wanting = (near & source.centers).reshape(-1).nonzero()[::EVERY, 0]
    if len(wanting) == 0:
        return float(coherence)
    distances = torch.cdist(patches[wanting], patches[query.pixels.long()])
    completeness = distances.min(1).values.square().mean() / patches.shape[1]
    return float(coherence + completeness)
