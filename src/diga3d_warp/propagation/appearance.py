"""Inpaint the other views while they attend to the references (AFP, paper Sec. 3.3).

The references are inpainted already: at each timestep they only provide the keys and values of their fill.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
import torch

from diga3d_warp.priors.classical import telea_fill
from diga3d_warp.priors.protocol import DiffusionPrior
from diga3d_warp.priors.settings import SamplingSettings
from diga3d_warp.priors.views import inpaint_views
from diga3d_warp.priors.windows import Windows
from diga3d_warp.propagation.depth import complete_depth
from diga3d_warp.propagation.fill import Fill
from diga3d_warp.propagation.references import References
from diga3d_warp.propagation.unseen import Background


def propagate_appearance(
    prior: DiffusionPrior,
    fills: Sequence[Fill],
    backgrounds: Sequence[Background],
    depths: Sequence[np.ndarray],
    references: References,
    sampling: SamplingSettings,
    *,
    attend: bool = True,
    inversion: Literal["none", "photograph", "fill"] = "none",
    seed: int = 0,
    say: Callable[[str], None] | None = None,
    progress: Callable[[int], None] | None = None,
) -> list[Fill]:
    """Inpaint the hole of every view but the references anew, within windows around the holes.

    Args:
        prior: The diffusion prior, with its prompts.
        fills: Fills of all views, from `fill.warp_fills`: their depth is kept and, below full strength,
            sampling starts from their images.
        backgrounds: What is known behind the object, one per view.
        depths: z of the splat without the object, one per view, shape (H, W); 0 where it shows nothing.
        references: Which views the others attend to.
        sampling: Steps, strength, batch size and weight of propagation.
        attend: Whether the views attend to the references.
        inversion: Whether sampling starts from the DDIM inversion of the photographs with their object, of
            the warped fills, or of nothing: then from noise.
        seed: Seed of the noise.
        say, progress: As in `priors.views.inpaint_views`.

    Returns:
        One fill a view. Its depth is the warped one, continued where no reference's fill reached; those
        pixels count as `invented`.
    """
    found = list(fills)
    fixed = set(references.indices)
    # A view of nothing else has nothing to start from: it keeps the warped fill.
    open_views = [at.unseen.any() and not at.unseen.all() for at in backgrounds]
    others = [i for i, shows in enumerate(open_views) if i not in fixed and shows]
    if not others:
        return found
    # What a reference without a hole shows, no reference filled.
    read = [i for i in references.indices if attend and open_views[i]]
    rows = [*read, *others]
    masks = [torch.from_numpy(backgrounds[i].unseen) for i in rows]
    init_images = [_init_image(fills[i]) for i in rows]
    # Within its mask an image still shows the object: what to go away from, for a prior that wants to see it.
    images = [
        init_images[k] if i in fixed else torch.from_numpy(backgrounds[i].image) for k, i in enumerate(rows)
    ]
    # The photographs hold the object, and the fills none: in either case the empty prompt describes them.
    source = None if inversion == "none" else prior.encode_prompts("", "", "remove").negative
    begun = images if inversion == "photograph" else init_images
    windows = Windows.around(masks, prior)
    parts = inpaint_views(
        prior, windows.cut(images), windows.cut(masks), prior.guidance, sampling,
        references=range(len(read)), inpainted=True, init_images=windows.cut(begun), source=source,
        seed=seed, say=say, progress=progress,
    )  # fmt: skip
    for i, image in zip(rows, windows.put_back(images, list(parts)), strict=True):
        if i not in fixed:
            found[i] = _with_image(fills[i], image.numpy(), backgrounds[i].unseen, depths[i])
    return found


def _init_image(fill: Fill) -> torch.Tensor:
    """A view with something in every pixel, (H, W, 3): where no fill arrived its image shows the object."""
    image = torch.from_numpy(fill.image)
    return telea_fill(image, torch.from_numpy(fill.missing)) if fill.missing.any() else image


def _with_image(fill: Fill, image: np.ndarray, unseen: np.ndarray, behind: np.ndarray) -> Fill:
    surface = complete_depth(np.where(fill.filled, fill.depth, behind), fill.missing)
    depth = np.where(unseen, surface, 0.0).astype(np.float32)
    nothing = np.zeros_like(unseen)
    return replace(fill, image=image, depth=depth, filled=unseen, invented=fill.missing, missing=nothing)
