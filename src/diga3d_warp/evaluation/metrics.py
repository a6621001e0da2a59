"""PSNR and SSIM of an image against another, over the whole image and over the regions of a mask.

The literature reports masked figures in two ways that are not comparable: over the pixels of the mask, and
over its bounding box. Both are given, under separate names.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import torch

from diga3d_warp.scene.photographs.images import BACKGROUND

SSIM_WINDOW = 11
"""Side of SSIM's Gaussian window [px], sigma 1.5 px: Wang et al. 2004, and 3DGS. A bounding box is grown to
at least this size, for a window must fit."""

REGIONS = ("whole", "masked", "box", "unmasked")
"""whole: every pixel. masked: pixels of the mask. box: the mask's bounding box, mask or not. unmasked: the
rest. SSIM of "masked" is the mean of the whole image's SSIM map there; of "unmasked" likewise, after the
mask's pixels have been made equal, since the window extends into the mask."""


@dataclass(frozen=True)
class Score:
    """PSNR and SSIM over one region.

    Attributes:
        psnr: Peak signal-to-noise ratio [dB] for a peak of 1; infinite for equal images.
        ssim: Structural similarity, at most 1.
    """

    psnr: float
    ssim: float

    def as_json(self) -> dict[str, float | None]:
        """The figures as JSON data; an infinite PSNR becomes null, since JSON knows no infinity."""
        return {"psnr": self.psnr if math.isfinite(self.psnr) else None, "ssim": self.ssim}

    @classmethod
    def from_json(cls, data: Mapping[str, float | None]) -> Score:
        """The figures back from JSON data."""
        psnr, ssim = data["psnr"], data["ssim"]
        assert ssim is not None
        return cls(math.inf if psnr is None else psnr, ssim)


def psnr(image: torch.Tensor, truth: torch.Tensor, mask: torch.Tensor | None = None) -> float:
    """Peak signal-to-noise ratio [dB] for a peak of 1, summed in float64; infinite for equal images.

    Args:
        image, truth: RGB in [0, 1], shape (H, W, 3).
        mask: Pixels that count, shape (H, W), bool; all if None. At least one must be True.
    """
    error = (image.detach().double() - truth.detach().double()).square()
    mean = float((error if mask is None else error[mask]).mean())
    return math.inf if mean == 0.0 else -10.0 * math.log10(mean)


def ssim_map(image: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """Structural similarity around each pixel, mean over channels, shape (H, W), float64.

    Args:
        image, truth: RGB in [0, 1], shape (H, W, 3), at least `SSIM_WINDOW` pixels a side.
    """
    from kornia.metrics import ssim as kornia_ssim

    # float64: in float32 the variances of flat, bright regions are differences of nearly equal numbers.
    first, second = (array.detach().double().permute(2, 0, 1)[None] for array in (image, truth))
    return kornia_ssim(first, second, SSIM_WINDOW)[0].mean(0)


def ssim(image: torch.Tensor, truth: torch.Tensor) -> float:
    """Structural similarity, the mean of `ssim_map`."""
    return float(ssim_map(image, truth).mean())


def compare(
    image: torch.Tensor, truth: torch.Tensor, mask: np.ndarray | torch.Tensor | None = None
) -> dict[str, Score]:
    """Score an image against the truth, over the whole and over the regions that a mask defines.

    Args:
        image, truth: RGB in [0, 1], shape (H, W, 3). Values outside are clipped, as a screen does.
        mask: True where the object is or was, shape (H, W), bool; None if unknown.

    Returns:
        A score for each of `REGIONS` that has a pixel.
    """
    image, truth = (array.detach().cpu().clamp(0.0, 1.0) for array in (image, truth))
    similarity = ssim_map(image, truth)
    scores = {"whole": Score(psnr(image, truth), float(similarity.mean()))}
    if mask is None:
        return scores
    masked = torch.as_tensor(mask).cpu()
    if not masked.all():
        outside = ssim_map(torch.where(masked[..., None], truth, image), truth)[~masked]
        scores["unmasked"] = Score(psnr(image, truth, ~masked), float(outside.mean()))
    if masked.any():
        scores["masked"] = Score(psnr(image, truth, masked), float(similarity[masked].mean()))
        rows, columns = bounding_box(masked)
        inner, outer = image[rows, columns], truth[rows, columns]
        scores["box"] = Score(psnr(inner, outer), ssim(inner, outer))
    return {region: scores[region] for region in REGIONS if region in scores}


def matched(image: torch.Tensor, truth: torch.Tensor, alpha: np.ndarray | None = None) -> torch.Tensor:
    """An image after the affine colour transform that brings it closest to another, (H, W, 3).

    Least squares over all pixels, gain 3 x 3 and offset. It removes exposure and white balance from a
    comparison. The result has been fitted to the truth, so it is reported beside the plain one only.

    Args:
        image, truth: RGB in [0, 1], shape (H, W, 3).
        alpha: Opacity of the truth, shape (H, W), uint8: what shines through it has no exposure.
    """
    colors = image.detach().double().clamp(0.0, 1.0).reshape(-1, 3)
    known = torch.cat([colors, torch.ones_like(colors[:, :1])], dim=1)
    wanted = truth.detach().double().reshape(-1, 3)
    behind = torch.zeros_like(known)
    if alpha is not None:
        through = 1.0 - torch.from_numpy(alpha).double().reshape(-1, 1) / 255.0
        behind = through * torch.tensor([*BACKGROUND, 1.0], dtype=torch.float64)
    own = known - behind
    # A flat image leaves the gain open: the smallest solution is taken.
    solution = torch.linalg.lstsq(own, wanted - behind[:, :3], driver="gelsd").solution
    return (own @ solution + behind[:, :3]).reshape(truth.shape).to(truth.dtype)


def mean_scores(views: Iterable[Mapping[str, Score]]) -> dict[str, Score]:
    """Mean over views, region by region, over the views that have the region.

    PSNR is averaged in decibels, as the field does; one equal image makes the mean infinite.
    """
    views = list(views)
    means = {}
    for region in REGIONS:
        scores = [view[region] for view in views if region in view]
        if scores:
            means[region] = Score(
                float(np.mean([score.psnr for score in scores])),
                float(np.mean([score.ssim for score in scores])),
            )
    return means


def bounding_box(mask: torch.Tensor, smallest: int = SSIM_WINDOW) -> tuple[slice, slice]:
    """Rows and columns around a mask's True pixels, grown to `smallest` pixels where smaller."""
    return _span(mask.any(1), smallest), _span(mask.any(0), smallest)


def _span(occupied: torch.Tensor, smallest: int) -> slice:
    where = occupied.nonzero()
    first, last = int(where.min()), int(where.max()) + 1
    size = max(last - first, min(smallest, len(occupied)))
    first = min(max(first - (size - (last - first)) // 2, 0), len(occupied) - size)
    return slice(first, first + size)
