"""Blending weights of gaussians, by pixel and by image. Nothing here has a gradient."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import torch
import warp as wp

from diga3d_warp.config import Accuracy, Effects
from diga3d_warp.kernels import attribution
from diga3d_warp.kernels.binning import Bins
from diga3d_warp.kernels.blending import Blending
from diga3d_warp.kernels.splats import Splats
from diga3d_warp.splatting.arrays import vector_arrays, warp_array
from diga3d_warp.splatting.composite import bin_projection, in_precision
from diga3d_warp.splatting.project import Projection


class Shares(NamedTuple):
    """Share of each gaussian in an image.

    Attributes:
        weights: Sum of its blending weights [pixels at full opacity], shape (N,).
        sums: Sum of weight times the pixel's values, shape (N, 3).
        hits: Pixels in which it has a weight above 0, shape (N,), int32.
    """

    weights: torch.Tensor
    sums: torch.Tensor
    hits: torch.Tensor


class Strongest(NamedTuple):
    """The gaussians that weigh most in each pixel, by falling weight.

    Attributes:
        gaussians: Their indices, -1 where fewer show, shape (H, W, count), int32.
        weights: Their blending weights, 0 where fewer show, shape (H, W, count).
    """

    gaussians: torch.Tensor
    weights: torch.Tensor


def shares(
    projection: Projection,
    values: torch.Tensor,
    *,
    accuracy: Accuracy = Accuracy.STANDARD,
    effects: Effects = Effects(),
) -> Shares:
    """Sum up the blending weights of each gaussian over an image, plainly and times three values of a pixel.

    Args:
        projection: N gaussians in the image plane.
        values: Three numbers per pixel, a mask or colours for instance, shape (H, W, 3).
        accuracy, effects: As in `composite`.

    Raises:
        ValueError: `projection.depth_slopes` is None where each pixel has its own order.
    """
    height, width, _ = values.shape
    blending, splats, bins = _prepare(projection, width, height, accuracy, effects)
    dtype, count = splats.centers.dtype, len(projection.depths)
    weights, sums = (values.new_zeros(shape, dtype=dtype) for shape in ((count,), (count, 3)))
    hits = values.new_zeros(count, dtype=torch.int32)
    pixels, of_weights, of_sums = vector_arrays(
        [values.detach().to(dtype).reshape(-1, 3).contiguous(), weights, sums]
    )
    result = attribution.Shares(of_weights, of_sums, warp_array(hits, wp.int32))
    attribution.shares(bins, width, height, Splats(*vector_arrays(splats.tensors)), pixels, result, blending)
    return Shares(weights, sums, hits)


def strongest(
    projection: Projection,
    width: int,
    height: int,
    count: int,
    *,
    accuracy: Accuracy = Accuracy.STANDARD,
    effects: Effects = Effects(),
) -> Strongest:
    """Find the `count` gaussians that weigh most in each pixel; of equal ones, those in front come first.

    Args:
        projection: N gaussians in the image plane.
        width, height: Image size [px].
        count: How many, at least 1; a kernel is compiled for each number.
        accuracy, effects: As in `composite`.

    Raises:
        ValueError: `count` is below 1, or `projection.depth_slopes` is None where each pixel has its own
            order.
    """
    if count < 1:
        raise ValueError(f"the number of strongest gaussians must be at least 1, not {count}")
    blending, splats, bins = _prepare(projection, width, height, accuracy, effects)
    gaussians = splats.centers.new_empty((height, width, count), dtype=torch.int32)
    weights = splats.centers.new_empty((height, width, count))
    result = attribution.Strongest(
        warp_array(gaussians.view(-1, count), wp.int32), warp_array(weights.view(-1, count), blending.real)
    )
    attribution.strongest(bins, width, height, Splats(*vector_arrays(splats.tensors)), result, blending)
    return Strongest(gaussians, weights)


def _prepare(
    projection: Projection, width: int, height: int, accuracy: Accuracy, effects: Effects
) -> tuple[Blending, Projection, Bins]:
    """Kernel's kind, what it reads of the projection, and pairs of the image."""
    blending = Blending.of(accuracy, replace(effects, depth=False))
    splats = Projection(*(t.detach().contiguous() for t in in_precision(projection, blending).tensors))
    return blending, splats, bin_projection(splats, width, height)
