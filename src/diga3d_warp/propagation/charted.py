"""What charts show of each view's hole: one story for all of them, with its depth.

What no chart explains, a far background or a thing behind the object, is left to the fill of references.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from diga3d_warp.propagation.fill import Fill
from diga3d_warp.propagation.tone import rim_of, tone_between
from diga3d_warp.propagation.unseen import OPAQUE, Background
from diga3d_warp.scene.scene import View
from diga3d_warp.splatting.placement import unprojected
from diga3d_warp.surfaces.chart import Chart
from diga3d_warp.surfaces.compose import Layer, compose
from diga3d_warp.surfaces.consistency import consistent, smoothed
from diga3d_warp.surfaces.look import tolerance
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
    """Put charts into the holes of all views, in the tone that each has around its own.

    What other photographs show in front of a chart keeps their colours.

    Args:
        views: The photographs.
        backgrounds: What is known behind the object, one per view.
        depths: z of the splat without the object, one per view, shape (H, W); 0 where it shows nothing.
        charts: Filled ones.
    """
    seen = list(zip(views, backgrounds, depths, strict=True))
    nothing = [Charted(at, depth, np.zeros_like(at.unseen)) for _, at, depth in seen]
    if not charts:
        return nothing
    photos = [photo_of(*each) for each in seen]
    sights = [_sight(*each, charts, photos) if each[1].unseen.any() else None for each in seen]
    told = sum((_borders(sight, len(charts)) for sight in sights if sight), np.zeros((2, len(charts))))
    share = told[0] / np.maximum(told[1], 1)
    return [
        empty if sight is None else _charted(*each, sight, share)
        for each, sight, empty in zip(seen, sights, nothing, strict=True)
    ]


@dataclass(frozen=True, eq=False)
class _Sight:
    """What a view shows of charts.

    Attributes:
        layer: The charts as its camera sees them.
        hole: What they may fill, shape (H, W), bool.
        offered: Where they would show in it, shape (H, W), bool.
        same: Where the view shows the surface of the chart that lies there, shape (H, W), bool.
    """

    layer: Layer
    hole: np.ndarray
    offered: np.ndarray
    same: np.ndarray

    def parts(self) -> Iterator[tuple[int, np.ndarray, int, int]]:
        """Parts of charts in the hole: number of the chart, mask, known pixels at the border, and how many of
        these show the chart's surface."""
        from scipy.ndimage import binary_dilation, label

        for number in np.unique(self.layer.chart[self.offered]):
            parts, count = label(self.offered & (self.layer.chart == number))
            for index in range(1, count + 1):
                part = parts == index
                border = binary_dilation(part, iterations=2) & ~part & ~self.hole
                agreeing = border & self.same & (self.layer.chart == number)
                yield int(number), part, int(border.sum()), int(agreeing.sum())


def _sight(
    view: View, background: Background, depth: np.ndarray, charts: Sequence[Chart], photos: Sequence[Photo]
) -> _Sight:
    layer = compose(charts, view.camera)
    # The last one stands for no chart.
    trusted = np.array([*(chart.trusted for chart in charts), False])
    # What was looked up behind the object by depth that is wrong is no better known than the chart. It stays
    # where it stands on the chart or in front of it, and photographs bear it out.
    looked_up = background.observed & _doubtful(charts)[layer.chart]
    in_front = looked_up & (depth <= (1.0 + SURFACES.agree) * layer.depth)
    kept = consistent(photo_of(view, background, depth), in_front, photos, layer.image)
    hole = background.unseen | (looked_up & ~kept)
    same = _same(layer, view, depth, charts, _alike(layer.image, background.image, ~hole))
    return _Sight(layer, hole, hole & trusted[layer.chart], same)


def _borders(sight: _Sight, count: int) -> np.ndarray:
    """Known pixels at the border of each chart that show it, and all of these, shape (2, count)."""
    found = np.zeros((2, count))
    for number, _, border, agreeing in sight.parts():
        found[:, number] += agreeing, border
    return found


def _charted(
    view: View, background: Background, depth: np.ndarray, sight: _Sight, share: np.ndarray
) -> Charted:
    """A view with the charts that continue what it shows at their border.

    A part that lies mostly among a nearer surface is not seen through it: that surface has no chart, or an
    edge that was not found. What all views show (`share`, one a chart) counts as much as the view itself, so
    that they tell one story.
    """
    shown = sight.offered.copy()
    for number, part, border, agreeing in sight.parts():
        if border and agreeing / border + share[number] < 2.0 * SURFACES.bordered:
            shown &= ~part
    if not shown.any():
        return Charted(background, depth, np.zeros_like(shown))
    layer = sight.layer
    # Around the hole the view and the charts show the same surface: there their tones can be compared.
    rim = rim_of(sight.hole) & (layer.chart >= 0) & sight.same
    tone = tone_between(background.image, layer.image, rim, shown)
    image = background.image.astype(np.float32).copy()
    image[shown] = np.clip(layer.image + tone, 0.0, 1.0)[shown]
    return Charted(
        replace(
            background, unseen=background.unseen & ~shown, image=image, observed=background.observed | shown
        ),
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


def _same(
    layer: Layer, view: View, depth: np.ndarray, charts: Sequence[Chart], alike: np.ndarray
) -> np.ndarray:
    """Where a view shows the surface of the chart that lies there, shape (H, W), bool.

    By depth; where that is not behind the chart, or photographs agree on it, by colours that are alike, too.
    """
    normals = np.stack([*(chart.frame.axes[2] for chart in charts), np.zeros(3)])
    agreed = np.array([*(chart.frame.agreed for chart in charts), False])
    away = unprojected(np.ones_like(depth), view.camera) - view.camera.center
    near = tolerance(away, normals[layer.chart]) * layer.depth
    off = np.abs(layer.depth - depth)
    unclear = off <= SURFACES.through / SURFACES.agree * near
    return (off <= near) | (alike & (unclear | agreed[layer.chart]))


def _alike(one: np.ndarray, other: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Where two images (H, W, 3) are alike up to tone, by what is known (H, W), shape (H, W), bool."""
    off = smoothed(one - other, known)
    return known & (np.abs(off).max(axis=2) <= 2.0 * AGREEMENT.tone)
