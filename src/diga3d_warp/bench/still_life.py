"""A still life of gaussians in which every effect of the renderer shows.

A chequered floor runs far back, where its tiles are smaller than pixels. A ball on it shines towards one side
by its harmonics. Two long discs cross, which no order of centres draws right.
"""

from __future__ import annotations

import numpy as np
import torch

from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.kernels.harmonics import C0
from diga3d_warp.scene.camera import Camera, Distortion, look_at

C1 = 0.4886025
"""Factor between a harmonic of degree 1 and a coordinate of the direction."""

FLOOR_STEP = 0.09
"""Distance of neighbours on the floor [m]."""

TILE_SIDE = 0.45
"""Side of a tile of the floor [m]."""

BALL = 3000
"""Gaussians on the ball."""


def still_life() -> Gaussians:
    """The gaussians, with harmonics of degree 3 of which those above degree 1 are zero."""
    return _floor().joined(_ball()).joined(_discs())


def still_life_camera(width: int = 320, height: int = 240) -> Camera:
    """A camera with a wide lens that bends lines as an action camera does."""
    pose = torch.from_numpy(look_at(np.array([0.3, -2.2, 1.0]), np.array([0.1, 0.6, 0.3])))
    focal = 0.7 * width
    lens = Distortion("brown", (-0.28, 0.05, 0.0, 0.0))
    return Camera(width, height, focal, focal, width / 2, height / 2, pose, lens)


def _gaussians(
    means: np.ndarray, scales: np.ndarray, colors: np.ndarray, quaternions: np.ndarray, opacity: float
) -> Gaussians:
    """Gaussians of one opacity; all arrays with one row each, colours in [0, 1]."""
    sh = torch.zeros(len(means), 16, 3)
    sh[:, 0] = (torch.from_numpy(colors.astype(np.float32)) - 0.5) / C0
    return Gaussians(
        torch.from_numpy(means.astype(np.float32)),
        torch.from_numpy(np.log(scales).astype(np.float32)),
        torch.from_numpy(quaternions.astype(np.float32)),
        torch.full((len(means),), float(np.log(opacity / (1.0 - opacity)))),
        sh,
    )


def _floor() -> Gaussians:
    x, y = np.meshgrid(np.arange(-4.0, 4.0, FLOOR_STEP), np.arange(-1.5, 12.0, FLOOR_STEP))
    means = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    dark = (np.floor(means[:, 0] / TILE_SIDE) + np.floor(means[:, 1] / TILE_SIDE)) % 2 == 1
    colors = np.where(dark[:, None], (0.16, 0.2, 0.3), (0.9, 0.86, 0.76))
    scales = np.tile([0.5 * FLOOR_STEP, 0.5 * FLOOR_STEP, 0.002], (len(means), 1))
    return _gaussians(means, scales, colors, np.tile([1.0, 0, 0, 0], (len(means), 1)), 0.95)


def _ball() -> Gaussians:
    """Points of a Fibonacci lattice, flat along the normal, bright on the side from which light comes."""
    radius, center = 0.42, np.array([-0.35, 0.5, 0.42])
    steps = np.arange(BALL) + 0.5
    height, turn = 1 - 2 * steps / BALL, steps * np.pi * (1 + 5**0.5)
    flat = np.sqrt(1 - height**2)
    normals = np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1)
    light = np.array([0.5, -0.6, 0.62])
    shade = 0.35 + 0.65 * np.clip(normals @ light, 0, 1)
    side = 1.2 * radius * (4 * np.pi / BALL) ** 0.5
    ball = _gaussians(
        center + radius * normals, np.tile([0.5 * side, 0.5 * side, 0.003], (BALL, 1)),
        shade[:, None] * (0.75, 0.2, 0.15), _turned_up_to(normals), 0.95,
    )  # fmt: skip
    # Seen along the mirrored light, a point is brighter, seen against it darker.
    mirrored = 2 * (normals @ light)[:, None] * normals - light
    gloss = torch.from_numpy((0.3 * mirrored / C1).astype(np.float32))
    ball.sh[:, 1:4] = torch.stack([gloss[:, 1], -gloss[:, 2], gloss[:, 0]], dim=1)[..., None]
    return ball


def _discs() -> Gaussians:
    """Two long discs through one point, one leaning to the left and one to the right."""
    lean = np.radians(35)
    quaternions = np.array([[np.cos(t / 2), 0, 0, np.sin(t / 2)] for t in (lean, -lean)])
    means = np.array([[0.75, 0.55, 0.3], [0.76, 0.56, 0.3]])
    scales = np.tile([0.16, 0.004, 0.13], (2, 1))
    return _gaussians(means, scales, np.array([[0.1, 0.65, 0.3], [0.95, 0.75, 0.1]]), quaternions, 0.97)


def _turned_up_to(normals: np.ndarray) -> np.ndarray:
    """Quaternions (w, x, y, z) that turn the z axis to unit vectors (N, 3)."""
    half = np.stack([1 + normals[:, 2], -normals[:, 1], normals[:, 0], np.zeros(len(normals))], axis=1)
    half[half[:, 0] < 1e-9] = (0.0, 1.0, 0.0, 0.0)
    return half / np.linalg.norm(half, axis=1, keepdims=True)
