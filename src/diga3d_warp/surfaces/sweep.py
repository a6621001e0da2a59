"""Planes on which photographs agree: a plane's slant and offset under which warped photographs are alike.

The depth of a splat is poor on surfaces that are glossy or have little texture. Photographs still show a
tile's joints in one place of the plane, and in different places of any other plane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.placement import projected, unprojected
from diga3d_warp.surfaces.agreement import Agreement, Grey, agreement
from diga3d_warp.surfaces.chart import axes_on
from diga3d_warp.surfaces.look import look
from diga3d_warp.surfaces.photo import Photo
from diga3d_warp.surfaces.planes import Plane, mean_eye
from diga3d_warp.surfaces.settings import AGREEMENT, SURFACES, AgreementSettings, SurfaceSettings


def agreed_planes(
    planes: Sequence[Plane],
    guesses: Sequence[Plane],
    photos: Sequence[Photo],
    seed: int,
    settings: SurfaceSettings = SURFACES,
    how: AgreementSettings = AGREEMENT,
) -> list[Plane]:
    """Planes as photographs see them; those that photographs contradict are left out.

    Args:
        planes: Found in depth: kept as they are where photographs tell nothing.
        guesses: Found among few points: kept only where photographs agree on them.
        photos: All views.
        seed: Of the choice of pixels.
        settings: When two planes are one.
        how: Thresholds of the agreement.
    """
    rng = np.random.default_rng(seed)
    greys = [Grey.of(photo) for photo in photos]
    kept: list[Plane] = []
    for guess in guesses:
        if not any(_same(guess, other, photos, settings) for other in kept):
            found = guess if guess.bend is not None else refined(guess, photos, greys, rng, settings, how)
            if found is not None and found.agreed:
                kept.append(found)
    for plane in planes:
        same = [number for number, other in enumerate(kept) if _same(plane, other, photos, settings)]
        if same:
            support = np.concatenate([kept[same[0]].support, plane.support])
            kept[same[0]] = replace(kept[same[0]], support=support)
            continue
        # What is contradicted may be near a plane that is not: worth the time only while none is known.
        known = any(each.agreed for each in kept)
        found = (
            plane if plane.bend is not None else refined(plane, photos, greys, rng, settings, how, not known)
        )
        if found is not None and not any(_same(found, other, photos, settings) for other in kept):
            kept.append(found)
    return kept


def refined(
    plane: Plane,
    photos: Sequence[Photo],
    greys: Sequence[Grey],
    rng: np.random.Generator,
    settings: SurfaceSettings = SURFACES,
    how: AgreementSettings = AGREEMENT,
    far: bool = True,
) -> Plane | None:
    """The plane near another one on which photographs agree best.

    Args:
        plane: Where to begin.
        photos: All views.
        greys: The same reduced to brightness.
        rng: Chooses pixels.
        settings: How near its points it must stay.
        how: Thresholds.
        far: Also look where photographs contradict the plane to begin with.

    Returns:
        The plane as it was where photographs do not tell it from planes beside it. None where they contradict
        it.
    """
    from scipy.optimize import minimize

    patch = _patch(plane, photos, greys, rng, how)
    if patch is None:
        return plane
    at = np.zeros(3)
    if not far and patch.contradicted(at, how):
        return None
    for level in patch.levels(how):
        unit = patch.unit(level)

        def unlike(step: np.ndarray, level: int = level, unit: np.ndarray = unit) -> float:
            return -patch.agreement(step * unit, level, how).total(how)

        start = at / unit
        simplex = np.concatenate([start[None], start + how.step * np.eye(3)])
        options = {"maxfev": how.steps, "initial_simplex": simplex, "xatol": 0.05, "fatol": 1e-3}
        found = minimize(unlike, start, method="Nelder-Mead", options=options)
        at = found.x * unit
        if -found.fun < how.unlike:
            return None if patch.contradicted(np.zeros(3), how) else plane
    moved = replace(patch.plane(at), support=plane.support)
    # From one side, other planes look alike as well; the points that it was found by are on none of these.
    eye = mean_eye([photo.camera for photo in photos])
    for place, candidate in ((at, moved), (np.zeros(3), plane)):
        if _held(candidate, plane, eye, settings) and patch.stands_out(place, how):
            return replace(candidate, agreed=True)
    return plane


def _held(moved: Plane, plane: Plane, eye: np.ndarray, settings: SurfaceSettings) -> bool:
    """Whether a plane holds about as many of the points that another one was fitted to."""
    limit = settings.tolerance * np.linalg.norm(plane.support - eye, axis=1)
    now, before = (np.abs(each.distances(plane.support)) < limit for each in (moved, plane))
    return bool(now.sum() >= settings.held * before.sum())


@dataclass(frozen=True, eq=False)
class _Patch:
    """The part of a plane around the hole, in the photographs that are compared.

    Attributes:
        center: Middle of what the hole shows of the plane [scene units], shape (3,).
        axes: Across, down and along the normal, shape (3, 3).
        photos: Photographs.
        greys: The same reduced to brightness.
        pixel: What a pixel of them covers there [scene units].
        distance: Of the cameras [scene units].
        reach: How far the hole reaches from the middle [scene units].
        side: Texels on each side.
    """

    center: np.ndarray
    axes: np.ndarray
    photos: Sequence[Photo]
    greys: Sequence[Grey]
    pixel: float
    distance: float
    reach: float
    side: int

    def levels(self, how: AgreementSettings) -> list[int]:
        """Halvings of the photographs, the coarsest first: the finest still shows the hole's surroundings."""
        ratio = how.around * self.reach / (self.side * self.pixel)
        smallest = min(min(grey.pixels.shape) for grey in self.greys)
        coarsest = max(int(np.log2(max(smallest / how.smallest, 1.0))), 0)
        finest = min(max(round(np.log2(max(ratio, 1.0))), 1), coarsest)
        return list(range(min(finest + how.levels - 1, coarsest), finest - 1, -1))

    def unit(self, level: int) -> np.ndarray:
        """Steps of offset and slants that move the border by a texel."""
        return np.array([self.pixel * 2.0**level, 2.0 / self.side, 2.0 / self.side])

    def points(self, at: np.ndarray, level: int) -> np.ndarray:
        """World positions of the texels of a plane at some offset and slants, shape (side, side, 3)."""
        steps = (np.arange(self.side) - 0.5 * (self.side - 1)) * self.pixel * 2.0**level
        u, v = np.meshgrid(steps, steps)
        height = at[0] + at[1] * u + at[2] * v
        return self.center + np.stack([u, v, height], axis=-1) @ self.axes

    def agreement(self, at: np.ndarray, level: int, how: AgreementSettings) -> Agreement:
        """How alike photographs are on the plane."""
        points = self.points(at, level)
        samples = [grey.smaller(level).at(points) for grey in self.greys]
        return agreement(samples, [how.window], how)

    def stands_out(self, at: np.ndarray, how: AgreementSettings) -> bool:
        """Whether photographs are more alike on the plane than on those before and behind it."""
        level = self.levels(how)[-1]
        shift = np.array([how.beside * self.distance, 0.0, 0.0])
        best, *beside = (
            self.agreement(place, level, how).total(how) for place in (at, at - shift, at + shift)
        )
        return best >= max(how.alike_least, max(beside) + how.gain)

    def contradicted(self, at: np.ndarray, how: AgreementSettings) -> bool:
        """Whether photographs differ where depth says that they show the plane."""
        level = self.levels(how)[-1]
        points = self.points(at, level)
        samples = [
            np.where(look(photo, points, normal=self.axes[2]).agrees, grey.smaller(level).at(points), np.nan)
            for photo, grey in zip(self.photos, self.greys, strict=True)
        ]
        found = agreement([sample.astype(np.float32) for sample in samples], [how.window], how)
        told = float(np.isfinite(found.alike).mean())
        return told >= how.told and found.total(how) < how.unlike

    def plane(self, at: np.ndarray) -> Plane:
        normal = np.array([-at[1], -at[2], 1.0]) @ self.axes
        normal /= np.linalg.norm(normal)
        return Plane(normal, float(normal @ (self.center + at[0] * self.axes[2])), np.zeros((0, 3)))


