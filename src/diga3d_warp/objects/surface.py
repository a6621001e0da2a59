"""The surface of an object: the depth of all its views fused into points with normals.

A fitted splat is a cloud about the surface, and the depth of each view wavers around it. A texture needs one
surface that all views share, or its details would not meet.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from diga3d_warp.errors import InputError
from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.placement import unprojected

FAINT = 0.02
"""Share of a pixel under which an object is not visible [1]; an 8-bit image has steps of 0.004."""


SHADED = 4.0
"""Radius over which normals are averaged before they are lit [spacings]: the depth of a splat dents the
surface at smaller sizes, and light would show every dent."""


APART = 0.1
"""Gap from which parts of a surface are objects of their own [extents of the whole]: smaller ones are hidden
in all views, or thin."""

PART = 0.1
"""Least size of another object [points of the largest]; smaller ones are floaters."""


@dataclass(frozen=True)
class FuseSettings:
    """Thresholds of fusing depth.

    Attributes:
        blur: Deviation of the smoothing of a view's depth before normals are taken of it [px]: depth of a
            splat wavers from gaussian to gaussian, over a few pixels.
        slant: Least cosine between normal and line of sight. Surfaces seen more slanted have depth of little
            worth.
        resolution: Most points across the object; their spacing is its size by this. Finer than the waver of
            depth gains nothing.
        crowd: Pixels behind a point, on average; with fewer pixels in all, points lie further apart.
        smoothing: Rounds in which each point moves to the plane of its neighbours.
        neighbours: How many of them.
        voices: Least number of pixels behind a point, over all views; points with fewer are floaters.
        lone: Least part of the object's area in an image that a connected component has; smaller ones are
            floaters.
    """

    blur: float = 1.5
    slant: float = 0.2
    resolution: int = 72
    crowd: float = 8.0
    smoothing: int = 3
    neighbours: int = 14
    voices: int = 3
    lone: float = 0.03


@dataclass(frozen=True, eq=False)
class Sight:
    """An object as one view shows it.

    Attributes:
        camera: At the size of the image.
        image: The view before the edit, RGB in [0, 1], shape (H, W, 3), float32.
        own: The object's part in the image: its colours times their blending weights, shape (H, W, 3).
        share: The object's blending weight in [0, 1], shape (H, W), float32: under 1 at its rim, and where
            something stands in front.
        depth: z of the object alone [scene units], shape (H, W), float32; 0 where it is not.
        scene_depth: z of all that the view shows [scene units], shape (H, W), float32; 0 where nothing is.
        alpha: Opacity of all that the view shows, shape (H, W), uint8; None where no background is simulated.
    """

    camera: Camera
    image: np.ndarray
    own: np.ndarray
    share: np.ndarray
    depth: np.ndarray
    scene_depth: np.ndarray
    alpha: np.ndarray | None = None

    @property
    def mask(self) -> np.ndarray:
        """Where most of the pixel is the object, shape (H, W), bool."""
        return self.share > 0.5

    @property
    def touched(self) -> np.ndarray:
        """Where any visible part of the pixel is the object, shape (H, W), bool."""
        return (self.share > FAINT) & (self.depth > 0)

    def repainted(self, colors: np.ndarray) -> np.ndarray:
        """The view with other colours on the object, shape (H, W, 3), float32 in [0, 1].

        Args:
            colors: RGB in [0, 1] of the object, shape (H, W, 3); read where `touched`.
        """
        share = np.where(self.touched, self.share, 0.0)[..., None]
        rest = self.image - np.where(share > 0, self.own, 0.0)
        return np.clip(rest + share * colors, 0.0, 1.0).astype(np.float32)

    @property
    def shown(self) -> np.ndarray:
        """Colours of the image's pixels, those that show more background left out, shape (P, 3)."""
        return (self.image if self.alpha is None else self.image[self.alpha > 127]).reshape(-1, 3)

    @property
    def points(self) -> np.ndarray:
        """World position behind each touched pixel, shape (P, 3), in the order of `touched`."""
        return unprojected(self.depth, self.camera)[self.touched]


