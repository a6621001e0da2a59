"""Small random scenes and cameras for the tests of the renderer."""

from __future__ import annotations

import numpy as np
import torch

from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.scene.camera import Camera, Distortion, look_at

LENSES = {
    "none": None,
    "brown": Distortion("brown", (-0.12, 0.02, 0.004, -0.003)),
    "brown5": Distortion("brown5", (-0.12, 0.02, 0.004, -0.003, 0.05)),
    "fisheye": Distortion("fisheye", (0.03, -0.01, 0.002, -0.0003)),
}


def random_gaussians(count: int = 200, seed: int = 0, degree: int = 3) -> Gaussians:
    """A cloud of radius about one around the origin, opaque enough that pixels saturate here and there."""
    random = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(shape, generator=random)

    sh = 0.3 * normal(count, (degree + 1) ** 2, 3)
    sh[:, 0] += 0.8
    return Gaussians(
        means=0.6 * normal(count, 3),
        log_scales=-2.0 + 0.5 * normal(count, 3),
        quaternions=normal(count, 4) * torch.rand(count, 1, generator=random).mul(2).exp(),
        opacity_logits=0.5 + 2.0 * normal(count),
        sh=sh,
    )


def camera_at(lens: str = "none", width: int = 64, height: int = 48, distance: float = 3.0) -> Camera:
    """A camera that looks at the origin from the side and above, its principal point off the middle."""
    eye = distance * np.array([0.8, -0.5, 0.33])
    focal = 0.9 * max(width, height)
    return Camera(
        width, height, focal, 1.1 * focal, 0.5 * width + 1.3, 0.5 * height - 0.7,
        torch.tensor(look_at(eye, np.zeros(3))), LENSES[lens],
    )  # fmt: skip


def single(**changes) -> Gaussians:
    """One gaussian at the origin, 0.2 wide, opacity 0.88, colour (0.9, 0.5, 0.2), but for `changes`."""
    fields = {
        "means": [0.0, 0.0, 0.0],
        "log_scales": [-1.6, -1.6, -1.6],
        "quaternions": [1.0, 0.0, 0.0, 0.0],
        "opacity_logits": 2.0,
        "sh": [[1.418, 0.0, -1.063]],
    }
    fields.update(changes)
    return Gaussians(**{name: torch.tensor([value], dtype=torch.float32) for name, value in fields.items()})
