"""The fills that are compared."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import torch

from diga3d_warp.pipelines.method import WARPED, Method
from diga3d_warp.priors.classical import mean_color_fill, telea_fill

PerView = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]
"""Image (H, W, 3) in [0, 1] and mask (H, W), bool, to a filled image: each view alone, without a splat."""


@dataclass(frozen=True)
class Removal:
    """A removal by a prior.

    Attributes:
        prior: As `priors.named.load_prior` takes it.
        method: Options of the method.
        given: Views that are given as they truly are, as `--fill` takes them: "none", the "references", or
            "all" fitted views.
    """

    prior: str = "exemplar"
    method: Method = WARPED
    given: Literal["none", "references", "all"] = "none"


UNCHARTED = replace(WARPED, surfaces=False)
"""References filled as images, without charts of the surfaces behind the object."""

METHODS: Mapping[str, PerView | Removal] = {
    "mean colour of each view": mean_color_fill,
    "Telea on each view": telea_fill,
    "classical": Removal("classical", UNCHARTED),
    "exemplar": Removal("exemplar", UNCHARTED),
    "lama": Removal("lama", UNCHARTED),
    "charts with classical": Removal("classical"),
    "charts with exemplar": Removal("exemplar"),
    "charts with lama": Removal("lama"),
    "true references": Removal("classical", given="references"),
    "true views": Removal("classical", UNCHARTED, given="all"),
}
"""Methods by name. The last two are ceilings: true references, then propagated; true views, then fitted."""

PICTURED = "exemplar"
"""The method whose best and worst captures are shown."""
