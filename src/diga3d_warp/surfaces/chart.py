"""A chart: a surface behind the hole as an image in its own metric coordinates.

Texel (row, column) lies at `origin + u * across + v * down + height * normal`, with u and v in scene units.
The height is zero on a plane.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.placement import Pixels, pixel_rays
from diga3d_warp.surfaces.bend import Bend
from diga3d_warp.surfaces.planes import Plane
from diga3d_warp.surfaces.settings import BENDS, LAYOUT, SURFACES, SurfaceSettings


@dataclass(frozen=True, eq=False)
class Frame:
    """Where a chart lies.

    Attributes:
        origin: World space [scene units], shape (3,).
        axes: Unit vectors across, down and along the normal, towards the cameras, shape (3, 3).
        low: Least u and v [scene units], shape (2,): the outer corner of the first texel.
        texel: Side of a texel [scene units].
        size: Height and width [texels].
        bend: Height of the surface over the plane; None where it is flat.
        agreed: Whether photographs tell it from the planes beside it.
    """

    origin: np.ndarray
    axes: np.ndarray
    low: np.ndarray
    texel: float
    size: tuple[int, int]
    bend: Bend | None = None
    agreed: bool = False

    def height(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Height of the surface over its plane at u and v [scene units]."""
        if self.bend is None:
            return np.zeros_like(u)
        return self.bend.height(self.origin + u[..., None] * self.axes[0] + v[..., None] * self.axes[1])

    @property
    def points(self) -> np.ndarray:
        """World position of every texel's centre, shape (H, W, 3), float64."""
        rows, columns = self.size
        u = self.low[0] + (np.arange(columns) + 0.5) * self.texel
        v = self.low[1] + (np.arange(rows) + 0.5) * self.texel
        u, v = np.meshgrid(u, v)
        local = np.stack([u, v, self.height(u, v)], axis=-1)
        return self.origin + local @ self.axes

    def coarser(self, side: int) -> Frame:
        """The same range with no more texels on the longer side."""
        shrink = max(self.size) / side
        if shrink <= 1.0:
            return self
        rows, columns = (max(int(np.ceil(length / shrink)), 1) for length in self.size)
        return replace(self, texel=self.texel * shrink, size=(rows, columns))

    def coordinates(self, points: np.ndarray) -> np.ndarray:
        """u, v and distance from the plane of world positions (..., 3) [scene units]."""
        return (points - self.origin) @ self.axes.T

    def texels(self, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Column and row of u and v, the first texel's centre at 0 [texels]."""
        return (u - self.low[0]) / self.texel - 0.5, (v - self.low[1]) / self.texel - 0.5

    @property
    def plane(self) -> Plane:
        """The plane of height zero."""
        normal = self.axes[2]
        return Plane(normal, float(normal @ self.origin), np.zeros((0, 3)))

    def meet(
        self, camera: Camera, settings: SurfaceSettings = SURFACES, at: Pixels | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where the rays of a camera meet the surface.

        Args:
            camera: Of any lens.
            settings: What is a grazing angle.
            at: Some pixels instead of all.

        Returns:
            Column and row in the chart [texels], and z along the camera's axis [scene units], each shape
            (H, W), float64, or that of the pixels; NaN where they do not, or at a grazing angle.
        """
        rays = pixel_rays(camera, at).astype(np.float64)
        pose = camera.pose
        directions = np.concatenate([rays, np.ones_like(rays[..., :1])], axis=-1) @ pose[:3, :3]
        start, along = self.coordinates(camera.center), directions @ self.axes.T
        z = self.plane.depth(camera, settings, at)
        u, v = start[0] + along[..., 0] * z, start[1] + along[..., 1] * z
        if self.bend is not None:
            for _ in range(BENDS.steps):
                with np.errstate(divide="ignore", invalid="ignore"):
                    z = z + (self.height(u, v) - (start[2] + along[..., 2] * z)) / along[..., 2]
                u, v = start[0] + along[..., 0] * z, start[1] + along[..., 1] * z
            z = np.where(z > camera.near, z, np.nan)
        column, row = self.texels(u, v)
        return column, row, z


@dataclass(frozen=True, eq=False)
class Chart:
    """A surface as an image.

    Attributes:
        frame: Where it lies.
        image: RGB in [0, 1], shape (H, W, 3), float32; valid where `known`, and in a filled chart where it is
            occupied.
        known: Where photographs show the surface, shape (H, W), bool.
        through: Where photographs show what is behind it, shape (H, W), bool; apart from `known`.
        wanted: What the hole shows of it and nobody saw, shape (H, W), bool; apart from both.
        alpha: Occupancy in [0, 1], shape (H, W), float32: 1 where known, 0 where seen through; in the rest a
            fill decides, and before it is zero.
        trusted: Whether it may be shown in the hole; otherwise it only hides what is behind it.
        deep: Whether the splat's depth is right on it. On a glossy floor it is not, and photographs tell.
        covered: Where photographs show only things in front of it, shape (H, W), bool; None in a saved one.
    """

    frame: Frame
    image: np.ndarray
    known: np.ndarray
    through: np.ndarray
    wanted: np.ndarray
    alpha: np.ndarray
    trusted: bool = True
    deep: bool = True
    covered: np.ndarray | None = None

    def filled(self, image: np.ndarray, alpha: np.ndarray) -> Chart:
        """The chart with other colours and occupancy where they were not known."""
        return replace(
            self,
            image=np.where(self.known[..., None], self.image, image).astype(np.float32),
            alpha=np.where(self.known, 1.0, np.where(self.through, 0.0, alpha)).astype(np.float32),
        )


def frame_on(
    plane: Plane, camera: Camera, low: np.ndarray | None = None, high: np.ndarray | None = None,
    texel: float | None = None, settings: SurfaceSettings = SURFACES,
) -> Frame:  # fmt: skip
    """A frame on a plane, upright as a camera sees it.

    Args:
        plane: Of the chart.
        camera: Whose x axis the chart's rows follow.
        low, high: Range of u and v around the middle of the plane's support [scene units], each shape (2,);
            that of the support if None.
        texel: Side of a texel [scene units]; if None, so that there are 128 on the longer side.
        settings: Largest number of texels.
    """
    normal = plane.normal
    turned = axes_on(normal, camera)
    middle = np.median(plane.support, axis=0)
    origin = middle - normal * (normal @ middle - plane.offset)
    if low is None or high is None:
        local = (plane.support - origin) @ turned.T
        low, high = np.quantile(local[:, :2], 0.01, axis=0), np.quantile(local[:, :2], 0.99, axis=0)
    return sized(
        Frame(origin, turned, low, 1.0, (1, 1), plane.bend, plane.agreed), low, high, texel, settings
    )


def axes_on(normal: np.ndarray, camera: Camera) -> np.ndarray:
    """Unit vectors across and down, as a camera sees a plane upright, and its normal, shape (3, 3)."""
    right, below = (axis - normal * (axis @ normal) for axis in camera.pose[:2, :3])
    # Seen from the front, both axes follow the image: a chart is not mirrored.
    if np.linalg.norm(right) > 0.5:
        across = right / np.linalg.norm(right)
        down = np.cross(across, normal)
    else:
        down = below / np.linalg.norm(below)
        across = np.cross(normal, down)
    return np.stack([across, down, normal])


def sized(
    frame: Frame, low: np.ndarray, high: np.ndarray, texel: float | None, settings: SurfaceSettings = SURFACES
) -> Frame:
    """A frame with another range of u and v, and another texel, made larger where there would be too many."""
    span = np.maximum(high - low, 1e-9 * max(float((high - low).max()), 1e-300))
    texel = texel or float(span.max()) / LAYOUT.coarse
    texel = max(texel, float(np.sqrt(span[0] / settings.texels * span[1])))
    while (size := np.maximum(np.ceil(span / texel), 1.0)).prod() > settings.texels:
        texel *= 1.02
    return replace(frame, low=np.asarray(low, np.float64), texel=texel, size=(int(size[1]), int(size[0])))
