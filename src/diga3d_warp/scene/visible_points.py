"""Projection of points into a camera with its lens: pixels and depths of those inside the image."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from diga3d_warp.process import load_pycolmap
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.colmap.models import colmap_lens


@dataclass(frozen=True, eq=False)
class VisiblePoints:
    """Points inside an image, whether or not something hides them.

    Attributes:
        index: Rows of the points, shape (N,), int64.
        place: Projected positions [px], shape (N, 2), float64.
        depth: Depth along the viewing direction [scene units], shape (N,), float64; positive.
        in_front: How many points lie in front of the camera, inside the image or not.
    """

    index: np.ndarray
    place: np.ndarray
    depth: np.ndarray
    in_front: int

    def nearest(self, per_cell: float) -> VisiblePoints:
        """The nearest point of each cell of the image; points behind it may be occluded.

        Args:
            per_cell: Mean number of points in a cell.
        """
        if not len(self.index):
            return self
        low, high = np.quantile(self.place, [0.05, 0.95], axis=0)
        size = math.sqrt(max(float((high - low).prod()), 1.0) * per_cell / len(self.index))
        cells = (self.place / size).astype(np.int64)
        order = np.lexsort((self.depth, cells[:, 0], cells[:, 1]))
        changes = (np.diff(cells[order], axis=0) != 0).any(axis=1)
        first = order[np.concatenate([[True], changes])]
        return VisiblePoints(self.index[first], self.place[first], self.depth[first], self.in_front)


def visible_points(camera: Camera, positions: np.ndarray) -> VisiblePoints:
    """Project points into an image.

    Args:
        camera: Camera of the image.
        positions: World space [scene units], shape (P, 3), float64.
    """
    pose = camera.pose
    local = positions @ pose[:3, :3].T + pose[:3, 3]
    front = np.flatnonzero(local[:, 2] > 0.0)
    directions = local[front, :2] / local[front, 2:]
    place = _pixels(camera, directions)
    inside = ((place >= 0.0) & (place < [camera.width, camera.height])).all(axis=1)
    index = front[inside]
    return VisiblePoints(index, place[inside], local[index, 2], len(front))


def _pixels(camera: Camera, directions: np.ndarray) -> np.ndarray:
    """Pixels of normalised camera coordinates, shape (N, 2); NaN beyond the reach of the lens."""
    lens = camera.distortion
    if lens is None:
        return directions * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    from diga3d_warp.kernels.cameras import valid_radius

    place = np.full(directions.shape, np.nan)
    reached = np.hypot(*directions.T) <= valid_radius(lens.kind, lens.coefficients)
    if reached.any():
        model, parameters = colmap_lens(camera)
        colmap_camera = load_pycolmap().Camera(
            model=model, width=camera.width, height=camera.height, params=parameters
        )
        ahead = np.concatenate([directions[reached], np.ones((int(reached.sum()), 1))], axis=1)
        place[reached] = colmap_camera.img_from_cam(ahead)
    return place