@dataclass(frozen=True, eq=False)
class Surface:
    """Points on the surface of an object.

    Attributes:
        points: World space [scene units], shape (M, 3), float64.
        normals: Outer unit normals, shape (M, 3).
        colors: Mean colour of the pixels that showed them, display RGB in [0, 1], shape (M, 3).
        spacing: Distance between neighbours, about [scene units].
    """

    points: np.ndarray
    normals: np.ndarray
    colors: np.ndarray
    spacing: float

    @cached_property
    def _tree(self):
        from scipy.spatial import cKDTree

        return cKDTree(self.points)

    def nearest(self, places: np.ndarray, count: int = 8) -> tuple[np.ndarray, np.ndarray]:
        """Feet on the surface of places near it, and the normals there, both shape (P, 3).

        Args:
            places: World space, shape (P, 3).
            count: Points that each foot is found from.
        """
        distance, index = self._tree.query(places, k=np.arange(1, min(count, len(self.points)) + 1))
        width = distance[:, :1] + 0.5 * self.spacing
        weight = np.exp(-0.5 * ((distance - distance[:, :1]) / width) ** 2)
        weight /= weight.sum(axis=1, keepdims=True)
        middle = (weight[..., None] * self.points[index]).sum(axis=1)
        normal = unit((weight[..., None] * self.normals[index]).sum(axis=1))
        return places - normal * ((places - middle) * normal).sum(axis=1, keepdims=True), normal

    def smooth_normals(self, places: np.ndarray) -> np.ndarray:
        """Normals near places (P, 3), averaged over `SHADED` spacings: without the waver of depth."""
        return self._coarse.nearest(places, 4)[1]

    def blurred(self, values: np.ndarray, radius: float) -> np.ndarray:
        """Values at its points, shape (M,), averaged over a radius [spacings] around each."""
        reach = self._tree.sparse_distance_matrix(self._tree, radius * self.spacing, output_type="coo_matrix")
        weight = np.exp(-0.5 * (reach.data / (0.5 * radius * self.spacing)) ** 2)
        total = np.bincount(reach.row, weight, len(values))
        return np.bincount(reach.row, weight * values[reach.col], len(values)) / np.maximum(total, 1e-12)

    def interpolated(self, values: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Values at its points, shape (M,), between them at places near it (P, 3), shape (P,)."""
        distance, index = self._tree.query(places, k=np.arange(1, min(4, len(self.points)) + 1))
        weight = 1.0 / (distance + 0.1 * self.spacing)
        return (weight * values[index]).sum(axis=1) / weight.sum(axis=1)

    def parts(self) -> list[Surface]:
        """Parts that stand apart by more than `APART`, the largest first; specks are left out."""
        from scipy.sparse.csgraph import connected_components

        reach = max(APART * float(np.ptp(self.points, axis=0).max()), 3.0 * self.spacing)
        near = self._tree.sparse_distance_matrix(self._tree, reach, output_type="coo_matrix")
        number, label = connected_components(near, directed=False)
        sizes = np.bincount(label, minlength=number)
        kept = [k for k in np.argsort(-sizes, kind="stable") if sizes[k] >= PART * sizes.max()]
        return [
            Surface(self.points[label == k], self.normals[label == k], self.colors[label == k], self.spacing)
            for k in kept
        ]

    @cached_property
    def _coarse(self) -> Surface:
        normals = np.stack([self.blurred(self.normals[:, k], SHADED) for k in range(3)], axis=-1)
        return Surface(self.points, unit(normals + 1e-9 * self.normals), self.colors, self.spacing)


def fuse(sights: Sequence[Sight], settings: FuseSettings | None = None) -> Surface:
    """One surface from what all views show of an object.

    Raises:
        InputError: no view shows enough of the object.
    """
    settings = settings or FuseSettings()
    parts = [_seen(sight, settings) for sight in sights]
    points, normals, colors = (np.concatenate([part[k] for part in parts]) for k in range(3))
    if len(points) < settings.neighbours:
        raise InputError(
            "the object's gaussians show in no view: mask an object that the fitted splat has, or fit longer"
        )
    low, high = np.percentile(points, [1, 99], axis=0)
    # The sides of a box of one size have 6 resolution^2 cells; of a slim object, seen from one side, a third.
    affordable = np.sqrt(len(points) / (2.0 * settings.crowd))
    spacing = max(float((high - low).max()), 1e-9) / min(settings.resolution, affordable)
    cell = np.floor((points - low) / spacing).astype(np.int64)
    _, group, count = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
    group = group.reshape(-1)

    def mean(values: np.ndarray) -> np.ndarray:
        sums = np.stack([np.bincount(group, values[:, k], len(count)) for k in range(3)], -1)
        return (sums / count[:, None])[count >= settings.voices]

    voiced = mean(points)
    if len(voiced) < settings.neighbours:
        raise InputError("the object is too small in every view: use a larger --image-scale or another mask")
    surface = Surface(voiced, unit(mean(normals)), mean(colors), spacing)
    for _ in range(settings.smoothing):
        surface = Surface(*surface.nearest(surface.points, settings.neighbours), surface.colors, spacing)
    return surface


def pixel_width(sights: Sequence[Sight]) -> float:
    """Width of a pixel at the object's distance, the median over all views [scene units]."""
    shown = [sight for sight in sights if sight.mask.any()]
    return float(np.median([np.median(sight.depth[sight.mask]) / sight.camera.fy for sight in shown]))


def without_floaters(share: np.ndarray, settings: FuseSettings | None = None) -> np.ndarray:
    """The blending weight of an object (H, W) without small parts that lie apart."""
    import cv2

    lone = (settings or FuseSettings()).lone
    count, label, stats, _ = cv2.connectedComponentsWithStats(
        (share > FAINT).astype(np.uint8), connectivity=8
    )
    area = stats[:, cv2.CC_STAT_AREA]
    keep = area >= lone * max(int(area[1:].sum()), 1) if count > 1 else np.zeros(1, bool)
    keep[0] = False
    return np.where(keep[label], share, 0.0).astype(np.float32)


def _seen(sight: Sight, settings: FuseSettings) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, normals and colours of the pixels that show the object well, each shape (P, 3)."""
    import cv2

    inside = cv2.erode((sight.mask & (sight.depth > 0)).astype(np.uint8), np.ones((3, 3), np.uint8))
    inside = inside.astype(np.float32)
    blurred = cv2.GaussianBlur(np.where(inside > 0, sight.depth, 0).astype(np.float32), (0, 0), settings.blur)
    share = cv2.GaussianBlur(inside, (0, 0), settings.blur)
    smooth = blurred / np.maximum(share, 1e-6)
    places = unprojected(smooth, sight.camera)
    across, down = np.gradient(places, axis=1), np.gradient(places, axis=0)
    normal = unit(np.cross(down, across))
    to_eye = unit(sight.camera.center - places)
    facing = (normal * to_eye).sum(axis=2)
    well = (inside > 0) & (facing > settings.slant)
    return places[well], normal[well], sight.image[well]


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors of length 1 along the last axis; zero stays zero."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
