"""What charts show of each view's hole: one story for all of them, with its depth.

What no chart explains, a far background or a thing behind the object, is left to the fill of references.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from diga3d_warp.propagation.fill import Fill
from diga3d_warp.propagation.tone import rim_of, tone_between
from diga3d_warp.propagation.unseen import OPAQUE, Background
from diga3d_warp.scene.scene import View
from diga3d_warp.surfaces.chart import Chart
from diga3d_warp.surfaces.compose import compose
from diga3d_warp.surfaces.consistency import consistent, smoothed
from diga3d_warp.surfaces.photo import Photo
from diga3d_warp.surfaces.settings import AGREEMENT, SURFACES


@dataclass(frozen=True, eq=False)
class Charted:
    """A view whose hole shows charts.

    Attributes:
        background: With charts in the image, and only the rest of it unseen.
        depth: z without the object, that of the charts where they show [scene units], shape (H, W), float32.
        shown: Where charts show in what was unseen, shape (H, W), bool.
    """

    background: Background
    depth: np.ndarray
    shown: np.ndarray

    def completed(self, fill: Fill) -> Fill:
        """The fill, and the charts where it has none."""
        taken = self.shown & ~fill.filled
        return replace(
            fill,
            image=np.where(taken[..., None], self.background.image, fill.image).astype(np.float32),
            depth=np.where(taken, self.depth, fill.depth).astype(np.float32),
            filled=fill.filled | taken,
            missing=fill.missing & ~taken,
        )

    def under(self, fill: Fill) -> Fill:
        """The fill on the surfaces of the charts."""
        return replace(fill, depth=np.where(self.shown, self.depth, fill.depth).astype(np.float32))


def photo_of(view: View, background: Background, depth: np.ndarray) -> Photo:
    """A view as surfaces are found in it.

    Args:
        view: The photograph.
        background: What is known behind the object.
        depth: z of the splat without the object [scene units], shape (H, W); 0 where it shows nothing.
    """
    known = ~(background.unseen | background.observed)
    if view.alpha is not None:
        depth = np.where(known & (view.alpha < 255 - OPAQUE), np.inf, depth).astype(np.float32)
        known = known & (view.alpha >= OPAQUE)
    return Photo(view.camera, view.pixels, depth, known, background.unseen)


def chart_views(
    views: Sequence[View],
    backgrounds: Sequence[Background],
    depths: Sequence[np.ndarray],
    charts: Sequence[Chart],
) -> list[Charted]:
    """Put charts into the holes of all views; arguments as `chart_view`, one each per view."""
    seen = list(zip(views, backgrounds, depths, strict=True))
    photos = [photo_of(*each) for each in seen]
    return [chart_view(*each, charts, photos) for each in seen]


def chart_view(
    view: View, background: Background, depth: np.ndarray, charts: Sequence[Chart], photos: Sequence[Photo]
) -> Charted:
    """Put charts into a view's hole, in the tone that the view itself has around it.

    What other photographs show in front of a chart keeps their colours.

    Args:
        view: The photograph.
        background: What is known behind the object.
        depth: z of the splat without the object [scene units], shape (H, W); 0 where it shows nothing.
        charts: Filled ones.
        photos: All views, from `photo_of`.
    """
    unseen = background.unseen
    nothing = Charted(background, depth, np.zeros_like(unseen))
    if not charts or not unseen.any():
        return nothing
    layer = compose(charts, view.camera)
    # The last one stands for no chart.
    trusted = np.array([*(chart.trusted for chart in charts), False])
    same = np.abs(layer.depth - depth) <= SURFACES.agree * layer.depth
    agreed = np.array([*(chart.frame.agreed for chart in charts), False])
    # What was looked up behind the object by depth that is wrong is no better known than the chart. It stays
    # where it stands on the chart or in front of it, and photographs bear it out.
    looked_up = background.observed & _doubtful(charts)[layer.chart]
    in_front = looked_up & (depth <= (1.0 + SURFACES.agree) * layer.depth)
    kept = consistent(photo_of(view, background, depth), in_front, photos, layer.image)
    hole = unseen | (looked_up & ~kept)
    same |= agreed[layer.chart] & _alike(layer.image, background.image, ~hole)
    shown = _bordered(hole & trusted[layer.chart], layer.chart, same, ~hole)
    if not shown.any():
        return nothing
    # Around the hole the view and the charts show the same surface: there their tones can be compared.
    rim = rim_of(hole) & (layer.chart >= 0) & same
    tone = tone_between(background.image, layer.image, rim, shown)
    image = background.image.astype(np.float32).copy()
    image[shown] = np.clip(layer.image + tone, 0.0, 1.0)[shown]
    return Charted(
        replace(background, unseen=unseen & ~shown, image=image, observed=background.observed | shown),
        np.where(shown, layer.depth, depth).astype(np.float32), shown,
    )  # fmt: skip


def photos_of(
    views: Sequence[View],
    backgrounds: Sequence[Background],
    depths: Sequence[np.ndarray],
    charts: Sequence[Chart],
) -> list[Photo]:
    """All views as gaussians that are added are held against them; arguments as `chart_views`.

    Their depth is that of the splat; where it is wrong on a chart that a view shows, it is the chart's.
    """
    if all(chart.deep for chart in charts):
        return [photo_of(*each) for each in zip(views, backgrounds, depths, strict=True)]
    charted = chart_views(views, backgrounds, depths, charts)
    return [_shown_by(*each, charts) for each in zip(views, charted, strict=True)]


def _shown_by(view: View, charted: Charted, charts: Sequence[Chart]) -> Photo:
    photo = photo_of(view, charted.background, charted.depth)
    layer = compose(charts, view.camera)
    on = _doubtful(charts)[layer.chart] & _alike(layer.image, charted.background.image, photo.known)
    return replace(photo, depth=np.where(on, layer.depth, photo.depth).astype(np.float32))


def _doubtful(charts: Sequence[Chart]) -> np.ndarray:
    """On which charts the splat's depth is wrong, shape (N + 1,), bool; the last stands for no chart."""
    return np.array([*(not chart.deep for chart in charts), False])


def _alike(one: np.ndarray, other: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Where two images (H, W, 3) are alike up to tone, by what is known (H, W), shape (H, W), bool."""
    off = smoothed(one - other, known)
    return known & (np.abs(off).max(axis=2) <= 2.0 * AGREEMENT.tone)


def _bordered(shown: np.ndarray, chart: np.ndarray, same: np.ndarray, known: np.ndarray) -> np.ndarray:
    """The parts of charts that continue what the view shows at their border.

    A part that lies mostly among a nearer surface is not seen through it: that surface has no chart, or an
    edge that was not found.

    Args:
        shown: Where charts would show, shape (H, W), bool.
        chart: Number of the chart at each pixel, shape (H, W).
        same: Where the view shows the surface of that chart, shape (H, W), bool.
        known: Where the view shows anything, shape (H, W), bool.
    """
    from scipy.ndimage import binary_dilation, label

    kept = shown.copy()
    for number in np.unique(chart[shown]):
        parts, count = label(shown & (chart == number))
        for index in range(1, count + 1):
            part = parts == index
            border = binary_dilation(part, iterations=2) & ~part & known
            agreeing = same & (chart == number)
            if border.any() and agreeing[border].mean() < SURFACES.bordered:
                kept &= ~part
    return kept
