"""The captures that are filled, and the figures of a method on one of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypedDict

from diga3d_warp.bench.ablation.measure import SETTINGS
from diga3d_warp.errors import InputError
from diga3d_warp.pipelines.remove import RemoveSettings

FEWEST_VIEWS = 6
"""Every 4th view is held out, and three of the others are references."""


@dataclass(frozen=True)
class Captures:
    """What is filled.

    Attributes:
        situations: Names of situations.
        seeds: Each situation is generated with the seeds 0 to `seeds` - 1.
        width, height: Image size [px].
        views: Number of views, every `HOLD_OUT`th of which is held out.
        settings: Of the removals but for their method.

    Raises:
        InputError: there are too few views to hold some out.
    """

    situations: Sequence[str]
    seeds: int = 3
    width: int = 160
    height: int = 120
    views: int = 16
    settings: RemoveSettings = field(default_factory=lambda: SETTINGS)

    def __post_init__(self) -> None:
        if self.views < FEWEST_VIEWS:
            raise InputError(
                f"{self.views} views leave too few to fit and to hold out: use {FEWEST_VIEWS} or more"
            )

    @property
    def cells(self) -> list[tuple[str, int]]:
        """Situation and seed of each capture."""
        return [(name, seed) for name in self.situations for seed in range(self.seeds)]


class Figures(TypedDict):
    """What a method reached on a capture; None where it does not apply.

    psnr, ssim: held-out views against the truth, within the widened masks [dB, 1].
    unseen: PSNR of the filled views before any fit, where no photograph shows what is behind the object [dB].
    contrast: deviation of colours there in shares of the truth's [1].
    left: share of those pixels that no fill reached; the figures above leave them out [1].
    disagreement: of the filled views there [levels of 255].
    depth_error: median relative depth error of the rendered views there [1].
    elsewhere: PSNR of views without the object from other places, whole images [dB].
    seconds: from the choice of references to the finished splat; of a fill of each view, all views.
    """

    psnr: float
    ssim: float
    unseen: float | None
    contrast: float | None
    left: float
    disagreement: float | None
    depth_error: float | None
    elsewhere: float | None
    seconds: float
