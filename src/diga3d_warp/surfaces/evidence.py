"""Points around the hole that tell which surfaces could continue into it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diga3d_warp.splatting.placement import projected, unprojected
from diga3d_warp.surfaces.photo import Photo
from diga3d_warp.surfaces.settings import SURFACES, SurfaceSettings


@dataclass(frozen=True, eq=False)
class Evidence:
    """Points on surfaces near the hole.

    Attributes:
        points: World space [scene units], shape (P, 3), float64.
        normals: Unit normals towards the camera, shape (P, 3); zero where not known.
        depths: z in the view that showed them [scene units], shape (P,): the unit of tolerances.
    """

    points: np.ndarray
    normals: np.ndarray
    depths: np.ndarray

    def __len__(self) -> int:
        return len(self.points)

    def select(self, rows: np.ndarray) -> Evidence:
        """Some of the points."""
        return Evidence(self.points[rows], self.normals[rows], self.depths[rows])


def band_of(photo: Photo, settings: SurfaceSettings = SURFACES) -> np.ndarray:
    """Where a view shows surfaces beside what nobody saw, shape (H, W), bool."""
    radius = max(photo.length(settings.band), int(settings.band_share * np.sqrt(photo.unseen.sum())))
    return _widened(photo.unseen, radius) & photo.solid


def _widened(mask: np.ndarray, radius: int) -> np.ndarray:
    import cv2

    return cv2.dilate(mask.astype(np.uint8), np.ones((2 * radius + 1,) * 2, np.uint8)) > 0


def some_of(photos: Sequence[Photo], settings: SurfaceSettings = SURFACES) -> list[Photo]:
    """Photographs spread evenly over their order, no more than are looked at."""
    count = min(settings.views, len(photos))
    return [photos[int((number + 0.5) * len(photos) / count)] for number in range(count)]


def gather(
    photos: Sequence[Photo], sparse: np.ndarray, seed: int, settings: SurfaceSettings = SURFACES
) -> Evidence:
    """Depth, with its normals, in the band around what nobody saw, and the sparse points that lie there.

    Args:
        photos: All views.
        sparse: Positions of the sparse points [scene units], shape (N, 3).
        seed: Of the choice of points.
        settings: Bands and number of points.
    """
    rng = np.random.default_rng(seed)
    shown = some_of([photo for photo in photos if photo.unseen.any()], settings)
    parts = [Evidence(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))]
    each = max(settings.points // max(len(shown), 1), 64)
    for photo in shown:
        band = band_of(photo, settings)
        if not band.any():
            continue
        rim = band & _widened(photo.unseen, photo.length(settings.rim))
        for part in (rim, band & ~rim):
            if part.any():
                parts.append(_of_depth(photo, part, each // 2, rng, settings))
        parts.append(_of_sparse(photo, band, sparse, settings))
    return Evidence(
        np.concatenate([part.points for part in parts]),
        np.concatenate([part.normals for part in parts]),
        np.concatenate([part.depths for part in parts]),
    )


def _of_depth(
    photo: Photo, band: np.ndarray, most: int, rng: np.random.Generator, settings: SurfaceSettings
) -> Evidence:
    import cv2

    near = photo.solid & (photo.depth < settings.farthest * np.median(photo.depth[band]))
    depth = np.where(near, photo.depth, 0.0).astype(np.float32)
    weight = near.astype(np.float32)
    size = (2 * photo.length(2.0) + 1,) * 2
    smooth = cv2.blur(depth, size) / np.maximum(cv2.blur(weight, size), 1e-6)
    # At a step, points of both sides would make a wall of their own.
    band = band & near & (np.abs(smooth - depth) <= settings.agree * depth)
    rows, columns = np.nonzero(band)
    if len(rows) > most:
        chosen = np.sort(rng.choice(len(rows), most, replace=False))
        rows, columns = rows[chosen], columns[chosen]
    points = unprojected(depth[rows, columns], photo.camera, (rows, columns))

    def beside(down: int, right: int) -> np.ndarray:
        at = np.clip(rows + down, 0, depth.shape[0] - 1), np.clip(columns + right, 0, depth.shape[1] - 1)
        return unprojected(smooth[at], photo.camera, at)

    normals = np.cross(beside(1, 0) - beside(-1, 0), beside(0, 1) - beside(0, -1))
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.where(length > 0.0, normals / np.maximum(length, 1e-300), 0.0)
    away = ((photo.camera.center - points) * normals).sum(axis=1) < 0.0
    normals[away] *= -1.0
    finite = np.isfinite(points).all(axis=1) & np.isfinite(normals).all(axis=1)
    return Evidence(points[finite], normals[finite], depth[rows, columns][finite].astype(np.float64))


def _of_sparse(photo: Photo, band: np.ndarray, sparse: np.ndarray, settings: SurfaceSettings) -> Evidence:
    """Sparse points that the band shows: where their depth is that of the splat without the object."""
    place = projected(sparse, photo.camera)
    with np.errstate(invalid="ignore"):
        column, row = np.floor(place[:, 0]), np.floor(place[:, 1])
        inside = (column >= 0) & (column < band.shape[1]) & (row >= 0) & (row < band.shape[0])
    rows, columns, z = row[inside].astype(int), column[inside].astype(int), place[inside, 2]
    there = band[rows, columns] & (np.abs(photo.depth[rows, columns] - z) < settings.through * z)
    points = sparse[inside][there]
    return Evidence(points, np.zeros_like(points), z[there])


def away_from_object(
    photos: Sequence[Photo], sparse: np.ndarray, settings: SurfaceSettings = SURFACES
) -> Evidence:
    """Sparse points around the hole that are not the object's, whatever the depth of the splat.

    Args:
        photos: Views with unseen pixels.
        sparse: Positions of the sparse points [scene units], shape (N, 3).
        settings: Width of the band.
    """
    shown, known, near = (np.zeros(len(sparse), int) for _ in range(3))
    depths = np.zeros(len(sparse))
    for photo in some_of(photos, settings):
        place = projected(sparse, photo.camera)
        with np.errstate(invalid="ignore"):
            column, row = np.floor(place[:, 0]), np.floor(place[:, 1])
            inside = (column >= 0) & (column < photo.shape[1]) & (row >= 0) & (row < photo.shape[0])
            inside &= place[:, 2] > photo.camera.near
        rows, columns = row[inside].astype(int), column[inside].astype(int)
        shown[inside] += 1
        known[inside] += photo.known[rows, columns]
        near[inside] += _widened(photo.unseen, photo.length(settings.sparse_band))[rows, columns]
        depths[inside] += place[inside, 2]
    own = (known > settings.clear_share * shown) & (near > 0)
    points = sparse[own]
    return Evidence(points, np.zeros_like(points), depths[own] / shown[own])
