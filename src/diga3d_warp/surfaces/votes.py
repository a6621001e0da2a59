"""What photographs say of a surface: that it is there, or that they see something behind it.

Each photograph votes on each texel that it looks at, by its depth there: the surface, something behind it, or
something in front, which is no vote. Where photographs agree on the plane of a chart, what they agree on
stands against depth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diga3d_warp.surfaces.agreement import Agreement, Grey, agreement
from diga3d_warp.surfaces.chart import Frame
from diga3d_warp.surfaces.look import Look, density_of, look
from diga3d_warp.surfaces.parts import border_labels, rimmed
from diga3d_warp.surfaces.photo import Photo
from diga3d_warp.surfaces.planes import mean_eye
from diga3d_warp.surfaces.settings import AGREEMENT, SURFACES, AgreementSettings, SurfaceSettings
from diga3d_warp.surfaces.sweep import spread


class Votes:
    """Votes by depth.

    A place in front of what most photographs show is refused, however it may look from other sides.
    """

    def __init__(self, shape: tuple[int, ...], settings: SurfaceSettings) -> None:
        self.there = np.zeros(shape, np.int32)
        self.behind = np.zeros(shape, np.int32)
        self.before = np.zeros(shape, np.int32)
        self.settings = settings

    def add(self, view: Look, speaks: np.ndarray | bool = True) -> None:
        """Count one photograph, where it speaks."""
        self.there += view.agrees & speaks
        self.behind += view.behind & speaks
        self.before += view.before & speaks

    @property
    def told(self) -> np.ndarray:
        """Where any photograph says something, bool."""
        return (self.there + self.behind) > 0

    @property
    def covered(self) -> np.ndarray:
        """Where photographs show nothing but things in front, bool."""
        return ~self.told & (self.before > 0)

    @property
    def through(self) -> np.ndarray:
        """Where photographs show what is behind, bool."""
        there, behind = self._around(self.there), self._around(self.behind)
        return self.told & (behind > self.settings.hidden_votes * (there + behind))

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


@dataclass(frozen=True, eq=False)
class Polled:
    """What photographs say of a chart's texels.

    Attributes:
        occupied: Where the surface is, shape (H, W), bool.
        through: Where they show what is behind it, shape (H, W), bool; apart from `occupied`.
        covered: Where they show nothing but things in front of it, shape (H, W), bool.
        unseen: Where some look into what nobody saw, shape (H, W), bool.
        finest: Pixels per texel of the photograph that sees it finest, shape (H, W), float32.
        worth: Median of that over what each photograph shows, shape (N,); zero for those that show nothing.
        brightness: Median brightness of the photographs, shape (H, W), float32, NaN where few show it; None
            where depth tells whether a photograph shows the surface.
    """

    occupied: np.ndarray
    through: np.ndarray
    covered: np.ndarray
    unseen: np.ndarray
    finest: np.ndarray
    worth: np.ndarray
    brightness: np.ndarray | None = None

    @property
    def deep(self) -> bool:
        """Whether depth is right on the surface."""
        return self.brightness is None

    def on(self, frame: Frame) -> Polled:
        """The same on a frame of another resolution."""
        if frame.size == self.occupied.shape:
            return self
        return Polled(
            _grown(self.occupied, frame), _grown(self.through, frame), _grown(self.covered, frame),
            _grown(self.unseen, frame), _grown(self.finest, frame), self.worth,
            None if self.brightness is None else _grown(self.brightness, frame),
        )  # fmt: skip

    def shown(self, view: Look, colors: np.ndarray, how: AgreementSettings = AGREEMENT) -> np.ndarray:
        """Where a photograph shows the surface, by its depth and its colours (H, W, 3), shape (H, W)."""
        import cv2

        if self.brightness is None:
            return view.known
        grey = cv2.cvtColor(np.ascontiguousarray(colors, np.float32), cv2.COLOR_RGB2GRAY)
        off = cv2.blur(np.where(np.isfinite(self.brightness), grey - self.brightness, 1.0), (5, 5))
        return view.clear & self.occupied & (np.abs(off) <= how.tone)


def poll(
    photos: Sequence[Photo],
    frame: Frame,
    settings: SurfaceSettings = SURFACES,
    how: AgreementSettings = AGREEMENT,
) -> Polled:
    """Ask all photographs about a chart."""
    points = frame.points
    votes, worth = Votes(frame.size, settings), np.zeros(len(photos))
    unseen, finest = np.zeros(frame.size, bool), np.zeros(frame.size)
    for number, photo in enumerate(photos):
        view = look(photo, points, settings, frame.axes[2])
        density = density_of(frame, points, photo.camera, settings)
        votes.add(view, density > 0.0)
        unseen |= view.unseen & (density > 0.0)
        shown = (view.clear if frame.agreed else view.known) & (density > 0.0)
        finest = np.maximum(finest, np.where(view.unseen | shown, density, 0.0))
        if shown.any():
            worth[number] = float(np.median(density[shown]))
    through = votes.through
    occupied, covered = votes.told & ~through, votes.covered
    compared = _compared(frame, points, photos, how) if frame.agreed else None
    if compared is None:
        return Polled(occupied, through, covered, unseen, finest.astype(np.float32), worth)
    alike, brightness = compared.alike, compared.brightness
    with np.errstate(invalid="ignore"):
        agreed = alike >= how.alike_there
        differing = (alike < how.unlike) & (compared.unlike > how.differing)
    # Depth that says what photographs agree on is finer than their windows, and wrong in spots.
    if not agreed.any() or float(occupied[agreed].mean()) >= how.depth_right:
        wrong = _spots(through, agreed)
        if rimmed(wrong, occupied | through, unseen & ~occupied & ~through):
            wrong = np.zeros_like(wrong)
        return Polled(occupied | wrong, through & ~wrong, covered, unseen, finest.astype(np.float32), worth)
    differing |= _elsewhere(frame, photos, compared, how)
    occupied = np.isfinite(brightness) & ~differing
    return Polled(
        occupied, through & differing, covered & ~occupied, unseen, finest.astype(np.float32), worth,
        compared.brightness,
    )  # fmt: skip


def _elsewhere(frame: Frame, photos: Sequence[Photo], here: Agreement, how: AgreementSettings) -> np.ndarray:
    """Where photographs are more alike on planes before or behind a chart, shape (H, W), bool."""
    coarse = frame.coarser(how.swept)
    points, center = coarse.points, mean_eye([photo.camera for photo in photos])
    most = np.full(coarse.size, -np.inf, np.float32)
    for share in how.sweep:
        found = _compared(coarse, points + share * (center - points), photos, how)
        if found is not None:
            most = np.fmax(most, found.alike)
    with np.errstate(invalid="ignore"):
        return _grown(most, frame) > np.nan_to_num(here.alike, nan=np.inf) + how.gain


def _compared(
    frame: Frame, points: np.ndarray, photos: Sequence[Photo], how: AgreementSettings
) -> Agreement | None:
    """How alike photographs are over a chart; None if few show it."""
    chosen = spread(points.reshape(-1, 3), frame.axes[2], [photo.camera for photo in photos], how)
    if len(chosen) < how.views_least:
        return None
    middle = points[points.shape[0] // 2, points.shape[1] // 2]
    samples = []
    for number in chosen:
        camera = photos[number].camera
        pixels = frame.texel * camera.fx / float(np.linalg.norm(camera.center - middle))
        level = min(max(round(np.log2(max(pixels, 1.0))), 0), how.levels)
        samples.append(Grey.of(photos[number]).smaller(level).at(points))
    return agreement(samples, [2 * int(how.window * times / 2.0) + 1 for times in how.grown], how)


def _spots(through: np.ndarray, agreed: np.ndarray) -> np.ndarray:
    """Spots of `through`, most of which photographs agree to be of the surface, shape (H, W), bool.

    Windows reach over a surface's edge, so that what comes to the chart's border is no spot.
    """
    import cv2

    count, label = cv2.connectedComponents(through.astype(np.uint8), connectivity=4)
    share = np.bincount(label.ravel(), agreed.ravel(), count) / np.bincount(label.ravel(), minlength=count)
    wrong = share > 0.5
    wrong[border_labels(label)] = False
    return wrong[label]


def _grown(values: np.ndarray, frame: Frame) -> np.ndarray:
    import cv2

    size = frame.size[::-1]
    if values.dtype == bool:
        return cv2.resize(values.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    return cv2.resize(values, size, interpolation=cv2.INTER_LINEAR)
