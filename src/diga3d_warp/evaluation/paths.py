"""Camera paths: a smooth flight through the views of a capture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.extent import central_cameras

KEY_VIEWS = 16
"""Views that the path passes exactly. Handheld captures jitter from view to view; a path through all of them
would jitter too. Chosen by eye."""

CLOSED_GAP = 2.5
"""A path returns to its start as a loop if that step is at most this many times its median step, and goes
back the way it came otherwise. Every capture that circles its object closes within one or two steps."""


def fly_through(cameras: Sequence[Camera], frames: int) -> list[Camera]:
    """A smooth closed path through cameras in their order.

    Centres and axes follow periodic cubic splines, the axes made orthonormal again. Where the cameras do not
    circle, the path goes there and back, slowing down at both ends. Either way the last frame leads to the
    first, so that a video loops. Cameras far from all others are passed by.

    Args:
        cameras: At least one, in the order of capture.
        frames: Number of frames, at least one.

    Returns:
        A camera for each frame, with the first camera's size and focal length, without lens distortion.
    """
    near = np.flatnonzero(central_cameras(np.stack([camera.center for camera in cameras])))
    keys = [cameras[near[i]] for i in np.unique(np.linspace(0, len(near) - 1, KEY_VIEWS).round().astype(int))]
    pinhole = replace(keys[0], distortion=None)
    if len(keys) == 1:
        return [pinhole] * frames
    centers = np.stack([key.center for key in keys])
    axes = np.stack([key.pose[:3, :3] for key in keys])
    steps = _steps(centers, axes)
    closed = len(keys) > 2 and steps[-1] <= CLOSED_GAP * np.median(steps[:-1])
    time = np.arange(frames) / frames
    if closed:
        centers, axes = np.append(centers, centers[:1], 0), np.append(axes, axes[:1], 0)
    else:
        steps = steps[:-1]
        time = 0.5 - 0.5 * np.cos(2 * np.pi * time)
    knots = np.concatenate([[0.0], np.cumsum(steps)])
    return [
        pinhole.with_pose(torch.from_numpy(pose))
        for pose in _interpolate(knots, centers, axes, time * knots[-1], closed)
    ]


def _steps(centers: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Length of the step from each key to the next, from the last to the first: (K,), always positive.

    Distance in units of the path's radius plus the turn in radians, so that speed follows both.
    """
    radius = np.linalg.norm(centers - centers.mean(0), axis=1).max() or 1.0
    distance = np.linalg.norm(np.roll(centers, -1, 0) - centers, axis=1) / radius
    trace = np.einsum("kij,kij->k", np.roll(axes, -1, 0), axes)
    turn = np.arccos(np.clip((trace - 1) / 2, -1, 1))
    steps = distance + turn
    return np.maximum(steps, 1e-3 * max(steps.max(), 1.0))  # equal keys still need distinct knots


def _interpolate(
    knots: np.ndarray, centers: np.ndarray, axes: np.ndarray, at: np.ndarray, closed: bool
) -> np.ndarray:
    """World-to-camera poses (T, 4, 4) at times `at` between the keys' times `knots`."""
    from scipy.interpolate import CubicSpline

    values = np.concatenate([centers, axes.reshape(-1, 9)], axis=1)
    spline = CubicSpline(knots, values, bc_type="periodic" if closed else "natural")(at)
    poses = np.tile(np.eye(4), (len(at), 1, 1))
    poses[:, :3, :3] = _nearest_rotations(spline[:, 3:].reshape(-1, 3, 3))
    poses[:, :3, 3] = -np.einsum("tij,tj->ti", poses[:, :3, :3], spline[:, :3])
    return poses


def _nearest_rotations(matrices: np.ndarray) -> np.ndarray:
    """The rotation nearest to each matrix, (T, 3, 3). SVD gives one even where axes cancel out."""
    u, _, vt = np.linalg.svd(matrices)
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    return u @ vt
