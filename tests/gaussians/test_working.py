"""Gaussians into working units and back."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from diga3d_warp.gaussians.working import to_user, to_working
from diga3d_warp.scene.working_frame import WorkingFrame
from scenes import random_gaussians


@pytest.mark.parametrize("unit", [1e-5, 1.0, 4e4])
@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (5e5, 4.6e6, 120.0)])
def test_there_and_back(unit, origin):
    gaussians, frame = random_gaussians(200), WorkingFrame(np.array(origin), unit)
    there = to_user(gaussians, frame)
    means = gaussians.means.double().numpy() * unit + origin
    seen = math.exp(-2.0) * unit  # the size of a gaussian
    np.testing.assert_allclose(there.means.double().numpy(), means, atol=0.05 * seen)
    torch.testing.assert_close(there.log_scales, gaussians.log_scales + math.log(unit))
    assert there.means.dtype == (torch.float64 if np.abs(origin).max() > 1e6 * unit else torch.float32)
    back = to_working(there, frame)
    assert back.means.dtype == torch.float32
    torch.testing.assert_close(back.means, gaussians.means, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(back.log_scales, gaussians.log_scales, rtol=1e-5, atol=1e-5)
    for name in ("quaternions", "opacity_logits", "sh"):
        assert torch.equal(getattr(back, name), getattr(gaussians, name)), name
