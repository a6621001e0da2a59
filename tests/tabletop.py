"""Photographs of a patterned plane with exact depth, and a disc on it that nobody saw."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch

from diga3d_warp.scene.camera import Camera, look_at
from diga3d_warp.splatting.placement import unprojected
from diga3d_warp.surfaces.photo import Photo

WIDTH, HEIGHT, FOCAL = 128, 96, 110.0
EYES = [(0.0, -2.6, 2.2), (1.0, -2.4, 2.1), (-0.9, -2.5, 2.3), (0.5, -2.8, 1.9)]
ROUND = [*EYES, (1.6, -1.9, 2.2), (-1.7, -1.8, 2.0), (2.2, 0.6, 2.1), (-2.1, 0.8, 2.3)]
HOLE = 0.4
"""Radius of what nobody saw [m]."""

Pattern = Callable[[np.ndarray, np.ndarray], np.ndarray]


def camera_at(eye: Sequence[float], target: Sequence[float] = (0.0, 0.0, 0.0)) -> Camera:
    pose = torch.from_numpy(look_at(np.array(eye), np.array(target)))
    return Camera(WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, pose, near=0.01)


def checks(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Soft red and blue checks of 0.5 m, RGB."""
    wave = 0.5 + 0.4 * np.sin(2 * np.pi * x / 0.5) * np.sin(2 * np.pi * y / 0.5)
    return np.stack([wave, np.full_like(wave, 0.3), 1.0 - wave], axis=-1)


def tiles(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Grey tiles of 0.45 m with dark joints."""
    joint = np.minimum(np.abs(x / 0.45 % 1.0 - 0.5), np.abs(y / 0.45 % 1.0 - 0.5)) < 0.06
    return np.where(joint[..., None], 0.35, 0.75) * np.ones(3)


def level(camera: Camera, height: float) -> np.ndarray:
    """z at which each pixel meets the plane at a height, shape (H, W); infinite where it does not."""
    at_one = unprojected(np.ones((camera.height, camera.width)), camera) - camera.center
    with np.errstate(divide="ignore"):
        z = (height - camera.center[2]) / at_one[..., 2]
    return np.where(z > 0.0, z, np.inf)


def photo(
    camera: Camera,
    pattern: Pattern = checks,
    *,
    covers: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
    below: float = -1.0,
    hole: float = HOLE,
    waver: float = 0.0,
    seed: int = 0,
) -> Photo:
    """One photograph.

    Args:
        camera: Where from.
        pattern: Colours of the top at x and y.
        covers: Where the top is; everywhere if None. Beside it, grey ground is seen.
        below: Height of that ground [m].
        hole: Radius around the origin of what nobody saw [m].
        waver: Standard deviation of the depth [ratio].
        seed: Of the waver.
    """
    top, ground = level(camera, 0.0), level(camera, below)
    points = unprojected(np.where(np.isfinite(top), top, 1.0), camera)
    x, y = points[..., 0], points[..., 1]
    on = np.isfinite(top) & (np.ones_like(x, bool) if covers is None else covers(x, y))
    depth = np.where(on, top, ground)
    colors = np.where(on[..., None], pattern(x, y), 0.35)
    unseen = np.isfinite(top) & (np.hypot(x, y) < hole)
    depth = np.where(np.isfinite(depth), depth, 0.0)
    depth = depth * (1.0 + waver * np.random.default_rng(seed).standard_normal(depth.shape))
    pixels = (colors * 255.0).round().astype(np.uint8)
    pixels[unseen] = (0, 255, 0)
    return Photo(camera, pixels, depth.astype(np.float32), ~unseen, unseen)


def photos(eyes: Sequence[Sequence[float]] = EYES, **options) -> list[Photo]:
    """A photograph from each place."""
    return [photo(camera_at(eye), seed=number, **options) for number, eye in enumerate(eyes)]


def truth(camera: Camera, pattern: Pattern = checks) -> np.ndarray:
    """The top without a hole, RGB in [0, 1], shape (H, W, 3)."""
    points = unprojected(level(camera, 0.0), camera)
    return pattern(points[..., 0], points[..., 1]).astype(np.float32)
