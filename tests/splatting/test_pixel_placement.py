"""Where cameras see world positions."""

from dataclasses import replace

import numpy as np
import torch

from diga3d_warp.scene.camera import Camera, Distortion, look_at
from diga3d_warp.splatting.placement import projected, unprojected

POSE = torch.from_numpy(look_at(np.array([0.3, -2.0, 1.5]), np.zeros(3)))
CAMERA = Camera(64, 48, 60.0, 58.0, 31.0, 25.0, POSE, near=0.01)
STRAIGHT = replace(CAMERA, distortion=Distortion("brown", (0.0, 0.0, 0.0, 0.0)))
"""The same through a lens that bends nothing, by the kernel for lenses."""


def positions() -> np.ndarray:
    rng = np.random.default_rng(0)
    around = rng.normal(size=(400, 3)) * np.repeat([0.1, 1.0, 10.0, 1e6], 100)[:, None]
    odd = [[np.nan, 0, 0], [np.inf, 0, 0], [1e300, 1e300, 1e300], [1e17, 2e17, -1e17], CAMERA.center]
    return np.concatenate([around, np.array(odd), CAMERA.center + 1e-16 * around[:50]])


def test_without_a_lens_positions_are_those_of_one_that_bends_nothing():
    found, expected = projected(positions(), CAMERA), projected(positions(), STRAIGHT)
    assert np.isfinite(expected).all(axis=1).sum() > 150 and np.isnan(expected).all(axis=1).sum() > 100
    near = ~(np.abs(expected[:, :2]) > 1e5).any(axis=1)  # a lens has a largest radius
    np.testing.assert_allclose(found[near], expected[near], rtol=1e-9)


def test_a_pixel_is_seen_where_it_is():
    rows, columns = np.mgrid[:48, :64]
    depth = 2.0 + 0.01 * columns
    found = projected(unprojected(depth, CAMERA), CAMERA)
    np.testing.assert_allclose(found, np.stack([columns + 0.5, rows + 0.5, depth], axis=-1), atol=1e-4)
