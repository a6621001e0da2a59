"""Charts in the colours of views that the user filled, so that all views follow these."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from diga3d_warp.propagation.tone import rim_of
from diga3d_warp.propagation.unseen import Background
from diga3d_warp.scene.scene import View
from diga3d_warp.splatting.placement import projected
from diga3d_warp.surfaces.chart import Chart
from diga3d_warp.surfaces.compose import compose
from diga3d_warp.surfaces.look import density_of
from diga3d_warp.surfaces.settings import SURFACES
from diga3d_warp.surfaces.texture import blended


def colored_by(
    charts: Sequence[Chart],
    views: Sequence[View],
    backgrounds: Sequence[Background],
    own: Mapping[int, np.ndarray],
) -> list[Chart]:
    """Charts on which what the user's views show of the hole is known.

    Args:
        charts: From `find_charts`.
        views: All of them.
        backgrounds: What is known behind the object, one per view.
        own: Views that the user filled, RGB (H, W, 3), float32 in [0, 1], by index. Where several show a
            texel, those that sample it finest count.
    """
    samples: list[list[np.ndarray]] = [[] for _ in charts]
    weights: list[list[np.ndarray]] = [[] for _ in charts]
    known = [replace(chart, alpha=chart.known.astype(np.float32)) for chart in charts]
    for index, image in own.items():
        view, hole = views[index], backgrounds[index].unseen
        layer = compose(charts, view.camera)
        around = compose(known, view.camera)
        rim = rim_of(hole) & (around.chart >= 0) & (around.chart == layer.chart)
        # As the photographs of a chart, each has its own tone.
        tone = np.median((image - around.image)[rim], axis=0) if rim.any() else np.zeros(3)
        even = image - np.clip(tone, -SURFACES.tone_most, SURFACES.tone_most)
        for number, chart in enumerate(charts):
            color, weight = _seen(chart, view, even, hole & (layer.chart == number))
            samples[number].append(color)
            weights[number].append(weight)
    return [_colored(*each) for each in zip(charts, samples, weights, strict=True)]


def _seen(chart: Chart, view: View, image: np.ndarray, shown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Colours of a chart's wanted texels in a view, and how finely it samples them; 0 where not shown."""
    import cv2

    points = chart.frame.points
    place = projected(points, view.camera)
    height, width = shown.shape
    with np.errstate(invalid="ignore"):
        inside = (place[..., :2] >= 0.5) & (place[..., :2] <= np.array([width, height]) - 0.5)
        inside = inside.all(axis=2) & (place[..., 2] > view.camera.near)
    column, row = (np.where(inside, place[..., k] - 0.5, -1.0).astype(np.float32) for k in (0, 1))
    at = shown[np.rint(row).astype(int), np.rint(column).astype(int)] & inside & chart.wanted
    color = cv2.remap(
        image.astype(np.float32), column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    density = density_of(chart.frame, points, view.camera, SURFACES)
    return color, np.where(at, density, 0.0).astype(np.float32)


def _colored(chart: Chart, samples: Sequence[np.ndarray], weights: Sequence[np.ndarray]) -> Chart:
    if not samples:
        return chart
    image, found = blended(samples, weights, SURFACES)
    return replace(
        chart, image=np.where(found[..., None], image, chart.image).astype(np.float32),
        known=chart.known | found, wanted=chart.wanted & ~found,
    )  # fmt: skip
