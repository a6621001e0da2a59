"""Colours of a chart: those of the photographs that sample a texel finest, with their tone made equal first.

The finest are near, frontal and sharp at once.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from diga3d_warp.surfaces.chart import Chart, Frame
from diga3d_warp.surfaces.look import density_of, look, sampled
from diga3d_warp.surfaces.photo import Photo
from diga3d_warp.surfaces.settings import SURFACES, SurfaceSettings
from diga3d_warp.surfaces.votes import poll


def textured(photos: Sequence[Photo], frame: Frame, settings: SurfaceSettings = SURFACES) -> Chart:
    """The chart of a frame, with the colours and the occupancy that photographs show."""
    polled = poll(photos, frame.coarser(settings.polled), settings).on(frame)
    points = frame.points
    order = np.argsort(-polled.worth, kind="stable")[: settings.views]
    samples, weights = [], []
    for number in order[polled.worth[order] > 0.0]:
        view = look(photos[number], points, settings, frame.axes[2])
        density = density_of(frame, points, photos[number].camera, settings)
        colors = sampled(photos[number], view)
        samples.append(colors)
        weights.append(np.where(polled.shown(view, colors), density, 0.0).astype(np.float32))
    if samples:
        image, shown = blended(samples, weights, settings)
    else:
        image, shown = np.zeros((*frame.size, 3)), np.zeros(frame.size, bool)
    known = polled.occupied & shown
    image = np.where(known[..., None], image, 0.0).astype(np.float32)
    wanted = polled.unseen & ~known & ~polled.through
    alpha = known.astype(np.float32)
    return Chart(frame, image, known, polled.through, wanted, alpha, deep=polled.deep, covered=polled.covered)


def blended(
    samples: Sequence[np.ndarray], weights: Sequence[np.ndarray], settings: SurfaceSettings
) -> tuple[np.ndarray, np.ndarray]:
    """One image of photographs of a chart, and where they show it.

    A texel takes the photographs that sample it finest only: the others are far off, slanted or out of focus.

    Args:
        samples: Colours, shape (H, W, 3) each.
        weights: Sampling density of each, shape (H, W); zero where it does not show the chart.
        settings: How many are blended, and how.
    """
    stacked = np.stack(weights)
    rank = len(samples) - min(settings.blended, len(samples))
    finest = np.partition(stacked, rank, axis=0)[rank]
    peak = np.maximum(stacked.max(axis=0), 1e-30)
    colors, total = np.zeros_like(samples[0]), np.zeros(stacked.shape[1:], np.float32)
    for sample, weight in zip(even_tone(samples, stacked, settings), stacked, strict=True):
        share = np.where(weight >= finest, weight / peak, 0.0) ** settings.sharpness
        colors += share[..., None] * sample
        total += share
    return np.clip(colors / np.maximum(total, 1e-30)[..., None], 0.0, 1.0), total > 0.0


def even_tone(
    samples: Sequence[np.ndarray], weights: np.ndarray, settings: SurfaceSettings = SURFACES
) -> list[np.ndarray]:
    """Photographs of a chart with the same mean colours where they overlap.

    One offset for each photograph and channel, by least squares over all pairs; the mean change is zero.

    Args:
        samples: Colours of each photograph, shape (H, W, 3).
        weights: Where and how finely each shows the chart, shape (N, H, W); zero where it does not.
        settings: Texels that are compared, and the largest change.
    """
    count = len(samples)
    if count < 2:
        return list(samples)
    normal, right = np.zeros((count, count)), np.zeros((count, 3))
    step = max(int(np.sqrt(samples[0].shape[0] * samples[0].shape[1] / settings.toned)), 1)
    some, shows = [sample[::step, ::step] for sample in samples], weights[:, ::step, ::step] > 0.0
    for i in range(count):
        for j in range(i):
            both = shows[i] & shows[j]
            shared = int(both.sum())
            if shared < settings.tone_least:
                continue
            apart = np.median(some[j][both] - some[i][both], axis=0)
            normal[[i, j], [i, j]] += shared
            normal[[i, j], [j, i]] -= shared
            right[i] += shared * apart
            right[j] -= shared * apart
    # Groups of photographs that share nothing keep their own mean: the least-norm solution.
    offsets = np.linalg.lstsq(normal, right, rcond=1e-9)[0]
    offsets = np.clip(offsets, -settings.tone_most, settings.tone_most).astype(np.float32)
    return [sample + offset for sample, offset in zip(samples, offsets, strict=True)]
