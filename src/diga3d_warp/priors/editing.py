"""Edit the masked part of many views by a prompt (coarse stage, paper Sec. 3.3).

Sampling starts from the DDIM inversion of the views, unless noise is asked for, so that pose, shape and light
are kept. The references
are edited one after another, each attending to the earlier ones; then all other views attend to the
references. An edited reference is not sampled again: at each timestep it only provides its keys and values.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import torch

from diga3d_warp.errors import InputError
from diga3d_warp.priors.conditioning import Guidance
from diga3d_warp.priors.protocol import DiffusionPrior
from diga3d_warp.priors.settings import SamplingSettings
from diga3d_warp.priors.views import ViewControl, inpaint_views
from diga3d_warp.priors.windows import Windows


def edit_views(
    prior: DiffusionPrior,
    images: Sequence[torch.Tensor],
    masks: Sequence[torch.Tensor],
    guidance: Guidance,
    settings: SamplingSettings | None = None,
    *,
    references: Sequence[int],
    controls: Sequence[ViewControl] = (),
    inverted: bool = True,
    seed: int = 0,
    say: Callable[[str], None] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[torch.Tensor]:
    """Edit the masked part of N views, within windows around it.

    Args:
        prior: The diffusion prior.
        images: The views as they are, RGB in [0, 1], shape (H, W, 3) each.
        masks: True where to edit, shape (H, W), bool, one for each image. A view without a mask stays.
        guidance: Prompts for the masked part, and guidance scale.
        settings: Steps, strength, batch size and weight of propagation.
        references: Indices of the views that all others attend to, in their order; each has a mask.
        controls: Edges and depth that condition the sampling, for all views.
        inverted: Whether sampling starts from the DDIM inversion of the views; from noise if not.
        seed: Seed of that noise; inversion draws none.
        say: Called with a line on time and memory before each reference, and before the other views.
        progress: Called after each timestep with the number of finished timesteps and their total.

    Returns:
        The views in their order, shape (H, W, 3), float32 in [0, 1]; unmasked pixels are exactly those given.

    Raises:
        InputError: no view has a mask, or a reference has none.
    """
    settings = settings or SamplingSettings()
    windows = Windows.around(masks, prior)
    parts, holes = windows.cut(images), windows.cut(masks)
    followed = [replace(control, shown=windows.cut(control.shown)) for control in controls]
    unmasked = [index for index in references if index not in windows.views]
    if unmasked:
        raise InputError(f"references {unmasked} have no mask: choose them among the views that are edited")
    first = [windows.views.index(index) for index in references]
    others = [k for k in range(len(parts)) if k not in first]
    turns = [[k] for k in first] + ([others] if others else [])
    # The negative half of a removal without words: an image that shows some object.
    source = prior.encode_prompts("", "", "remove").negative if inverted else None
    steps = len(prior.schedule.timesteps(settings.steps, settings.strength))

    for done, turn in enumerate(turns):
        before = first[:done]
        rows = [*before, *turn]
        edited = inpaint_views(
            prior,
            [parts[k] for k in rows],
            [holes[k] for k in rows],
            guidance,
            settings,
            references=range(len(before)),
            inpainted=True,
            controls=[replace(c, shown=[c.shown[k] for k in rows]) for c in followed],
            source=source,
            seed=seed,
            say=say,
            progress=_counting(progress, done * steps, len(turns) * steps),
        )
        for k, part in list(zip(rows, edited, strict=True))[len(before) :]:
            parts[k] = part  # those before would be decoded once more, and drift
    return windows.put_back(images, parts)


def _counting(
    progress: Callable[[int, int], None] | None, before: int, total: int
) -> Callable[[int], None] | None:
    return None if progress is None else lambda done: progress(before + done, total)
