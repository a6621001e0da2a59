"""Find the shadow of an object on its support."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diga3d_warp.materials.painting import GAMMA
from diga3d_warp.shadows.casting import Caster
from diga3d_warp.shadows.light import Fitted, LightSearch, Measured
from diga3d_warp.shadows.likeness import Places, places_of
from diga3d_warp.shadows.settings import SHADOWS, ShadowSettings
from diga3d_warp.shadows.support import Solid, Support
from diga3d_warp.surfaces.chart import Chart, Frame
from diga3d_warp.surfaces.photo import Photo
from diga3d_warp.surfaces.settings import SURFACES
from diga3d_warp.surfaces.texture import density_of, look, sampled, textured

AGREE_LEAST = 30
"""Texels in the shadow and beside it that a view must show to be heard."""


@dataclass(frozen=True, eq=False)
class Shadow:
    """The shadow of an object on its support.

    Attributes:
        frame: Chart of the support.
        ratio: Share of the light that is left, of each channel in linear light, shape (H, W, 3), float32.
        floor: Height over the support, up or down, within which a gaussian lies on it [scene units].
    """

    frame: Frame
    ratio: np.ndarray
    floor: float

    @property
    def level(self) -> np.ndarray:
        """Mean of the ratio over channels, shape (H, W), float32."""
        return self.ratio.mean(axis=2)


@dataclass(frozen=True)
class ShadowEvidence:
    """What speaks for a shadow.

    Attributes:
        strength: Share of the light that the object takes at most, where the support is seen [1].
        explained: Part that the light explains of what is unlike in the shadow [1].
        chance: The most that a shadow elsewhere explains, against this one [ratio].
        hues: Ratio of the shadow's strengths in the channel where it is strongest and weakest [1].
        spread: Spread of the darkening over views [ratio to it]; 0 where fewer than two tell.
        painted: Whether a round stain under the object would explain it better than any light.
    """

    strength: float
    explained: float
    chance: float
    hues: float
    spread: float
    painted: bool = False

    def suffices(self, settings: ShadowSettings = SHADOWS) -> bool:
        """Whether this is a shadow."""
        return (
            self.strength >= settings.strength
            and self.explained >= settings.explained
            and self.explained >= settings.beyond * self.chance
            and self.hues <= settings.hues
            and self.spread <= settings.agreeing
            and not self.painted
        )


def find_shadow(
    photos: Sequence[Photo], solid: Solid, support: Support, seed: int, settings: ShadowSettings = SHADOWS
) -> tuple[Shadow, ShadowEvidence, Chart] | None:
    """The shadow of an object, with what speaks for it; None where there is nothing to tell it by.

    Args:
        photos: Views, the object taken out.
        solid: The object's gaussians.
        support: What it stands on.
        seed: Of the choice of places.
        settings: Thresholds.
    """
    chart = textured(photos, support.frame)
    frame = support.frame
    opaque = solid.opacities > settings.opaque
    if not (frame.coordinates(solid.points[opaque])[:, 2] > support.floor).any():
        return None
    caster = Caster(frame, solid.points[opaque], solid.widths[opaque], support.floor)
    near = caster.away < settings.near * support.height
    linear = chart.image.astype(np.float32) ** np.float32(GAMMA)
    places = places_of(linear, chart.known, near, settings.places, seed)
    if len(places) < settings.texels:
        return None
    search = LightSearch(caster)
    first, hues = _fitted(places, search, _suspected(places, search, settings), support, seed, settings)
    # What a second comparison takes for lit follows from the first: it is better, and proves nothing.
    left = np.clip(first.ratio.ravel()[places.index], settings.black, 1.0)
    found = first
    if _explained(first, places, settings) >= settings.explained:
        found, hues = _fitted(places, search, left, support, seed, settings)
    ratio = np.clip(1.0 - hues * (1.0 - found.ratio[..., None]), 0.0, 1.0).astype(np.float32)
    shadow = Shadow(frame, ratio, support.floor)
    evidence = ShadowEvidence(
        strength=1.0 - float(np.quantile(left, 0.005)),
        explained=_explained(first, places, settings),
        chance=first.chance,
        hues=float(hues.max() / max(float(hues.min()), 1e-3)),
        spread=_spread(photos, chart, shadow, settings),
        painted=first.cost_painted < float(first.cost.sum()),
    )
    return shadow, evidence, chart


def _suspected(places: Places, search: LightSearch, settings: ShadowSettings) -> np.ndarray:
    """Ratios before anything is known: dark where the object hides much of the sky."""
    sky = search.sky.ravel()[places.index]
    return np.where(sky > np.quantile(sky, 1.0 - settings.suspected), 0.5, 1.0)


def _fitted(
    places: Places, search: LightSearch, left: np.ndarray, support: Support, seed: int,
    settings: ShadowSettings,
) -> tuple[Fitted, np.ndarray]:  # fmt: skip
    """The light, what it was fitted to, and the relative strength of the shadow in each channel."""
    logs, apart = places.ratios(left > settings.lit, left, seed)
    ratio = np.clip(np.exp(logs.mean(axis=1)), 0.0, 3.0)
    away = search.caster.away.ravel()[places.index] / (settings.fading * support.height)
    weight = 1.0 / (1.0 + apart / max(float(np.median(apart)), 1e-9)) / (1.0 + away**4)
    measured = Measured(places.index, places.at, ratio, weight)
    found = search.fit(measured)
    taken = 1.0 - found.ratio.ravel()[places.index]
    each = np.clip(np.exp(logs), 0.0, 3.0)
    shares = (
        (weight * taken)
        @ (1.0 - each - (1.0 - ratio - taken)[:, None])
        / max(float((weight * taken) @ taken), 1e-9)
    )
    return found, np.clip(shares, 0.25, 2.0)


def _explained(found: Fitted, places: Places, settings: ShadowSettings) -> float:
    inside = found.ratio.ravel()[places.index] < 0.5 * (1.0 + settings.lit) - 0.05
    if not inside.any():
        return 0.0
    return 1.0 - float(found.cost[inside].sum()) / max(float(found.cost_without[inside].sum()), 1e-12)


def _spread(photos: Sequence[Photo], chart: Chart, shadow: Shadow, settings: ShadowSettings) -> float:
    """How much the darkening of single views differs [standard deviation over the mean darkening]."""
    level = shadow.level
    inside, beside = chart.known & (level < 0.8), chart.known & (level > settings.lit)
    points = chart.frame.points
    logs = np.log(np.maximum(chart.image.mean(axis=2), 1e-2))
    found = []
    for photo in photos:
        view = look(photo, points, normal=chart.frame.axes[2])
        shown = view.known & (density_of(chart.frame, points, photo.camera, SURFACES) > 0.0)
        if min((shown & inside).sum(), (shown & beside).sum()) < AGREE_LEAST:
            continue
        apart = np.log(np.maximum(sampled(photo, view).mean(axis=2), 1e-2)) - logs
        found.append(float(np.median(apart[shown & inside]) - np.median(apart[shown & beside])))
    if len(found) < 2:
        return 0.0
    darkening = -float(np.log(np.maximum(level[inside], settings.black)).mean()) / GAMMA
    return float(np.std(found)) / max(darkening, 1e-3)