def _patch(
    plane: Plane,
    photos: Sequence[Photo],
    greys: Sequence[Grey],
    rng: np.random.Generator,
    how: AgreementSettings,
) -> _Patch | None:
    hits = _hits(plane, photos, rng, how)
    if len(hits) < how.views_least:
        return None
    center = np.median(hits, axis=0)
    reach = float(np.median(np.linalg.norm(hits - center, axis=1)))
    chosen = spread(center[None], plane.normal, [photo.camera for photo in photos], how)
    if len(chosen) < how.views_least:
        return None
    cameras = [photos[number].camera for number in chosen]
    distances = [float(np.linalg.norm(camera.center - center)) for camera in cameras]
    pixel = float(np.median([d / c.fx for d, c in zip(distances, cameras, strict=True)]))
    return _Patch(
        center, axes_on(plane.normal, cameras[0]), [photos[number] for number in chosen],
        [greys[number] for number in chosen], pixel, float(np.median(distances)), reach, how.side,
    )  # fmt: skip


def _hits(
    plane: Plane, photos: Sequence[Photo], rng: np.random.Generator, how: AgreementSettings
) -> np.ndarray:
    """Where rays into the hole meet the plane [scene units], shape (P, 3)."""
    found = [np.zeros((0, 3))]
    for photo in photos:
        rows, columns = np.nonzero(photo.unseen)
        if len(rows) == 0:
            continue
        some = rng.integers(0, len(rows), how.rays)
        at = rows[some], columns[some]
        world = unprojected(plane.depth(photo.camera, at=at), photo.camera, at)
        found.append(world[np.isfinite(world).all(axis=1)])
    return np.concatenate(found)


