"""A floor seen from an arc, drawn without splats: what its photographs show is known exactly."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from diga3d_warp.scene.camera import Camera, Distortion, look_at
from diga3d_warp.scene.scene import Points, Scene, View

WIDTH, HEIGHT, FOCAL = 80, 60, 70.0

BOARD = 0.35
"""Height at which a black board hangs over the middle of the floor, where there is one."""


@dataclass(frozen=True)
class Floor:
    """How the floor is seen.

    Attributes:
        views: Number of views.
        points: Number of sparse points, with the floor's exact positions.
        gloss: Strength of a sheen that changes with the camera, in [0, 1].
        gains: Gain of each view's exposure; 1 if None.
        distances: Distances of the cameras, taken in turn.
        board: Whether the board hides a part of the floor.
        lens: Of all cameras; the photographs ignore it.
    """

    views: int = 14
    points: int = 600
    gloss: float = 0.0
    gains: tuple[float, ...] | None = None
    distances: tuple[float, ...] = (2.0,)
    board: bool = False
    lens: Distortion | None = None

    def scene(self) -> Scene:
        angles = np.linspace(-1.2, 1.2, self.views)
        views = []
        for k, angle in enumerate(angles):
            far = self.distances[k % len(self.distances)]
            eye = far * np.array([0.8 * np.sin(angle), -0.8 * np.cos(angle), 0.6 + 0.1 * np.sin(3.0 * k)])
            pose = torch.from_numpy(look_at(eye, np.zeros(3)))
            camera = Camera(WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, pose)
            color = self._photograph(camera) * (self.gains[k] if self.gains else 1.0)
            pixels = np.round(255 * color.clip(0, 1)).astype(np.uint8)
            assert pixels.std() > 10, "not blank"
            views.append(View(f"{k:02d}", replace(camera, distortion=self.lens), pixels))
        places = np.random.default_rng(0).uniform(-0.6, 0.6, (self.points, 2))
        positions = np.concatenate([places, np.zeros((self.points, 1))], axis=1)
        if self.board:
            over = np.random.default_rng(1).uniform(-0.3, 0.3, (self.points, 2))
            board = np.concatenate([over, np.full((self.points, 1), BOARD)], axis=1)
            positions = np.concatenate([positions, board])
        colors = np.zeros((len(positions), 3), np.uint8)
        return Scene(Path("floor"), "colmap", views, [], Points(positions, colors))

    def _photograph(self, camera: Camera) -> np.ndarray:
        columns, rows = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
        local = np.stack([(columns - WIDTH / 2) / FOCAL, (rows - HEIGHT / 2) / FOCAL, np.ones_like(rows)], -1)
        rays = local @ camera.pose[:3, :3]

        def hit(height: float) -> np.ndarray:
            reach = (height - camera.center[2]) / rays[..., 2]
            return camera.center + rays * reach[..., None]

        place = hit(0.0)
        color = np.stack([0.5 + 0.2 * wave(place) for wave in WAVES], axis=-1)
        toward = camera.center - place
        toward /= np.linalg.norm(toward, axis=-1, keepdims=True)
        # Ribs that shine to the left and to the right in turn. A sheen that is the same all over the floor
        # could as well be exposure.
        color += self.gloss * 0.5 * toward[..., :1] * np.cos(9.0 * place[..., 1:2])
        if self.board:
            over = (np.abs(hit(BOARD)[..., :2]) < 0.3).all(-1)
            color[over] = 0.02
        return color


WAVES: tuple[Callable[[np.ndarray], np.ndarray], ...] = (
    lambda p: np.sin(3.0 * p[..., 0] + 1.0),
    lambda p: np.cos(2.0 * p[..., 0] + 2.5 * p[..., 1]),
    lambda p: np.sin(2.0 * p[..., 1]) * np.cos(2.0 * p[..., 0]),
)
