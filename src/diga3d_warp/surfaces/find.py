"""Charts of the surfaces that could continue into the hole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from diga3d_warp.surfaces.chart import Chart
from diga3d_warp.surfaces.evidence import away_from_object, gather
from diga3d_warp.surfaces.layout import in_front, lay_out
from diga3d_warp.surfaces.occupancy import Occupancy, occupancy
from diga3d_warp.surfaces.photo import Photo
from diga3d_warp.surfaces.planes import find_planes, mean_eye
from diga3d_warp.surfaces.settings import LAYOUT, SURFACES, SurfaceSettings
from diga3d_warp.surfaces.sweep import agreed_planes
from diga3d_warp.surfaces.texture import textured


def find_charts(
    photos: Sequence[Photo], sparse: np.ndarray, seed: int = 0, settings: SurfaceSettings = SURFACES
) -> list[Chart]:
    """Charts of what the hole shows, with the colours and the occupancy that photographs show.

    Args:
        photos: All views, the object taken out.
        sparse: Positions of the sparse points [scene units], shape (N, 3).
        seed: Same photographs and seed: same charts.
        settings: Thresholds.

    Returns:
        None for a hole that no surface continues into. In each, `wanted` is what the hole shows of it and no
        photograph does; `alpha` says where the surface is taken to be there. One that is not trusted hides
        what is behind it, and nothing is filled on it.
    """
    seeing = [photo for photo in photos if photo.unseen.any()]
    if not seeing:
        return []
    eye = mean_eye([photo.camera for photo in seeing])
    planes = find_planes(gather(seeing, sparse, seed, settings), eye, seed, settings)
    few = away_from_object(seeing, sparse, settings)
    guesses = find_planes(few, eye, seed, settings, bends=False)
    planes = agreed_planes(planes, guesses, photos, seed, settings)
    charts = [textured(photos, frame, settings) for frame in lay_out(planes, photos, seed, settings)]
    states = [
        occupancy(
            chart.known,
            chart.through,
            chart.wanted,
            seed,
            settings.trusted,
            chart.frame.agreed,
            chart.covered,
        )
        for chart in charts
    ]
    surfaces = [(chart.frame, state.solid) for chart, state in zip(charts, states, strict=True)]
    hits = in_front(surfaces, seeing, settings)
    decided = [_decided(*each) for each in zip(charts, states, hits, strict=True)]
    if not any(chart.trusted for chart in decided):
        return []
    return [chart for chart in decided if chart.known.any()]


def _decided(chart: Chart, state: Occupancy, hit: np.ndarray) -> Chart:
    """A chart whose occupancy is decided where the hole shows it."""
    import cv2

    seen = np.zeros(chart.known.shape, np.uint8)
    seen[hit[:, 0], hit[:, 1]] = 1
    box = np.ones((LAYOUT.gap, LAYOUT.gap), np.uint8)
    shown = cv2.dilate(cv2.morphologyEx(seen, cv2.MORPH_CLOSE, box), box) > 0
    wanted = state.solid & ~chart.known & shown & state.trusted
    alpha = (chart.known | wanted).astype(np.float32)
    return replace(chart, wanted=wanted, alpha=alpha, trusted=state.trusted)
