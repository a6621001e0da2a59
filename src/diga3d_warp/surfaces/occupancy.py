"""Where a surface goes on in what nobody saw, and where it ends: straight boundaries are continued.

A table's edge, a step, a wall's end: where the boundary between a surface and what photographs see through
beside it lies on one or two lines, these go on behind the object. So does that of a round table, which is an
ellipse, and that of a plinth of which some corners are seen, a polygon. Where other things stand on it side
by side, as books on a shelf, it ends at the line of their feet. Any other boundary goes on smoothly.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from diga3d_warp.surfaces.membrane import membrane
from diga3d_warp.surfaces.parts import border_labels, rimmed
from diga3d_warp.surfaces.settings import BOUNDARIES


class Occupancy(NamedTuple):
    """Where a surface is.

    Attributes:
        solid: shape (H, W), bool.
        trusted: Whether what photographs tell of the unknown part's surroundings bears the surface out. Depth
            may agree with a plane here and there without one: that of a hedge, or of a floor without texture.
    """

    solid: np.ndarray
    trusted: bool


def occupancy(
    known: np.ndarray, through: np.ndarray, wanted: np.ndarray, seed: int, trusted: float = 0.0,
    agreed: bool = False, covered: np.ndarray | None = None,
) -> Occupancy:  # fmt: skip
    """Occupancy of a chart with its unknown part decided.

    Args:
        known: Where the surface is, shape (H, W), bool.
        through: Where it is not, shape (H, W), bool.
        wanted: What the hole shows of it, shape (H, W), bool: its surroundings decide.
        seed: Of random lines.
        trusted: Least share of surface in what is told around the unknown, and around each part of it [1],
            where no lines explain it. With less it is left alone.
        agreed: Whether photographs agree on the surface: it is there, and only its parts are judged.
        covered: Where photographs show nothing but things in front of it, shape (H, W), bool.

    Returns:
        `known`, and where the rest is taken for surface. Nothing is without a known part.
    """
    if not known.any():
        return Occupancy(known.copy(), False)
    through = through & ~_specks(known, through, wanted)
    if covered is not None and (covered & ~wanted).any():
        found = _by_lines(known, through | (covered & ~wanted), wanted, seed)
        if found is not None:
            return Occupancy(known | (found & ~through), True)
    if not through.any():
        return Occupancy(~through, True)
    found = _by_lines(known, through, wanted, seed)
    if found is None:
        found = _by_ellipse(known, through, wanted, seed)
    told = (known | through) & _near(wanted)
    if found is None and not agreed and known[told].sum() < trusted * told.sum():
        found = _by_polygon(known, through, wanted, seed)
        if found is None:
            return Occupancy(known.copy(), False)
    if found is not None:
        return Occupancy(known | (found & ~through), True)
    inside = _smoothly(known, through) & ~through & ~known
    return Occupancy(known | _borne_out(inside, known, through, trusted), True)


def _specks(known: np.ndarray, through: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Spots of `through` so small and few that depth may be wrong there, shape (H, W), bool."""
    import cv2

    near = _near(wanted)
    told = int(((known | through) & near).sum())
    _, label, stats, _ = cv2.connectedComponentsWithStats(through.astype(np.uint8), connectivity=4)
    small = stats[:, cv2.CC_STAT_AREA] <= BOUNDARIES.speck * told
    # What reaches the chart's border may be a part of more.
    small[border_labels(label)] = False
    found = small[label]
    if (found & near).sum() > BOUNDARIES.specks * told or rimmed(found, known | through, wanted):
        return np.zeros_like(found)
    return found


def _borne_out(inside: np.ndarray, known: np.ndarray, through: np.ndarray, trusted: float) -> np.ndarray:
    """The parts of `inside` around which enough of the surface is known."""
    import cv2

    count, label, stats, _ = cv2.connectedComponentsWithStats(inside.astype(np.uint8), connectivity=8)
    borne = np.zeros_like(inside)
    for number in range(1, count):
        left, top, width, height, area = stats[number].tolist()
        reach = max(int(BOUNDARIES.around * np.sqrt(area)), BOUNDARIES.ring)
        window = (
            slice(max(top - reach, 0), top + height + reach),
            slice(max(left - reach, 0), left + width + reach),
        )
        part = label[window] == number
        box = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
        around = (cv2.dilate(part.astype(np.uint8), box) > 0) & ~part
        there, not_there = int((known[window] & around).sum()), int((through[window] & around).sum())
        told = there + not_there
        if told >= BOUNDARIES.told * around.sum() and there >= trusted * told:
            borne[window] |= part
    return borne


