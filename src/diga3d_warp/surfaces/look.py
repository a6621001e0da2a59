"""World positions, such as a chart's texels, in a photograph."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.placement import projected
from diga3d_warp.surfaces.chart import Frame
from diga3d_warp.surfaces.photo import Photo
from diga3d_warp.surfaces.settings import SURFACES, SurfaceSettings


@dataclass(frozen=True, eq=False)
class Look:
    """World positions, such as a chart's texels, in one photograph.

    Attributes:
        column, row: Position [px], the first pixel's centre at 0, float32; -1 outside the image.
        z: Depth of the positions [scene units].
        agrees: Where the photograph's depth is theirs, bool.
        behind: Where its depth lies clearly behind them, bool.
        before: Where it shows something before them, by its depth, bool.
        unseen: Where it looks into what nobody saw, bool.
        clear: Where it shows its own colours of something, bool.
    """

    column: np.ndarray
    row: np.ndarray
    z: np.ndarray
    agrees: np.ndarray
    behind: np.ndarray
    before: np.ndarray
    unseen: np.ndarray
    clear: np.ndarray

    @property
    def known(self) -> np.ndarray:
        """Where it shows its own colours of them, bool."""
        return self.agrees & self.clear


def look(
    photo: Photo, points: np.ndarray, settings: SurfaceSettings = SURFACES, normal: np.ndarray | None = None
) -> Look:
    """Find world positions in a photograph.

    Args:
        photo: Where to look.
        points: World space [scene units], shape (..., 3).
        settings: When depths agree.
        normal: Of the surface that they lie on, shape (3,): along a slanted ray a small distance from it is a
            large difference of depths. None for positions of no surface.
    """
    place = projected(points, photo.camera)
    height, width = photo.shape
    column, row, z = place[..., 0] - 0.5, place[..., 1] - 0.5, place[..., 2]
    with np.errstate(invalid="ignore"):
        inside = (column >= 0) & (column <= width - 1) & (row >= 0) & (row <= height - 1)
        inside &= z > photo.camera.near
    column, row = np.where(inside, column, -1.0), np.where(inside, row, -1.0)
    r, c = np.rint(row).astype(int), np.rint(column).astype(int)
    with np.errstate(invalid="ignore", over="ignore"):
        off = np.where(inside & photo.told[r, c], (photo.depth[r, c] - z) / z, np.nan)
        agree = np.full(z.shape, settings.agree)
        if normal is not None:
            agree = tolerance(points - photo.camera.center, normal, settings)
        agrees, before = np.abs(off) <= agree, (off < -agree) & photo.clear[r, c]
        behind = off > settings.through / settings.agree * agree
    return Look(
        column.astype(np.float32), row.astype(np.float32), z, agrees, behind, before,
        inside & photo.unseen[r, c], inside & photo.clear[r, c],
    )  # fmt: skip


def tolerance(away: np.ndarray, normal: np.ndarray, settings: SurfaceSettings = SURFACES) -> np.ndarray:
    """Difference of depths within which a photograph shows a surface [ratio], shape (...).

    Args:
        away: Lines of sight, shape (..., 3).
        normal: Of the surface, or one for each line, shape (..., 3).
        settings: When depths agree.
    """
    cosine = np.abs((away * normal).sum(axis=-1)) / np.linalg.norm(away, axis=-1)
    return np.maximum(settings.agree, settings.off / np.maximum(cosine, settings.grazing))


def density_of(frame: Frame, points: np.ndarray, camera: Camera, settings: SurfaceSettings) -> np.ndarray:
    """Pixels of a camera per texel of a chart, at its texels (H, W, 3) [1]; zero at grazing angles.

    Lengths shrink by the distance, and by the slant in one direction. So a near and frontal photograph counts
    more than one that is far away or slanted.
    """
    away = points - camera.center
    with np.errstate(invalid="ignore", divide="ignore"):
        distance = np.linalg.norm(away, axis=-1)
        cosine = -(away @ frame.axes[2]) / distance
        density = camera.fx * camera.fy * cosine * (frame.texel / distance) ** 2
    return np.where(cosine >= settings.grazing, density, 0.0)


def sampled(photo: Photo, view: Look) -> np.ndarray:
    """A photograph's colours at positions in it, RGB in [0, 1], shape (H, W, 3), float32."""
    import cv2

    place = view.column, view.row
    found = cv2.remap(photo.pixels, *place, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return found.astype(np.float32) / 255.0
