"""Planes that could continue into the hole: a robust fit over points with normals, one after another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.placement import Pixels, pixel_rays
from diga3d_warp.surfaces.bend import Bend, fit_bend
from diga3d_warp.surfaces.evidence import Evidence
from diga3d_warp.surfaces.settings import BENDS, SEARCH, SURFACES, SurfaceSettings


@dataclass(frozen=True, eq=False)
class Plane:
    """A plane with normal . x = offset.

    Attributes:
        normal: Unit length, towards the cameras, shape (3,), float64.
        offset: Distance of the origin [scene units].
        support: Points that it was fitted to [scene units], shape (P, 3): where it is known to be.
        bend: Height of the surface over the plane; None where it is flat.
        agreed: Whether photographs tell it from the planes beside it.
    """

    normal: np.ndarray
    offset: float
    support: np.ndarray
    bend: Bend | None = None
    agreed: bool = False

    def distances(self, points: np.ndarray) -> np.ndarray:
        """Signed distance of points (..., 3) along the normal [scene units]: positive in front."""
        flat = points @ self.normal - self.offset
        return flat if self.bend is None else flat - self.bend.height(points)

    def depth(
        self, camera: Camera, settings: SurfaceSettings = SURFACES, at: Pixels | None = None
    ) -> np.ndarray:
        """z at which a camera's pixels meet the plane, without its bend, shape (H, W), float64.

        Of some pixels only, where given.
        NaN where a ray misses it, meets it behind the camera, or at a grazing angle: there depth is not
        defined by a pixel. A camera in the plane sees nothing of it.
        """
        rays = pixel_rays(camera, at).astype(np.float64)
        pose = camera.pose
        normal = pose[:3, :3] @ self.normal
        height = float(self.normal @ camera.center - self.offset)
        facing = rays @ normal[:2] + normal[2]
        length = np.sqrt((rays**2).sum(axis=-1) + 1.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            z = -height / facing
            seen = (np.abs(facing) >= settings.grazing * length) & (z > camera.near)
        return np.where(seen, z, np.nan)


def find_planes(
    evidence: Evidence, eye: np.ndarray, seed: int, settings: SurfaceSettings = SURFACES, *,
    bends: bool = True,
) -> list[Plane]:  # fmt: skip
    """The planes with most points, the largest first; points of one are not looked at for the next.

    Args:
        evidence: Points around the hole.
        eye: A place in front of all surfaces, the mean camera [scene units], shape (3,).
        seed: Of the random planes.
        settings: Tolerances and trials.
        bends: Whether to look for surfaces with a height over their plane. Few points bend by chance.
    """
    rng = np.random.default_rng(seed)
    least = max(int(settings.plane_share * len(evidence)), SEARCH.nearest)
    planes: list[Plane] = []
    left = evidence
    for _ in range(SEARCH.searches * settings.planes):
        if len(planes) == settings.planes or len(left) < least:
            break
        found = _best(left, rng, settings)
        inside = _joined(left, _on(found, left, settings), settings)
        if inside.sum() < least:
            if not inside.any():
                break
            left = left.select(~inside)
            continue
        plane = _fitted(left, inside, eye, settings)
        if bends:
            plane = _bent(plane, left, settings)
        near = np.abs(plane.distances(left.points)) < settings.tolerance * left.depths
        inside = _joined(left, near & (_facing(plane.normal, left) >= settings.tilt), settings)
        near = np.abs(plane.distances(left.points)) < 2.0 * settings.tolerance * left.depths
        same = _joined(left, near & (_facing(plane.normal, left) >= settings.tilt), settings)
        if inside.sum() >= least:
            support = left.points[inside]
            _add(planes, replace(plane, support=support), left.depths[inside], settings)
        left = left.select(~(same | inside))
    return planes


def _joined(evidence: Evidence, inside: np.ndarray, settings: SurfaceSettings) -> np.ndarray:
    """The largest part of some points that hang together: planes run on through other things by chance."""
    import cv2

    rows = np.flatnonzero(inside)
    if len(rows) < 2:
        return inside
    points = evidence.points[rows]
    middle = points.mean(axis=0)
    axes = np.linalg.svd(points - middle, full_matrices=False)[2][:2]
    places = (points - middle) @ axes.T
    cell = settings.joined * float(np.median(evidence.depths[rows]))
    low = places.min(axis=0)
    cell = max(cell, float(np.ptp(places, axis=0).max()) / SEARCH.cells, 1e-300)
    at = np.floor((places - low) / cell).astype(int)
    taken = np.zeros(at.max(axis=0) + 1, np.uint8)
    taken[at[:, 0], at[:, 1]] = 1
    near = cv2.dilate(taken, np.ones((3, 3), np.uint8))
    count, part = cv2.connectedComponents(near)
    if count < 3:
        return inside
    own = part[at[:, 0], at[:, 1]]
    largest = int(np.bincount(own).argmax())
    joined = np.zeros_like(inside)
    joined[rows[own == largest]] = True
    return joined


def _bent(plane: Plane, evidence: Evidence, settings: SurfaceSettings) -> Plane:
    """The surface with a height over its plane, where that explains clearly more of what hangs together."""
    scales = settings.tolerance * evidence.depths
    facing = _facing(plane.normal, evidence) >= settings.tilt
    near = facing & (np.abs(plane.distances(evidence.points)) < BENDS.farthest * scales)
    near = _joined(evidence, near, settings)
    flat = _joined(evidence, near & (np.abs(plane.distances(evidence.points)) < scales), settings)
    if near.sum() < max((1.0 + settings.curved_gain) * flat.sum(), SEARCH.nearest):
        return plane
    points = evidence.points[near]
    bend = fit_bend(points, points @ plane.normal - plane.offset, scales[near], plane.normal)
    bent = replace(plane, bend=bend)
    held = near & (np.abs(bent.distances(evidence.points)) < scales)
    return bent if held.sum() > (1.0 + settings.curved_gain) * flat.sum() else plane


def _best(
    evidence: Evidence, rng: np.random.Generator, settings: SurfaceSettings
) -> tuple[np.ndarray, float]:
    """Normal and offset of the random plane with most of the points."""
    from scipy.spatial import cKDTree

    deep = np.asarray(evidence.normals.any(axis=1))  # sparse points have no normal
    checked = evidence.select(np.concatenate([_some(deep, rng), _some(~deep, rng)]))
    first = rng.integers(0, len(checked), settings.trials)
    count = min(SEARCH.nearest, len(checked))
    _, near = cKDTree(checked.points).query(checked.points[first], k=np.arange(1, count + 1))
    far = rng.integers(0, len(checked), (settings.trials, 2))
    close = near[np.arange(settings.trials)[:, None], rng.integers(0, count, (settings.trials, 2))]
    # Near corners find small surfaces, and far ones give large surfaces their exact slant.
    others = np.where((np.arange(settings.trials) % 2 == 0)[:, None], close, far)
    a, b, c = checked.points[first], checked.points[others[:, 0]], checked.points[others[:, 1]]
    normals = np.cross(b - a, c - a)
    own = checked.normals[first]
    normals = np.concatenate([normals, own])
    places = np.concatenate([a, a])
    length = np.linalg.norm(normals, axis=1)
    usable = length > 1e-12 * max(float(np.abs(checked.points).max()), 1e-300) ** 2
    usable[settings.trials :] = length[settings.trials :] > 0.5
    if not usable.any():
        return np.array([0.0, 0.0, 1.0]), np.inf
    normals, places = normals[usable] / length[usable, None], places[usable]
    offsets = (normals * places).sum(axis=1)
    votes = np.abs(checked.points @ normals.T - offsets) < settings.tolerance * checked.depths[:, None]
    facing = np.abs(checked.normals @ normals.T)
    sparse = ~checked.normals.any(axis=1)
    facing[sparse] = 1.0  # sparse points have none
    votes &= facing >= settings.tilt
    # Depth is everywhere, and sparse points are where they are because photographs agree on them.
    shares = votes[~sparse].sum(axis=0) / max(int((~sparse).sum()), 1)
    if sparse.sum() >= SEARCH.nearest:
        shares = shares + votes[sparse].sum(axis=0) / sparse.sum()
    best = int(np.argmax(shares))
    return normals[best], float(offsets[best])


def _some(rows: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Indices of some of the rows, `SEARCH.checked` at most."""
    indices = np.flatnonzero(rows)
    if len(indices) <= SEARCH.checked:
        return indices
    return np.sort(rng.choice(indices, SEARCH.checked, replace=False))


