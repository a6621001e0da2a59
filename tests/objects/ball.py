"""A matte ball with a painted pattern, and what cameras around it see: exact depth and known light."""

from __future__ import annotations

import cv2
import numpy as np
import torch

from diga3d_warp.materials.painting import GAMMA
from diga3d_warp.objects.surface import Sight
from diga3d_warp.scene.camera import Camera, look_at
from diga3d_warp.splatting.optics import optics_of

RADIUS = 0.5
CENTER = np.array([0.3, -0.2, 1.0])
SUN = np.array([-0.6, -0.48, 0.64])
"""Direction towards the light, unit length; world z is up."""


def brightness(normals: np.ndarray) -> np.ndarray:
    """Light on the ball, linear: half from all around, half by how much a surface faces the sun."""
    return 0.30 + 0.25 * (normals @ SUN)


def plain(normals: np.ndarray) -> np.ndarray:
    """One grey."""
    return np.full((len(normals), 3), 0.6)


def ball_sight(camera: Camera, albedo=plain, waver=0.0, seed=0) -> Sight:
    """The ball before a grey wall.

    Args:
        camera: A pinhole.
        albedo: Linear colours by normal, (P, 3) to (P, 3).
        waver: Deviation of the depth from the truth [scene units], over a few pixels as that of a splat.
        seed: Of the waver.
    """
    rays = optics_of(camera).rays.reshape(camera.height, camera.width, 2).astype(np.float64)
    local = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], axis=2)
    direction = local @ camera.pose[:3, :3]
    offset = camera.center - CENTER
    a, b = (direction**2).sum(-1), (direction @ offset)
    under = b**2 - a * (offset @ offset - RADIUS**2)
    hit = under > 0
    depth = np.where(hit, (-b - np.sqrt(np.maximum(under, 0))) / a, 0.0)
    normals = (camera.center + direction * depth[..., None] - CENTER) / RADIUS
    image = np.full((camera.height, camera.width, 3), 0.45, np.float32)
    image[hit] = (albedo(normals[hit]) * brightness(normals[hit])[:, None]).clip(0, 1) ** (1 / GAMMA)
    share = hit.astype(np.float32)
    noise = cv2.GaussianBlur(np.random.default_rng(seed).standard_normal(depth.shape), (0, 0), 3.0)
    noise *= waver / noise.std()
    wavering = np.where(hit, depth + noise, 0.0).astype(np.float32)
    wall = np.where(hit, wavering, 2.0 * np.linalg.norm(offset)).astype(np.float32)
    return Sight(camera, image, image * share[..., None], share, wavering, wall)


def ring(count: int = 6, size: int = 96) -> list[Camera]:
    """Cameras around the ball, a little above it, all upright."""
    cameras = []
    for number in range(count):
        angle = 2 * np.pi * number / count
        eye = CENTER + [2.2 * np.cos(angle), 2.2 * np.sin(angle), 0.6 + 0.3 * np.sin(2.4 * number)]
        pose = torch.from_numpy(look_at(eye, CENTER))
        cameras.append(Camera(size, size, 1.4 * size, 1.4 * size, size / 2, size / 2, pose))
    return cameras
