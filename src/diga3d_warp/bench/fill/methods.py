"""The fills that are compared."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

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
        true_references: Whether the references are given filled with the truth, as `--fill` takes them.
    """

    prior: str = "exemplar"
    method: Method = WARPED
    true_references: bool = False


METHODS: Mapping[str, PerView | Removal] = {
    "mean colour of each view": mean_color_fill,
    "Telea on each view": telea_fill,
    "classical": Removal("classical"),
    "exemplar": Removal("exemplar"),
    "lama": Removal("lama"),
    "true references": Removal("classical", true_references=True),
}
"""Methods by name. The last is the ceiling: true images at the references, given by `--fill`."""

PICTURED = "exemplar"
"""The method whose best and worst captures are shown."""