def _facing(normal: np.ndarray, evidence: Evidence) -> np.ndarray:
    """Cosine between a normal and those of the points; 1 where they have none."""
    return np.where(evidence.normals.any(axis=1), np.abs(evidence.normals @ normal), 1.0)


def _on(plane: tuple[np.ndarray, float], evidence: Evidence, settings: SurfaceSettings) -> np.ndarray:
    normal, offset = plane
    near = np.abs(evidence.points @ normal - offset) < settings.tolerance * evidence.depths
    return near & (_facing(normal, evidence) >= settings.tilt)


def _fitted(evidence: Evidence, inside: np.ndarray, eye: np.ndarray, settings: SurfaceSettings) -> Plane:
    """Least squares over the points inside, each weighted by its precision, until these stay the same."""
    normal, offset = np.zeros(3), 0.0
    for _ in range(4):
        points, weights = evidence.points[inside], evidence.depths[inside] ** -2.0
        weights = weights / weights.sum()
        middle = weights @ points
        spread = (points - middle) * np.sqrt(weights)[:, None]
        normal = np.linalg.svd(spread, full_matrices=False)[2][2]
        offset = float(normal @ middle)
        again = _on((normal, offset), evidence, settings)
        if again.sum() < SEARCH.nearest or (again == inside).all():
            break
        inside = again
    if normal @ eye < offset:
        normal, offset = -normal, -offset
    return Plane(normal, offset, evidence.points[inside])


def _add(planes: list[Plane], plane: Plane, depths: np.ndarray, settings: SurfaceSettings) -> None:
    """Keep a plane, unless it is one of those found, up to the waver of depth."""
    angle, distance = settings.apart
    limit = distance * settings.tolerance * float(np.median(depths))
    for other in planes:
        parallel = abs(float(other.normal @ plane.normal)) > np.cos(np.radians(angle))
        if parallel and float(np.median(np.abs(other.distances(plane.support)))) < limit:
            return
    planes.append(plane)


def mean_eye(cameras: Sequence[Camera]) -> np.ndarray:
    """Mean of the camera centres [scene units], shape (3,)."""
    return np.mean([camera.center for camera in cameras], axis=0)
