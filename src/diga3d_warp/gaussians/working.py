"""Gaussians into working units and back (`scene.working_frame`), in float64."""

from __future__ import annotations

import math

import numpy as np
import torch

from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.scene.working_frame import WorkingFrame


def to_working(gaussians: Gaussians, frame: WorkingFrame) -> Gaussians:
    """Gaussians of the user's world in working units, all float32."""
    return _moved(gaussians, frame.to_working(_means(gaussians)).astype(np.float32), -math.log(frame.unit))


def to_user(gaussians: Gaussians, frame: WorkingFrame) -> Gaussians:
    """Gaussians in working units in the user's world; means are float64 where float32 cannot hold them."""
    moved = _moved(gaussians, frame.to_user(_means(gaussians)), math.log(frame.unit))
    return moved.with_fitting_means()


def _means(gaussians: Gaussians) -> np.ndarray:
    return gaussians.means.detach().cpu().double().numpy()


def _moved(gaussians: Gaussians, means: np.ndarray, log_factor: float) -> Gaussians:
    moved = gaussians.detached()
    moved.means = torch.from_numpy(means).to(moved.sh.device)
    moved.log_scales = (moved.log_scales.double() + log_factor).to(moved.sh)
    return moved
