"""Colours of what nobody saw of a chart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from diga3d_warp.priors.protocol import Prior
from diga3d_warp.surfaces.chart import Chart
from diga3d_warp.surfaces.offsets import OFFSETS, OffsetSettings
from diga3d_warp.surfaces.parts import parts_of, surroundings_of
from diga3d_warp.surfaces.regular import continue_regular
from diga3d_warp.surfaces.settings import SHOWN


def fill_chart(chart: Chart, prior: Prior, seed: int, settings: OffsetSettings = OFFSETS) -> Chart:
    """Fill what is wanted of a chart: regular textures by their offsets, the rest by a prior.

    Args:
        chart: From `find.find_charts`.
        prior: Fills the chart as it would fill an image. A trained network fills all of it.
        seed: Of the prior.
        settings: Of the offsets.

    Returns:
        The chart with colours wherever it is occupied; what was known is unchanged.
    """
    if not chart.wanted.any() or not chart.known.any():
        return chart
    image, copied = chart.image, np.zeros_like(chart.wanted)
    if not getattr(prior, "learned", False):
        image, copied = continue_regular(image, chart.known, chart.wanted, settings)
    image = image.copy()
    known = chart.known | copied
    for part in parts_of(chart.wanted & ~copied, settings.apart):
        window = surroundings_of(part, SHOWN.margin, SHOWN.margin_min)
        if not known[window].any():
            window = (slice(None), slice(None))
        around = mirrored(image[window], known[window])
        painted = _painted(around, part[window], prior, seed)
        image[window] = np.where(part[window][..., None], painted, image[window])
        known |= part
    return replace(
        chart, image=np.where((chart.known | chart.wanted)[..., None], image, 0.0).astype(np.float32)
    )


def mirrored(image: np.ndarray, known: np.ndarray) -> np.ndarray:
    """An image (H, W, 3) with its known part mirrored into the rest: a prior then fills only what it must."""
    import cv2

    if known.all():
        return image
    _, label = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    places = np.argwhere(known)
    order = np.zeros(label.max() + 1, int)
    order[label[known]] = np.arange(len(places))
    nearest = places[order[label]]
    reflected = 2 * nearest - np.moveaxis(np.indices(known.shape), 0, -1)
    inside = ((reflected >= 0) & (reflected < known.shape)).all(axis=2)
    reflected = np.where(inside[..., None], reflected, nearest)
    reflected = np.where(known[reflected[..., 0], reflected[..., 1]][..., None], reflected, nearest)
    return image[reflected[..., 0], reflected[..., 1]]


def _painted(image: np.ndarray, missing: np.ndarray, prior: Prior, seed: int) -> np.ndarray:
    colors, where = (torch.from_numpy(np.ascontiguousarray(plane)) for plane in (image, missing))
    return prior.fill(colors, where, seed=seed).numpy()
