"""The surface that an object stands on, and which of its gaussians are that surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diga3d_warp.scene.camera import Camera
from diga3d_warp.shadows.settings import SHADOWS, ShadowSettings
from diga3d_warp.surfaces.chart import Frame, frame_on, sized
from diga3d_warp.surfaces.planes import Plane


@dataclass(frozen=True, eq=False)
class Solid:
    """Gaussians as points.

    Attributes:
        points: Means [scene units], shape (P, 3), float64.
        widths: Middle standard deviations [scene units], shape (P,).
        opacities: In [0, 1], shape (P,).
    """

    points: np.ndarray
    widths: np.ndarray
    opacities: np.ndarray


@dataclass(frozen=True, eq=False)
class Support:
    """The surface under an object.

    Attributes:
        frame: Its chart, around the object.
        height: Of the object over it [scene units].
        floor: Height under which a gaussian lies on it [scene units].
    """

    frame: Frame
    height: float
    floor: float


def find_support(
    solid: Solid, planes: Sequence[Plane], cameras: Sequence[Camera], settings: ShadowSettings = SHADOWS
) -> Support | None:
    """The plane that the object stands on, of several; None if it stands on none.

    Args:
        solid: The object, perhaps with support around it that its masks held.
        planes: Around the object.
        cameras: That see it.
        settings: How near its foot must be.
    """
    points = solid.points[solid.opacities > settings.opaque]
    if len(points) < 4:
        return None
    best: tuple[float, Plane, float] | None = None
    for plane in planes:
        heights = plane.distances(points)
        tall = float(np.quantile(heights, 0.98))
        if not tall > 0.0 or (heights < -settings.foot * tall).mean() > settings.beneath:
            continue
        foot = abs(float(np.quantile(heights, 0.02))) / tall
        if foot < settings.foot and len(plane.support) and (best is None or foot < best[0]):
            best = foot, plane, tall
    if best is None:
        return None
    _, plane, tall = best
    away = float(np.median([np.linalg.norm(camera.center - points.mean(axis=0)) for camera in cameras]))
    floor = max(settings.floor * tall, min(settings.waver * away, settings.low * tall))
    frame = frame_on(plane, cameras[len(cameras) // 2])
    local = frame.coordinates(points)
    above = local[local[:, 2] > floor]
    if len(above) < 4:
        return None
    middle = np.median(above[:, :2], axis=0)
    width = float(np.quantile(np.abs(above[:, :2] - middle).max(axis=1), 0.98))
    half = width + settings.reach * tall
    return Support(sized(frame, middle - half, middle + half, 2.0 * half / settings.texels), tall, floor)


def on_floor(solid: Solid, support: Support, settings: ShadowSettings = SHADOWS) -> np.ndarray:
    """Which gaussians of an object are not its own but the support around its foot, shape (P,), bool.

    Masks that hold the shadow lift to these. The object's foot is what its lower part stands over. None if
    they are too few to matter.
    """
    import cv2

    local = support.frame.coordinates(solid.points)
    flat = local[:, 2] <= max(support.floor, settings.near_floor * support.height)
    low = (local[:, 2] > support.floor) & (local[:, 2] < settings.low * support.height)
    low &= solid.opacities > settings.opaque
    found = np.zeros(len(flat), bool)
    if low.sum() < 3 or not flat.any():
        return found
    hull = cv2.convexHull(_largest(local[low, :2], support.floor).astype(np.float32))
    middle = hull.mean(axis=0)
    margin = 2.0 * float(np.median(solid.widths[low])) + support.floor
    reach = np.linalg.norm(hull - middle, axis=2).max()
    hull = middle + (hull - middle) * np.float32(1.0 + margin / max(float(reach), 1e-12))
    inside = np.array(
        [cv2.pointPolygonTest(hull, (float(u), float(v)), False) >= 0.0 for u, v in local[flat, :2]]
    )
    found[np.flatnonzero(flat)[~inside]] = True
    return found if found.mean() >= settings.held else np.zeros_like(found)


def _largest(places: np.ndarray, joined: float) -> np.ndarray:
    """Places (P, 2) in the largest groups that hang together: feet, and no floaters over the shadow."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    pairs = cKDTree(places).query_pairs(joined, output_type="ndarray")
    count = len(places)
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    label = connected_components(graph, directed=False)[1]
    sizes = np.bincount(label)
    return places[sizes[label] >= 0.5 * sizes.max()]
