"""The part of each view around its mask.

A prior works at the size that it was trained at. An object that is small in a photograph would be a few
latent cells there; cut out with its surroundings it has as many as the whole photograph would have.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

import torch

from diga3d_warp.errors import InputError
from diga3d_warp.priors.protocol import DiffusionPrior

WHOLE = (slice(None), slice(None))
"""Rows and columns of the window that is the whole view."""


@dataclass(frozen=True)
class WindowSettings:
    """Size of the windows that a prior is given.

    Attributes:
        around: Sides of a window [sides of the largest mask]. At 1.6 three tenths of the object's size are
            left on each side, which show light and support.
        oblong: Most that a window's long side is [short sides]. Photographs are up to 16:9; of a mast alone
            it would be a long strip, whose few latents across show little context.
        enlarged: Most that a window is enlarged to the prior's native size [1]. Enlarged further, its
            surroundings would be blurred, and the prior would continue the blur.
    """

    around: float = 1.6
    oblong: float = 2.0
    enlarged: float = 4.0


@dataclass(frozen=True)
class Windows:
    """Windows of one size, one in each view that has a mask; smaller only where a view is smaller.

    All windows have one size, so that textures have the same scale in all views.

    Attributes:
        views: Indices of the views that have a mask.
        places: Rows and columns of the window in each of these.
    """

    views: list[int]
    places: list[tuple[slice, slice]]

    @staticmethod
    def around(
        masks: Sequence[torch.Tensor], prior: DiffusionPrior, settings: WindowSettings | None = None
    ) -> Windows:
        """Windows around the masks, each in the middle of its view's mask as far as the view reaches.

        A prior that takes images of any size as they are gets whole views: a window would only hide from it
        what it could continue.

        Args:
            masks: True where to edit, one for each view, shape (H, W), bool.
            prior: Its native size bounds how much a window is enlarged.
            settings: Size of the windows.

        Raises:
            InputError: no view has a mask.
        """
        settings = settings or WindowSettings()
        spans = [(_span(mask.any(1)), _span(mask.any(0))) if bool(mask.any()) else None for mask in masks]
        seen = [(index, span) for index, span in enumerate(spans) if span is not None]
        if not seen:
            raise InputError("the object shows in no view: mask an object that the views show")
        indices = [index for index, _ in seen]
        if all(tuple(prior.native_size(*masks[index].shape)) == masks[index].shape for index in indices):
            return Windows(indices, [WHOLE] * len(indices))
        height, width = (max(span[axis][1] - span[axis][0] for _, span in seen) for axis in (0, 1))
        sides = _sides(settings.around * height, settings.around * width, prior, settings)
        places = []
        for index, span in seen:
            rows, columns = (
                _placed(span[axis], sides[axis], int(masks[index].shape[axis])) for axis in (0, 1)
            )
            places.append((rows, columns))
        return Windows(indices, places)

    def cut(self, planes: Sequence[torch.Tensor]) -> list[torch.Tensor]:
        """What the windows show of images (H, W, ...), one for each view of the capture."""
        return [planes[index][place] for index, place in zip(self.views, self.places, strict=True)]

    def put_back(self, images: Sequence[torch.Tensor], parts: Sequence[torch.Tensor]) -> list[torch.Tensor]:
        """Copies of images (H, W, ...) with other windows, those from `cut` after work on them."""
        whole = [image.clone() for image in images]
        for index, place, part in zip(self.views, self.places, parts, strict=True):
            whole[index][place] = part
        return whole


def _span(occupied: torch.Tensor) -> tuple[int, int]:
    """First and one past the last occupied row or column."""
    indices = occupied.nonzero()
    return int(indices[0]), int(indices[-1]) + 1


def _sides(height: float, width: float, prior: DiffusionPrior, settings: WindowSettings) -> tuple[int, int]:
    """Height and width of all windows [px]."""
    height, width = max(height, width / settings.oblong), max(width, height / settings.oblong)
    native = prior.native_size(ceil(height), ceil(width))
    grow = max(1.0, min(native) / min(height, width) / settings.enlarged)
    return ceil(grow * height), ceil(grow * width)


def _placed(span: tuple[int, int], side: int, length: int) -> slice:
    """Where a window of a side lies in a view of a length, around the middle of a span."""
    side = min(side, length)
    first = (span[0] + span[1] - side) // 2
    first = min(max(first, 0), length - side)
    return slice(first, first + side)
