"""Fill a hole: proposals at a low resolution, the best of them refined."""

from __future__ import annotations

import torch

from diga3d_warp.priors.exemplar.cascade import refine, scales_of
from diga3d_warp.priors.exemplar.proposals import best_proposal
from diga3d_warp.priors.exemplar.settings import FILL, PATCHES, FillSettings, PatchSettings
from diga3d_warp.priors.exemplar.source import Source


def fill_missing(
    source: Source, seed: int, patches: PatchSettings = PATCHES, settings: FillSettings = FILL
) -> torch.Tensor | None:
    """Fill the unusable part of a source from the rest of it.

    Args:
        source: Image with a hole.
        seed: Same source and seed: same bytes on one device.
        patches, settings: Costs of patches, and scales and noise levels of the fill.

    Returns:
        The filled image, about in [-1, 1], shape (H, W, 3); None if the source has hardly a whole patch.
    """
    scales = scales_of(source, patches, settings)
    if not scales or scales[-1].query.size != tuple(source.usable.shape):
        return None
    coarse = [scale for scale in scales if scale.query.shrink >= settings.compared] or scales[:1]
    state = best_proposal(coarse, seed, settings)
    for scale in scales[len(coarse) :]:
        state = refine(state, scale, seed, settings)
    return state.estimate.image
