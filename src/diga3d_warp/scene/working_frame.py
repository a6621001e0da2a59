"""Working frame of the computation: cameras around the origin, extent 1.

Captures come in metres, in arbitrary units, or in UTM coordinates of millions of metres. Kernels hold
coordinates as float32, and some thresholds are lengths. So a capture is first shifted and scaled in float64,
and results are transformed back at the end. In this frame lengths are fractions of the extent, and the same
capture in other units gives the same result.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from diga3d_warp.config import SPLATTING
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.extent import middle_and_extent
from diga3d_warp.scene.scene import Points, Scene


@dataclass(frozen=True, eq=False)
class WorkingFrame:
    """A similarity between the user's world and working units: shift and scale, without rotation.

    Quaternions and spherical harmonics are the same in both.

    Attributes:
        origin: Origin of the working frame in the user's world [scene units], shape (3,), float64.
        unit: Length of a working unit [scene units].
    """

    origin: np.ndarray
    unit: float

    @classmethod
    def of(cls, scene: Scene) -> WorkingFrame:
        """The frame of a capture: origin at the middle of its cameras, its extent as the unit."""
        return cls(*middle_and_extent(scene.centers, scene.points.positions))

    @classmethod
    def of_cameras(cls, cameras: Sequence[Camera]) -> WorkingFrame:
        """The frame of a capture whose points are not known yet."""
        return cls(*middle_and_extent(np.stack([camera.center for camera in cameras]), np.empty((0, 3))))

    def to_working(self, positions: np.ndarray) -> np.ndarray:
        """Positions in the user's world (P, 3) in working units, float64."""
        return (np.asarray(positions, np.float64) - self.origin) / self.unit

    def to_user(self, positions: np.ndarray) -> np.ndarray:
        """Positions in working units (P, 3) in the user's world, float64."""
        return np.asarray(positions, np.float64) * self.unit + self.origin

    def working_camera(self, camera: Camera) -> Camera:
        """A camera in working units; its near plane is `Splatting.near`."""
        moved = camera.relative_to(self.origin)
        pose = moved.world_to_camera.clone()
        pose[:3, 3] = pose[:3, 3] / self.unit
        return moved.with_pose(pose).with_near(SPLATTING.near)

    def working_scene(self, scene: Scene) -> Scene:
        """A capture in working units. Its splat stays a file in the user's world."""
        points = Points(self.to_working(scene.points.positions), scene.points.colors)
        return replace(scene.with_cameras(self.working_camera), points=points)

    def as_json(self) -> dict[str, Any]:
        """The frame as JSON data for the manifest of a run."""
        return {"origin": self.origin.tolist(), "unit": self.unit}


IDENTITY = WorkingFrame(np.zeros(3), 1.0)
"""The frame of a run before its capture is known: the user's world."""


def with_near_planes(scene: Scene) -> Scene:
    """The scene with the near plane of every camera at `Splatting.near` extents."""
    near = SPLATTING.near * scene.extent
    return scene.with_cameras(lambda camera: camera.with_near(near))
