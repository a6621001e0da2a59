"""Whether cameras, photographs and points share one frame.

Points are projected into the photographs. Where few of them are in view, or their colours have nothing to do
with the pixels that they fall on, poses or points are wrong, and every later step would fit noise.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from diga3d_warp.errors import InputError
from diga3d_warp.scene.checks.frame_suspects import POSES, Suspect, point_suspects
from diga3d_warp.scene.photographs.names import listed
from diga3d_warp.scene.scene import Points, View
from diga3d_warp.scene.visible_points import visible_points


@dataclass(frozen=True)
class FrameSettings:
    """Thresholds of the check, measured on three real captures and a synthetic room.

    Attributes:
        views: Number of views that are examined, spread over the capture. The check then takes about 20 ms.
        points: Number of points that are examined, chosen at random.
        per_cell: Of about this many neighbouring points only the nearest is used: the others may be occluded.
            On a capture of a stone bear this raises the correlation from 0.65 to 0.82.
        image_side: Longer side of the reduced photographs that colours are taken from [px]. A sparse point
            has the colour of a few pixels of the full photograph, and may be off by as many.
        seen_least: Share of the points that some view must see, unless their colours agree. Real captures
            reach 0.99, and 0.88 where a third of the photographs is left; wrong ones mostly 0.
        few: With fewer points there is no check.
        colored: Least number of distinct points for comparing colours: fewer may agree by chance.
        agrees: Correlation of colours of points and pixels from which a frame is right. Real captures reach
            0.49 to 0.82, splats at the start of a fit 0.36.
        disagrees: Correlation below which a frame is wrong, if colours are informative; between both, a note
            is given. Wrong ones reach -0.1 to 0.21: walls are light and floors dark wherever one looks.
        better: A suspect must raise the correlation by this much. Suspects of right captures stay 0.5 below.
        incoherent: Colours are not informative if those of neighbouring points differ by this share of the
            variance between any two: randomly initialised points have 1, real ones 0.27 to 0.59.
        blind_view: A view that sees less than this share of the points, while the median view sees
            `usual_view`, is noted.
        triangulated: Fewer triangulated points a view than this are few, and the suspects are tried. Captures
            without texture have few, too.
        triangulated_better: A suspect must give this many times the points.
    """

    views: int = 12
    points: int = 4000
    per_cell: int = 8
    image_side: int = 256
    seen_least: float = 0.1
    few: int = 8
    colored: int = 50
    agrees: float = 0.35
    disagrees: float = 0.25
    better: float = 0.25
    incoherent: float = 0.85
    blind_view: float = 0.002
    usual_view: float = 0.05
    triangulated: float = 3.0
    triangulated_better: float = 4.0


FRAME = FrameSettings()


@dataclass(frozen=True)
class Agreement:
    """How well points fit the photographs.

    Attributes:
        correlation: Of the colours of points and of the pixels that they fall on, less their means in each
            view, in [-1, 1]; NaN where either has one colour only.
        colored: Distinct points that were compared.
        seen: Share of the points that at least one view sees.
        in_front: Share of the points that lie in front of a camera, mean over the views.
        by_view: Share of the points that each view sees.
    """

    correlation: float
    colored: int
    seen: float
    in_front: float
    by_view: Sequence[float]

    @property
    def tells(self) -> bool:
        """Whether the colours are informative."""
        return self.colored >= FRAME.colored and math.isfinite(self.correlation)

    @property
    def fits(self) -> bool:
        """Whether colours agree, however many of the points lie in view: a scan may reach far beyond."""
        return self.tells and self.correlation >= FRAME.agrees


def check_frame(
    views: Mapping[str, View], points: Points, source: Path, name: str, convention: str
) -> list[str]:
    """Refuse a capture whose points do not project onto matching pixels of its photographs.

    Args:
        views: Views by key, with the cameras as read.
        points: Sparse points as read, or centres and colours of a splat.
        source: File or folder with the poses, named in errors.
        name: Name of the points in errors, such as "the sparse points".
        convention: How poses are written in this layout, from `CONVENTIONS`.

    Returns:
        Notes on what may be wrong: colours that agree little, single views that see none of the points.

    Raises:
        InputError: the points are behind the cameras, out of view, or of other colours than the photographs.
            The line names the suspect under which they fit, if one does.
    """
    if len(points) < FRAME.few:
        return []
    chosen = np.random.default_rng(0).permutation(len(points))[: FRAME.points]
    sample = Points(points.positions[chosen], points.colors[chosen])
    spread = np.unique(np.linspace(0, len(views) - 1, FRAME.views).astype(int))
    some = [_reduced(view) for view in np.array(list(views.values()), object)[spread]]
    read = agreement(some, sample)
    notes = []
    if not read.fits:
        _refuse_if_wrong(read, some, sample, f"{source}: {name}", convention)
        if read.tells and _coherent(sample):
            notes.append(
                f"the colours of {name} hardly match the photographs (correlation {read.correlation:.2f}): "
                "they may be of another frame"
            )
    if blind := _blind(views, sample):
        notes.append(
            f"{len(blind)} of {len(views)} views see none of {name}: {listed(blind)}; their poses may be "
            "wrong"
        )
    return notes


def agreement(views: Sequence[View], points: Points) -> Agreement:
    """Project points into views and compare colours. Pixels are taken where the points fall, so views may be
    reduced; their cameras must fit their pixels."""
    seen = np.zeros(len(points), bool)
    compared = np.zeros(len(points), bool)
    shares, in_front = [], 0.0
    covariance = np.zeros(3)  # of colours with colours: pixels and points, pixels, points
    for view in views:
        visible = visible_points(view.camera, points.positions)
        seen[visible.index] = True
        shares.append(len(visible.index) / len(points))
        in_front += visible.in_front / len(points) / len(views)
        nearest = visible.nearest(FRAME.per_cell)
        column, row = nearest.place.astype(int).T
        opaque = view.opacity[row, column] > 127
        pixels = view.pixels[row, column][opaque].astype(np.float64)
        colors = points.colors[nearest.index][opaque].astype(np.float64)
        compared[nearest.index[opaque]] = True
        if len(pixels):
            pixels, colors = pixels - pixels.mean(axis=0), colors - colors.mean(axis=0)
            covariance += [(pixels * colors).sum(), (pixels**2).sum(), (colors**2).sum()]
    both = math.sqrt(covariance[1] * covariance[2])
    correlation = covariance[0] / both if both > 0.0 else math.nan
    return Agreement(correlation, int(compared.sum()), float(seen.mean()), in_front, shares)


def likely_poses(
    views: Mapping[str, View], found: int, count: Callable[[Mapping[str, View]], int]
) -> Suspect | None:
    """The suspect under which photographs agree in many more points than as read; None if there is none.

    Args:
        views: Views that points were triangulated from, with their cameras as read.
        found: How many points these gave.
        count: Triangulates views with other cameras, and gives the number of points.
    """
    if found >= FRAME.triangulated * len(views):
        return None
    least = max(FRAME.triangulated_better * found, float(FRAME.few))
    best = None
    for suspect in POSES:
        if (points := count(_with_poses(views, suspect))) > least:
            best, least = suspect, points
    return best


def _with_poses(views: Mapping[str, View], suspect: Suspect) -> dict[str, View]:
    return {key: _with_pose(view, suspect) for key, view in views.items()}


def _with_pose(view: View, suspect: Suspect) -> View:
    return replace(view, camera=view.camera.with_pose(suspect.pose(view.camera.pose)))


def _refuse_if_wrong(
    read: Agreement, views: Sequence[View], points: Points, subject: str, convention: str
) -> None:
    suspect = _likely_suspect(read, views, points)
    wrong = _what_is_wrong(read, points)
    if suspect is not None:
        wrong = wrong or f"their colours hardly match the photographs (correlation {read.correlation:.2f})"
        remedy = f"they fit if {suspect.fault}; {convention}"
    elif wrong is not None:
        remedy = (
            "cameras, photographs and points are of different captures, frames or scales: give those of one, "
            "or take the points away to have them triangulated"
        )
    else:
        return
    raise InputError(f"{subject} do not fit the cameras: {wrong}; {remedy}")


def _what_is_wrong(read: Agreement, points: Points) -> str | None:
    """Why the points cannot be where the cameras look; None if they can."""
    if read.seen < FRAME.seen_least and not read.fits:
        if read.in_front < FRAME.seen_least:
            return f"they lie behind the cameras ({1.0 - read.in_front:.0%})"
        return f"{read.seen:.1%} of them lie in view of a photograph"
    if read.tells and read.correlation < FRAME.disagrees and _coherent(points):
        return f"their colours do not match the photographs (correlation {read.correlation:.2f})"
    return None


def _likely_suspect(read: Agreement, views: Sequence[View], points: Points) -> Suspect | None:
    """The suspect under which the points fit best, if they fit clearly better than as read."""
    least = max(FRAME.agrees, read.correlation + FRAME.better) if read.tells else FRAME.agrees
    best = None
    for suspect in (*POSES, *point_suspects()):
        tried = agreement(
            [_with_pose(view, suspect) for view in views],
            replace(points, positions=suspect.points(points.positions)),
        )
        if tried.fits and tried.seen >= FRAME.seen_least and tried.correlation > least:
            best, least = suspect, tried.correlation
    return best


def _coherent(points: Points) -> bool:
    """Whether colours of neighbours are alike, so that colours belong to the places."""
    from scipy.spatial import cKDTree

    colors = points.colors.astype(np.float64)
    _, neighbours = cKDTree(points.positions).query(points.positions, k=2)
    differences = ((colors - colors[neighbours[:, 1]]) ** 2).sum(axis=1).mean()
    return bool(differences < FRAME.incoherent * 2.0 * colors.var(axis=0).sum())


def _blind(views: Mapping[str, View], points: Points) -> list[str]:
    """Keys of the views that see none of the points although most views see many."""
    shares = {
        key: len(visible_points(view.camera, points.positions).index) / len(points)
        for key, view in views.items()
    }
    if np.median(list(shares.values())) < FRAME.usual_view:
        return []
    return [key for key, share in shares.items() if share < FRAME.blind_view]


def _reduced(view: View) -> View:
    import cv2

    height, width = view.pixels.shape[:2]
    scale = min(1.0, FRAME.image_side / max(height, width))
    size = max(1, round(width * scale)), max(1, round(height * scale))
    pixels = cv2.resize(view.pixels, size, interpolation=cv2.INTER_AREA)
    alpha = None if view.alpha is None else cv2.resize(view.alpha, size, interpolation=cv2.INTER_AREA)
    return replace(view, camera=view.camera.resized(*size), pixels=pixels, alpha=alpha, mask=None)
