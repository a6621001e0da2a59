"""Frame of an object: axes, base and size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diga3d_warp.objects.surface import unit
from diga3d_warp.scene.camera import Camera

FAN = 0.02
"""Mean square deviation of the cameras' right axes from their main direction from which on they span a plane:
8 degrees."""


@dataclass(frozen=True, eq=False)
class Frame:
    """Axes that stand upright at the middle of an object's base.

    Attributes:
        origin: Middle of the base, world space [scene units], shape (3,).
        axes: Rows x, y and z of the frame in world space, right-handed, z upwards, shape (3, 3).
        extent: Size along x, y and z [scene units], shape (3,).
    """

    origin: np.ndarray
    axes: np.ndarray
    extent: np.ndarray

    def inward(self, points: np.ndarray) -> np.ndarray:
        """World positions (P, 3) in frame coordinates [scene units]."""
        return (points - self.origin) @ self.axes.T

    def outward(self, points: np.ndarray) -> np.ndarray:
        """Frame coordinates (P, 3) in world space."""
        return points @ self.axes + self.origin

    def turned(self, directions: np.ndarray) -> np.ndarray:
        """World directions (P, 3) in frame coordinates."""
        return directions @ self.axes.T


def upward(cameras: Sequence[Camera]) -> np.ndarray:
    """Up in world space, estimated from the cameras, shape (3,), unit length.

    Cameras yaw and pitch, but seldom roll: their right axes lie in the horizontal plane, and up is its
    normal. Where all cameras face one way, the plane is not defined, and up is the mean of the images' up
    axes.
    """
    rotations = np.stack([camera.pose[:3, :3] for camera in cameras])
    right = rotations[:, 0]
    above = unit(-rotations[:, 1].mean(axis=0))
    spread, directions = np.linalg.eigh(right.T @ right / len(right))
    level = directions[:, 0] * np.sign(directions[:, 0] @ above)
    return level if spread[1] > FAN and level @ above > 0.7 else above


def frame_of(points: np.ndarray, up: np.ndarray, facing: np.ndarray) -> Frame:
    """The frame of an object.

    Args:
        points: On its surface, shape (M, 3).
        up: Upwards, unit length, shape (3,).
        facing: Direction towards the cameras, shape (3,); its horizontal part is the frame's -y.
    """
    back = -(facing - up * (facing @ up))
    if np.linalg.norm(back) < 1e-6:
        back = np.cross(up, [1.0, 0.0, 0.0]) + 1e-3
        back -= up * (back @ up)
    back = unit(back)
    axes = np.stack([np.cross(back, up), back, up])
    local = points @ axes.T
    low, high = np.percentile(local, [1, 99], axis=0)
    middle = 0.5 * (low + high)
    middle[2] = low[2]
    return Frame(middle @ axes, axes, np.maximum(high - low, 1e-9))
