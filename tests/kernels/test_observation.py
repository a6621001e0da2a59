"""One view's look-up of another's pixels: what it takes, and each reason to refuse."""

import math

import numpy as np
import pytest
import warp as wp

from diga3d_warp.kernels.observation import look_up
from diga3d_warp.kernels.reprojection import Motion

WIDTH, HEIGHT, FOCAL = 16, 12, 10.0


def motion(shift: float) -> Motion:
    """To a camera that stands `shift` to the right; the ray is that of the middle of the image."""
    return Motion(
        WIDTH, HEIGHT, wp.array([[0.0, 0.0]], dtype=wp.vec2d, device="cpu"),
        wp.mat33d(np.eye(3)), wp.vec3d(-shift, 0.0, 0.0),
        WIDTH, HEIGHT, "none", wp.vec4d(FOCAL, FOCAL, 8.0, 6.0), wp.vec4d(), 1e15,
    )  # fmt: skip


def observe(depth=2.0, shift=0.3, surface=2.0, clear=True, angle=60.0, before=0):
    columns, rows = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    image = np.stack([10 * columns, 20 * rows, np.full_like(rows, 255)], -1).astype(np.uint8)
    count = wp.array([before], dtype=int, device="cpu")
    samples = wp.zeros((2, 1), dtype=wp.vec3, device="cpu")
    look_up(
        wp.array([depth], dtype=float, device="cpu"), motion(shift),
        wp.full((HEIGHT, WIDTH), surface, dtype=float, device="cpu"),
        wp.full((HEIGHT, WIDTH), clear, dtype=wp.bool, device="cpu"),
        wp.array(image, dtype=wp.vec3ub, device="cpu"), 0.02, math.cos(math.radians(angle)), count, samples,
    )  # fmt: skip
    return int(count.numpy()[0]), samples.numpy()[:, 0]


@pytest.mark.parametrize("before", [0, 1])
def test_it_samples_between_pixel_centres(before):
    # the point (0, 0, 2) lies at column 8 - 10 * 0.3 / 2 = 6.5, row 6: 6.0 and 5.5 from the first centre
    count, samples = observe(before=before)
    assert count == before + 1
    np.testing.assert_allclose(samples[before], [60 / 255, 110 / 255, 1.0], atol=1e-6)
    np.testing.assert_array_equal(samples[1 - before], 0.0)


@pytest.mark.parametrize(
    "refused",
    [
        {"surface": 2.05},
        {"surface": 1.95},
        {"surface": math.nan},
        {"depth": math.nan},
        {"depth": -2.0},
        {"clear": False},
        {"angle": 5.0},
        {"shift": 1.7},
        {"shift": -1.7},
    ],
)
def test_it_takes_no_other_surface_mask_angle_or_place(refused):
    assert observe(surface=2.03)[0] == 1
    count, samples = observe(**refused)
    assert count == 0
    np.testing.assert_array_equal(samples, 0.0)


def test_a_full_pixel_takes_no_more():
    count, samples = observe(before=2)
    assert count == 2
    np.testing.assert_array_equal(samples, 0.0)