def _by_lines(known: np.ndarray, through: np.ndarray, wanted: np.ndarray, seed: int) -> np.ndarray | None:
    """Occupancy by one or two straight boundaries; None if these do not explain the surroundings."""
    near = _near(wanted)
    told, inside, boundary = _rim(known, through, near)
    share = float(inside.sum()) / max(int(told.sum()), 1)
    if share > BOUNDARIES.explained:
        return np.ones_like(known)
    points = np.argwhere(boundary)[:, ::-1].astype(np.float64)
    if len(points) < BOUNDARIES.least:
        return None
    rng = np.random.default_rng(seed)
    places = np.stack(np.meshgrid(np.arange(known.shape[1]), np.arange(known.shape[0])), axis=-1)
    first = _line(points, rng)
    if first is None:
        return None
    side = _side(first, places, inside, told)
    best, sides = _right(side, inside, told), side
    off = np.abs(points @ first[0] - first[1]) > 2.0 * BOUNDARIES.near
    second = _line(points[off], rng) if off.sum() >= BOUNDARIES.least else None
    if second is not None:
        other = _side(second, places, inside, told & sides)
        for both in (sides & other, sides | _side(second, places, inside, told & ~sides)):
            if (right := _right(both, inside, told)) > best:
                best, side = right, both
    return side if best >= BOUNDARIES.explained else None


def _by_polygon(known: np.ndarray, through: np.ndarray, wanted: np.ndarray, seed: int) -> np.ndarray | None:
    """Occupancy inside a convex polygon, as of a plinth of which the object leaves some corners; None if none
    explains the surroundings.

    The hole may hide a whole side: there, what is seen through tells where it ends.
    """
    told, inside, _ = _rim(known, through, _near(wanted))
    outside = told & ~inside
    rng = np.random.default_rng(seed)
    places = np.stack(np.meshgrid(np.arange(known.shape[1]), np.arange(known.shape[0])), axis=-1)
    side, edges = np.ones_like(known), 0
    for surface in (known, known | wanted):
        boundary = _rim(surface, through, _near(wanted))[2]
        points = np.argwhere(boundary & side)[:, ::-1].astype(np.float64)
        while edges < BOUNDARIES.edges and len(points) >= BOUNDARIES.least:
            line = _line(points, rng)
            if line is None:
                break
            points = points[np.abs(points @ line[0] - line[1]) > 2.0 * BOUNDARIES.near]
            cut = side & _side(line, places, inside, inside & side)
            keeps = (cut & inside).sum() >= BOUNDARIES.explained * (side & inside).sum()
            keeps &= (cut & wanted).sum() >= BOUNDARIES.kept * (side & wanted).sum()
            # Another line along the same side leaves out hardly more.
            if keeps and (cut & outside).sum() < BOUNDARIES.explained * (side & outside).sum():
                side, edges = cut, edges + 1
        if surface is known and edges < BOUNDARIES.corner:
            return None
    shown = (inside & side).sum()
    explained = shown >= BOUNDARIES.explained_round * inside.sum() and shown >= BOUNDARIES.part * side.sum()
    return side if explained else None


def _by_ellipse(known: np.ndarray, through: np.ndarray, wanted: np.ndarray, seed: int) -> np.ndarray | None:
    """Occupancy inside an ellipse, as of a plinth or a round table; None if none explains the surroundings.

    Farther away others may lie in the same plane, as a lawn at a plinth's foot seems to.
    """
    boundary = _rim(known, through, _near(wanted))[2]
    told, inside, _ = _rim(known, through, _near(wanted, BOUNDARIES.close))
    points = np.argwhere(boundary)[:, ::-1].astype(np.float32)
    if len(points) < BOUNDARIES.least:
        return None
    rng = np.random.default_rng(seed)
    longest = BOUNDARIES.widest * max(known.shape)
    best, chosen = 0, None
    for _ in range(BOUNDARIES.lines):
        found = _ellipse(points[rng.choice(len(points), BOUNDARIES.corners, replace=False)], longest)
        if found is not None:
            on = found.off(points) < BOUNDARIES.near
            if on.sum() > best:
                best, chosen = int(on.sum()), on
    if chosen is None or best < BOUNDARIES.round * len(points):
        return None
    found = _ellipse(points[chosen], longest)
    if found is None:
        return None
    places = np.stack(np.meshgrid(np.arange(known.shape[1]), np.arange(known.shape[0])), axis=-1)
    side = found.radius(places) <= 1.0
    return side if _right(side, inside, told) >= BOUNDARIES.explained_round else None


