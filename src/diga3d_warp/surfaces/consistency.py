"""Photo-consistency: whether photographs show one thing where the depth of a view says that it is.

Kutulakos and Seitz 2000, "A theory of shape by space carving": a point of a surface has about one colour in
all photographs that see it. Where the depth of a splat is wrong, each of them shows something else there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from diga3d_warp.splatting.placement import unprojected
from diga3d_warp.surfaces.look import look, sampled
from diga3d_warp.surfaces.photo import Photo
from diga3d_warp.surfaces.settings import AGREEMENT, SURFACES


def consistent(photo: Photo, asked: np.ndarray, photos: Sequence[Photo], instead: np.ndarray) -> np.ndarray:
    """Where other photographs agree on what a view's depth shows, shape (H, W), bool.

    They agree where they differ by less among themselves than from what else may be there.

    Args:
        photo: Whose depth is asked about.
        asked: Pixels, shape (H, W), bool; nothing is said of others.
        photos: All views. The nearest of them are compared, those that see what the depth shows.
        instead: What else may be there, RGB in [0, 1], shape (H, W, 3).
    """
    found = np.zeros_like(asked)
    asked = asked & photo.solid
    if not asked.any():
        return found
    rows, columns = np.flatnonzero(asked.any(axis=1)), np.flatnonzero(asked.any(axis=0))
    window = slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)
    asked = asked[window]
    points = unprojected(
        np.where(asked, photo.depth[window], 1.0), photo.camera, (np.mgrid[window][0], np.mgrid[window][1])
    )
    count = np.zeros(asked.shape, np.float32)
    total, squares = np.zeros((*asked.shape, 3)), np.zeros((*asked.shape, 3))
    for other in _nearest(photo, photos):
        view = look(other, points)
        shown = view.known & asked
        color = np.where(shown[..., None], sampled(other, view), 0.0)
        count += shown
        total += color
        squares += color**2
    several = count >= AGREEMENT.witnesses
    mean = total / np.maximum(count, 1.0)[..., None]
    among = (squares - count[..., None] * mean**2) / np.maximum(count - 1.0, 1.0)[..., None]
    apart = (mean - instead[window]) ** 2
    among, apart = (smoothed(each.sum(axis=2), several) for each in (among, apart))
    found[window] = several & (apart > AGREEMENT.tone**2) & (among < AGREEMENT.apart**2 * apart)
    return found


def smoothed(values: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Means of values (H, W) or (H, W, C) over small windows, of the pixels (H, W) that count; 0 without."""
    import cv2

    side = (SURFACES.votes, SURFACES.votes)
    weight = where.astype(np.float32)
    each = weight if values.ndim == 2 else weight[..., None]
    total = cv2.blur(values.astype(np.float32) * each, side, borderType=cv2.BORDER_CONSTANT)
    share = np.maximum(cv2.blur(weight, side, borderType=cv2.BORDER_CONSTANT), 1e-6)
    return total / (share if values.ndim == 2 else share[..., None])


def _nearest(photo: Photo, photos: Sequence[Photo]) -> list[Photo]:
    """The other photographs, the nearest first, no more than are compared."""
    others = [other for other in photos if other.camera is not photo.camera]
    others.sort(key=lambda other: float(np.linalg.norm(other.camera.center - photo.camera.center)))
    return others[: AGREEMENT.views]
