"""A picture of a shadow: the support before, the light that is left, and the support after."""

from __future__ import annotations

import numpy as np

from diga3d_warp.shadows.find import Shadow
from diga3d_warp.shadows.relight import relit
from diga3d_warp.shadows.settings import SHADOWS, ShadowSettings
from diga3d_warp.surfaces.chart import Chart

UNKNOWN = 0.5
"""Grey of what photographs do not show."""


def shadow_picture(chart: Chart, shadow: Shadow, settings: ShadowSettings = SHADOWS) -> np.ndarray:
    """The three side by side, RGB in [0, 1], shape (H, 3 W + gaps, 3), float32."""
    known = chart.known[..., None]
    ratio = np.where(shadow.level[..., None] < settings.shaded, shadow.ratio, 1.0)
    after = np.clip(relit(chart.image, np.maximum(ratio, settings.black)), 0.0, 1.0)
    gap = np.ones((chart.known.shape[0], 4, 3))
    before, after = (np.where(known, image, UNKNOWN) for image in (chart.image, after))
    return np.concatenate([before, gap, shadow.ratio, gap, after], axis=1).astype(np.float32)
