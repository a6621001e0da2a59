"""What photographs show of a chart: where it is there, where one sees through it, and its colours.

Each photograph votes on each texel that it looks at, by its depth there: the surface, something behind it, or
something in front, which is no vote. Colours are those of the photographs that sample a texel finest, which
are near, frontal and sharp at once, with their tone made equal first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.placement import projected
from diga3d_warp.surfaces.chart import Chart, Frame
from diga3d_warp.surfaces.photo import Photo
from diga3d_warp.surfaces.settings import SURFACES, SurfaceSettings


@dataclass(frozen=True, eq=False)
class Look:
    """World positions, such as a chart's texels, in one photograph.

    Attributes:
        column, row: Position [px], the first pixel's centre at 0, float32; -1 outside the image.
        z: Depth of the positions [scene units].
        agrees: Where the photograph's depth is theirs, bool.
        behind: Where its depth lies clearly behind them, bool.
        unseen: Where it looks into what nobody saw, bool.
        known: Where it shows its own colours of them, bool.
    """

    column: np.ndarray
    row: np.ndarray
    z: np.ndarray
    agrees: np.ndarray
    behind: np.ndarray
    unseen: np.ndarray
    known: np.ndarray


def look(
    photo: Photo, points: np.ndarray, settings: SurfaceSettings = SURFACES, normal: np.ndarray | None = None
) -> Look:
    """Find world positions in a photograph.

    Args:
        photo: Where to look.
        points: World space [scene units], shape (..., 3).
        settings: When depths agree.
        normal: Of the surface that they lie on, shape (3,): along a slanted ray a small distance from it is a
            large difference of depths. None for positions of no surface.
    """
    place = projected(points, photo.camera)
    height, width = photo.shape
    column, row, z = place[..., 0] - 0.5, place[..., 1] - 0.5, place[..., 2]
    with np.errstate(invalid="ignore"):
        inside = (column >= 0) & (column <= width - 1) & (row >= 0) & (row <= height - 1)
        inside &= z > photo.camera.near
    column, row = np.where(inside, column, -1.0), np.where(inside, row, -1.0)
    r, c = np.rint(row).astype(int), np.rint(column).astype(int)
    with np.errstate(invalid="ignore", over="ignore"):
        off = np.where(inside & photo.told[r, c], (photo.depth[r, c] - z) / z, np.nan)
        agree = np.full(z.shape, settings.agree)
        if normal is not None:
            away = points - photo.camera.center
            cosine = np.abs(away @ normal) / np.linalg.norm(away, axis=-1)
            agree = np.maximum(agree, settings.off / np.maximum(cosine, settings.grazing))
        agrees, behind = np.abs(off) <= agree, off > settings.through / settings.agree * agree
    return Look(
        column.astype(np.float32), row.astype(np.float32), z, agrees, behind,
        inside & photo.unseen[r, c], agrees & photo.clear[r, c],
    )  # fmt: skip


def density_of(frame: Frame, points: np.ndarray, camera: Camera, settings: SurfaceSettings) -> np.ndarray:
    """Pixels of a camera per texel of a chart, at its texels (H, W, 3) [1]; zero at grazing angles.

    Lengths shrink by the distance, and by the slant in one direction. So a near and frontal photograph counts
    more than one that is far away or slanted.
    """
    away = points - camera.center
    with np.errstate(invalid="ignore", divide="ignore"):
        distance = np.linalg.norm(away, axis=-1)
        cosine = -(away @ frame.axes[2]) / distance
        density = camera.fx * camera.fy * cosine * (frame.texel / distance) ** 2
    return np.where(cosine >= settings.grazing, density, 0.0)


def sampled(photo: Photo, view: Look) -> np.ndarray:
    """A photograph's colours at positions in it, RGB in [0, 1], shape (H, W, 3), float32."""
    import cv2

    place = view.column, view.row
    found = cv2.remap(photo.pixels, *place, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return found.astype(np.float32) / 255.0


class Votes:
    """What photographs say of positions: the surface, or something behind it.

    A place in front of what most photographs show is refused, however it may look from other sides.
    """

    def __init__(self, shape: tuple[int, ...], settings: SurfaceSettings) -> None:
        self.there = np.zeros(shape, np.int32)
        self.behind = np.zeros(shape, np.int32)
        self.unseen = np.zeros(shape, bool)
        self.settings = settings

    def add(self, view: Look, speaks: np.ndarray | bool = True) -> None:
        """Count one photograph, where it speaks."""
        self.there += view.agrees & speaks
        self.behind += view.behind & speaks
        self.unseen |= view.unseen & speaks

    @property
    def through(self) -> np.ndarray:
        """Where photographs show what is behind, bool."""
        there, behind = self._around(self.there), self._around(self.behind)
        told = (self.there + self.behind) > 0
        return told & (behind > self.settings.hidden_votes * (there + behind))

    @property
    def occupied(self) -> np.ndarray:
        """Where the surface is, bool."""
        return ((self.there + self.behind) > 0) & ~self.through

    def _around(self, votes: np.ndarray) -> np.ndarray:
        """Votes summed over the neighbours of a texel; those of single positions as they are."""
        import cv2

        if votes.ndim != 2:
            return votes
        side = (self.settings.votes, self.settings.votes)
        return cv2.boxFilter(votes.astype(np.float32), -1, side, normalize=False)


def refused(points: np.ndarray, photos: Sequence[Photo], settings: SurfaceSettings = SURFACES) -> np.ndarray:
    """Which world positions (P, 3) would hide what photographs show behind them, shape (P,), bool."""
    votes = Votes(points.shape[:-1], settings)
    for photo in photos:
        votes.add(look(photo, points, settings))
    return votes.through


def textured(photos: Sequence[Photo], frame: Frame, settings: SurfaceSettings = SURFACES) -> Chart:
    """The chart of a frame, with the colours and the occupancy that photographs show."""
    points = frame.points
    votes = Votes(frame.size, settings)
    worth = np.zeros(len(photos))
    for number, photo in enumerate(photos):
        view = look(photo, points, settings, frame.axes[2])
        density = density_of(frame, points, photo.camera, settings)
        votes.add(view, density > 0.0)
        shown = view.known & (density > 0.0)
        if shown.any():
            worth[number] = float(np.median(density[shown]))
    occupied, through = votes.occupied, votes.through
    order = np.argsort(-worth, kind="stable")[: settings.views]
    samples, weights = [], []
    for number in order[worth[order] > 0.0]:
        view = look(photos[number], points, settings, frame.axes[2])
        density = density_of(frame, points, photos[number].camera, settings)
        samples.append(sampled(photos[number], view))
        weights.append(np.where(view.known, density, 0.0).astype(np.float32))
    image, shown = blended(samples, weights, settings) if samples else (np.zeros((*frame.size, 3)), occupied)
    known = occupied & shown
    image = np.where(known[..., None], image, 0.0).astype(np.float32)
    wanted = votes.unseen & ~known & ~through
    return Chart(frame, image, known, through, wanted, known.astype(np.float32))


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
    finest = -np.sort(-stacked, axis=0)[min(settings.blended, len(samples)) - 1]
    peak = np.maximum(stacked.max(axis=0), 1e-30)
    colors, total = np.zeros_like(samples[0]), np.zeros(stacked.shape[1:], np.float32)
    for sample, weight in zip(even_tone(samples, stacked), stacked, strict=True):
        share = np.where(weight >= finest, weight / peak, 0.0) ** settings.sharpness
        colors += share[..., None] * sample
        total += share
    return np.clip(colors / np.maximum(total, 1e-30)[..., None], 0.0, 1.0), total > 0.0


TONE_LEAST = 64
"""Texels that two photographs must share for their tones to be compared."""

TONE_MOST = 0.15
"""Largest change of a tone [1]: more is another surface, or light that the chart should keep."""


def even_tone(samples: Sequence[np.ndarray], weights: np.ndarray) -> list[np.ndarray]:
    """Photographs of a chart with the same mean colours where they overlap.

    One offset for each photograph and channel, by least squares over all pairs; the mean change is zero.

    Args:
        samples: Colours of each photograph, shape (H, W, 3).
        weights: Where and how finely each shows the chart, shape (N, H, W); zero where it does not.
    """
    count = len(samples)
    if count < 2:
        return list(samples)
    normal, right = np.zeros((count, count)), np.zeros((count, 3))
    shows = weights > 0.0
    for i in range(count):
        for j in range(i):
            both = shows[i] & shows[j]
            shared = int(both.sum())
            if shared < TONE_LEAST:
                continue
            apart = np.median(samples[j][both] - samples[i][both], axis=0)
            normal[[i, j], [i, j]] += shared
            normal[[i, j], [j, i]] -= shared
            right[i] += shared * apart
            right[j] -= shared * apart
    # Groups of photographs that share nothing keep their own mean: the least-norm solution.
    offsets = np.linalg.lstsq(normal, right, rcond=1e-9)[0]
    offsets = np.clip(offsets, -TONE_MOST, TONE_MOST).astype(np.float32)
    return [sample + offset for sample, offset in zip(samples, offsets, strict=True)]