def spread(
    points: np.ndarray, normal: np.ndarray, cameras: Sequence[Camera], how: AgreementSettings = AGREEMENT
) -> list[int]:
    """Numbers of the cameras that are compared: they see the middle of some points, from all directions."""
    center = np.median(points, axis=0)
    numbers, directions, apart = [], [], []
    for number, camera in enumerate(cameras):
        away = camera.center - center
        distance = float(np.linalg.norm(away))
        if away @ normal < how.grazing * distance:
            continue
        column, row, z = projected(center[None], camera)[0]
        off = np.array([column / camera.width, row / camera.height]) - 0.5
        if z > camera.near and np.abs(off).max() <= 0.5 + how.outside:
            numbers.append(number)
            directions.append(away / distance)
            apart.append(distance)
    if not numbers:
        return []
    chosen = [int(np.argmin(apart))]
    nearest = np.linalg.norm(np.array(directions) - directions[chosen[0]], axis=1)
    while len(chosen) < min(how.views, len(numbers)):
        chosen.append(int(np.argmax(nearest)))
        nearest = np.minimum(nearest, np.linalg.norm(np.array(directions) - directions[chosen[-1]], axis=1))
    return [numbers[k] for k in dict.fromkeys(chosen)]


def _same(one: Plane, other: Plane, photos: Sequence[Photo], settings: SurfaceSettings) -> bool:
    """Whether two planes are one, up to the waver of depth."""
    angle, distance = settings.apart
    if abs(float(one.normal @ other.normal)) <= np.cos(np.radians(angle)):
        return False
    eyes = np.array([photo.camera.center for photo in photos])
    away = float(np.median(np.linalg.norm(eyes[:, None] - one.support[None, ::16], axis=2)))
    return float(np.median(np.abs(other.distances(one.support)))) < distance * settings.tolerance * away
