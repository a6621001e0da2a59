"""Cameras of a situation: all around the object or in front of it, and test views elsewhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.random import Generator

from diga3d_warp.scene.camera import Camera, look_at


@dataclass(frozen=True)
class Orbit:
    """Cameras that look at one point.

    Attributes:
        target: What they look at [m].
        distance: From the target [m], mean.
        elevation: Lowest and highest, above the horizon [degrees].
        middle: Azimuth of the middle of the path [degrees]; 0 stands at -y, 90 at +x.
        half_angle: Largest turn to either side [degrees]; 180 goes all around.
        field_of_view: Horizontal [degrees], that of a phone camera.
        distance_swing: How far cameras come nearer and go away [share of the distance].
        jitter: Random displacement of eye and target [share of the distance], deviation.
    """

    target: tuple[float, float, float]
    distance: float
    elevation: tuple[float, float]
    middle: float = 0.0
    half_angle: float = 180.0
    field_of_view: float = 58.0
    distance_swing: float = 0.08
    jitter: float = 0.01

    @property
    def around(self) -> bool:
        """Whether the cameras see the object from all sides."""
        return self.half_angle >= 180.0

    def cameras(self, width: int, height: int, views: int, rng: Generator) -> dict[str, Camera]:
        """Pinhole cameras of a capture by view name, along the path; elevation and distance swing."""
        shares = np.linspace(-1, 1, views, endpoint=not self.around)
        start = rng.uniform(0, 2 * np.pi, 2)
        low, high = self.elevation
        cameras = {}
        for number, share in enumerate(shares):
            # Two frequencies that never meet: neighbours on the path differ in height and distance.
            rise = 0.5 * (low + high) + 0.5 * (high - low) * np.sin(2.4 * number + start[0])
            reach = self.distance * (1 + self.distance_swing * np.sin(1.7 * number + start[1]))
            azimuth = self.middle + self.half_angle * share
            cameras[f"view_{number:03d}"] = self._camera(width, height, azimuth, rise, reach, rng)
        return cameras

    def elsewhere(self, width: int, height: int, views: int, rng: Generator) -> dict[str, Camera]:
        """Pinhole cameras of test views: between and beyond those of the capture, nearer and higher."""
        beyond = self.half_angle if self.around else self.half_angle + BEYOND
        shares = np.linspace(-1, 1, views, endpoint=not self.around)
        low, high = self.elevation
        cameras = {}
        for number, share in enumerate(shares):
            azimuth = self.middle + beyond * share + (0.37 * 360 / views if self.around else 0.0)
            rise = rng.uniform(0.5 * (low + high), min(high + BEYOND, STEEPEST))
            reach = self.distance * rng.uniform(0.72, 1.0)
            cameras[f"test_{number:03d}"] = self._camera(width, height, azimuth, rise, reach, rng)
        return cameras

    def _camera(
        self, width: int, height: int, azimuth: float, elevation: float, distance: float, rng: Generator
    ) -> Camera:
        focal = 0.5 * width / np.tan(np.radians(self.field_of_view / 2))
        turn, rise = np.radians(azimuth), np.radians(elevation)
        direction = np.array([np.sin(turn) * np.cos(rise), -np.cos(turn) * np.cos(rise), np.sin(rise)])
        shake = self.jitter * distance * rng.standard_normal((2, 3))
        target = np.array(self.target)
        pose = look_at(target + distance * direction + shake[0], target + shake[1])
        return Camera(width, height, focal, focal, width / 2, height / 2, torch.from_numpy(pose))


BEYOND = 10.0
"""How far test views leave the range of the capture's, in azimuth and elevation [degrees]."""

STEEPEST = 70.0
"""Highest elevation [degrees]: nobody holds a camera straight above."""