class _Ellipse(NamedTuple):
    """Centre, semi-axes [texels], and the unit vectors along these in the rows of a matrix."""

    center: np.ndarray
    axes: np.ndarray
    turn: np.ndarray

    def radius(self, places: np.ndarray) -> np.ndarray:
        """Distance of places (..., 2) from the centre, 1 on the ellipse."""
        return np.linalg.norm((places - self.center) @ self.turn.T / self.axes, axis=-1)

    def off(self, places: np.ndarray) -> np.ndarray:
        """Distance from the ellipse along the ray from the centre [texels]."""
        radius = np.maximum(self.radius(places), 1e-6)
        return np.linalg.norm(places - self.center, axis=-1) * np.abs(1.0 - 1.0 / radius)


def _ellipse(points: np.ndarray, longest: float) -> _Ellipse | None:
    """The ellipse nearest to points (P, 2) (Fitzgibbon et al. 1999); None if it is too long."""
    import cv2

    center, sides, angle = cv2.fitEllipseDirect(points)
    axes = 0.5 * np.array(sides, np.float64)
    if not (np.isfinite(axes).all() and axes.min() > 1.0 and axes.max() <= longest):
        return None
    turn = np.radians(angle)
    matrix = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    return _Ellipse(np.array(center, np.float64), axes, matrix)


def _rim(
    known: np.ndarray, through: np.ndarray, near: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Near the wanted: what is told, what of it is surface, and the last texels of that."""
    import cv2

    inside = known & near
    boundary = (cv2.dilate(through.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0) & inside
    return (known | through) & near, inside, boundary


def _near(wanted: np.ndarray, share: float = 1.0) -> np.ndarray:
    """The surroundings of what is wanted, as far as a share of its width."""
    import cv2

    reach = max(int(share * np.sqrt(wanted.sum())), 8)
    return cv2.dilate(wanted.astype(np.uint8), np.ones((2 * reach + 1,) * 2, np.uint8)) > 0


def _line(points: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, float] | None:
    """Normal and offset of the line with most of the points (P, 2), fitted to these."""
    ends = rng.integers(0, len(points), (BOUNDARIES.lines, 2))
    along = points[ends[:, 1]] - points[ends[:, 0]]
    length = np.linalg.norm(along, axis=1)
    usable = length > 3.0 * BOUNDARIES.near
    if not usable.any():
        return None
    normals = np.stack([-along[usable, 1], along[usable, 0]], axis=1) / length[usable, None]
    offsets = (normals * points[ends[usable, 0]]).sum(axis=1)
    on = np.abs(points @ normals.T - offsets) < BOUNDARIES.near
    chosen = points[on[:, int(on.sum(axis=0).argmax())]]
    middle = chosen.mean(axis=0)
    normal = np.linalg.svd(chosen - middle, full_matrices=False)[2][1]
    return normal, float(normal @ middle)


def _side(
    line: tuple[np.ndarray, float], places: np.ndarray, inside: np.ndarray, told: np.ndarray
) -> np.ndarray:
    """The side of a line on which the surface is. The line itself runs through the last texels of it."""
    distance = places @ line[0] - line[1]
    positive, negative = distance > -0.5, distance < 0.5
    return positive if _right(positive, inside, told) >= _right(negative, inside, told) else negative


def _right(side: np.ndarray, inside: np.ndarray, told: np.ndarray) -> float:
    return float((side == inside)[told].mean()) if told.any() else 0.0


def _smoothly(known: np.ndarray, through: np.ndarray) -> np.ndarray:
    """Harmonic interpolation of occupancy, cut at a half."""
    import cv2

    height, width = known.shape
    shrink = max(max(height, width) / BOUNDARIES.longest, 1.0)
    size = (max(round(width / shrink), 1), max(round(height / shrink), 1))
    on = cv2.resize(known.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    off = cv2.resize(through.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    told = on + off > 0.25
    if not told.any():
        return np.ones_like(known)
    value = np.where(told, on / np.maximum(on + off, 1e-6), 0.0)
    if not told.all():
        value[~told] = membrane(value[..., None].astype(np.float64), told, ~told)[:, 0]
    return cv2.resize(value.astype(np.float32), (width, height)) >= 0.5
