"""The denoiser for a whole image at any noise level: from coarse scales down to the one that noise leaves.

Shrunk s times, an image's noise falls by s, while its shapes stay. So at a noise level the coarsest scale is
the clearest; each finer one searches around the candidates of the coarser one, and the finest at which
patches can still be distinguished gives the estimate. Finer detail is noise, and is left out of the mean.
"""

from __future__ import annotations

from dataclasses import replace

import torch

from diga3d_warp.priors.exemplar.posterior import (
    Estimate,
    attend_all,
    attend_candidates,
    no_candidates,
    upsampled_candidates,
)
from diga3d_warp.priors.exemplar.query import QueryScale, query_at
from diga3d_warp.priors.exemplar.scales import enlarged, scale_sizes, shrunk
from diga3d_warp.priors.exemplar.settings import FILL, PATCHES, FillSettings, PatchSettings
from diga3d_warp.priors.exemplar.source import Source, SourceScale

SEARCH_STEPS = 2
"""Steps of the search at each scale. A second one spreads what the first has found to its neighbours."""


@torch.no_grad()
def posterior_mean(
    noisy: torch.Tensor,
    noise: float,
    known: Source,
    source: Source,
    patches: PatchSettings = PATCHES,
    settings: FillSettings = FILL,
    shift: tuple[float, float] = (0.0, 0.0),
) -> torch.Tensor:
    """What a noisy image most likely was, given that its patches come from a source.

    The same arguments give the same bytes on one device: between calls, sources keep what was made of them
    alone, which holds at any noise, and nothing else.

    Args:
        noisy: The image plus noise, shape (H, W, 3).
        noise: Standard deviation of the noise [1].
        known: The clean image where it is usable; the rest is sought.
        source: Where patches come from. One from another camera may have another size; its controls are
            as many as those of `known`.
        patches, settings: Costs of patches, and scales and noise levels of the fill.
        shift: Displacement from a pixel to where a placed source shows the same, across and down [px].

    Returns:
        Shape (H, W, 3); known pixels as they are. Where the source has hardly a whole patch at any scale, the
        mean of the source.

    Raises:
        ValueError: something is sought, and the source has no usable pixel.
    """
    missing, image = ~known.usable, known.image
    if not bool(missing.any()):
        return image
    if not bool(source.usable.any()):
        raise ValueError("a source must have a usable pixel")
    previous: tuple[QueryScale, SourceScale, Estimate] | None = None
    for size, shrink in scale_sizes(missing.shape, settings.coarsest):
        if previous is not None and noise / shrink > settings.noise_next:
            break
        here = query_at(known, size, shrink, patches)
        ratio = size[0] / missing.shape[0], size[1] / missing.shape[1]
        there = tuple(max(round(n * r), 1) for n, r in zip(source.usable.shape, ratio, strict=True))
        keys = replace(
            source.at((there[0], there[1]), patches), shift=(shift[0] * ratio[1], shift[1] * ratio[0])
        )
        if keys.count < settings.keys_min or not here.missing.any():
            continue
        seen, _ = shrunk(noisy, missing, size)
        clear = here.pasted(seen)
        if len(here.pixels) * keys.count <= settings.everything:
            estimate = attend_all(here, keys, clear, noise / shrink)
        else:
            candidates = no_candidates(here)
            if previous is not None:
                before, before_keys, found = previous
                candidates = upsampled_candidates(found.candidates, before, here, before_keys.size, keys.size)
            estimate = attend_candidates(
                here, keys, clear, noise / shrink, candidates, seed=len(here.pixels), steps=SEARCH_STEPS
            )
        previous = here, keys, estimate
    if previous is None:
        mean = source.image[source.usable].mean(0).expand_as(image)
    else:
        mean = enlarged(previous[2].image, missing.shape)
    return torch.where(missing[..., None], mean, image)
