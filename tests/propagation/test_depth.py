"""Depth behind a hole: planes go on exactly, outliers at the rim do not spread, unknowns are filled."""

from __future__ import annotations

import numpy as np
import pytest

from diga3d_warp.errors import InputError
from diga3d_warp.propagation.depth import complete_depth

HEIGHT, WIDTH = 60, 80


def plane(tilt_x: float, tilt_y: float) -> np.ndarray:
    """z of a plane: its inverse is affine in the pixel."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    return (1.0 / (0.4 + tilt_x * (columns - 40) + tilt_y * (rows - 30))).astype(np.float32)


def disc(row: int = 30, column: int = 40, radius: int = 14) -> np.ndarray:
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    return (rows - row) ** 2 + (columns - column) ** 2 < radius**2


FLOORS = [plane(0.0, 0.0), plane(0.0, 0.009), plane(0.006, -0.004)]


@pytest.mark.parametrize("floor", FLOORS, ids=["wall", "floor", "slope"])
@pytest.mark.parametrize("hidden", ["other depth", "unknown", "NaN"])
def test_a_plane_is_continued(floor, hidden):
    hole = disc()
    seen = floor.copy()
    seen[hole] = {"other depth": 1.0, "unknown": 0.0, "NaN": np.nan}[hidden]
    completed = complete_depth(seen, hole)
    assert completed.dtype == np.float32
    np.testing.assert_array_equal(completed[~hole], floor[~hole])
    np.testing.assert_allclose(completed[hole], floor[hole], rtol=1e-4)


def test_several_holes_and_unknown_pixels_are_filled_at_once():
    floor = FLOORS[2]
    hole = disc(20, 20, 8) | disc(40, 60, 8)
    seen = floor.copy()
    unknown = disc(15, 55, 5)
    seen[unknown] = 0.0
    completed = complete_depth(seen, hole)
    np.testing.assert_allclose(completed, floor, rtol=1e-4)


def test_single_outliers_at_the_rim_do_not_spread():
    floor, hole = FLOORS[1], disc()
    seen = floor.copy()
    ring = disc(radius=16) & ~hole
    rows, columns = np.nonzero(ring)
    stuck_out = np.random.default_rng(0).choice(len(rows), len(rows) // 8, replace=False)
    seen[rows[stuck_out], columns[stuck_out]] *= 0.5
    completed = complete_depth(seen, hole)
    np.testing.assert_allclose(completed[hole], floor[hole], rtol=0.02)


def test_noise_at_the_rim_is_smoothed():
    floor, hole = FLOORS[2], disc()
    noise = np.random.default_rng(1).normal(1.0, 0.01, floor.shape).astype(np.float32)
    completed = complete_depth(floor * noise, hole)
    error = completed[hole] / floor[hole] - 1.0
    assert np.abs(error[disc(radius=8)[hole]]).max() < 0.006
    assert np.abs(error.mean()) < 0.004


def test_a_thin_rim_is_enough():
    floor = plane(0.0, 0.0)
    seen = np.zeros_like(floor)
    seen[12], seen[45] = 2.0, 4.0
    completed = complete_depth(seen, np.zeros(floor.shape, bool))
    expected = 1.0 / np.interp(np.arange(HEIGHT), [12, 45], [0.5, 0.25])
    np.testing.assert_allclose(completed, np.repeat(expected[:, None], WIDTH, 1), rtol=1e-4)


def test_a_hole_at_the_border_stays_between_the_known_depths():
    floor, hole = FLOORS[2], np.zeros((HEIGHT, WIDTH), bool)
    hole[40:, 50:] = True
    completed = complete_depth(floor, hole)
    known = floor[~hole]
    assert np.isfinite(completed).all()
    assert (completed[hole] >= known.min() - 1e-4).all() and (completed[hole] <= known.max() + 1e-4).all()
    np.testing.assert_allclose(completed[hole][0], floor[39, 50], rtol=0.05)


def test_without_a_hole_nothing_changes():
    floor = FLOORS[1]
    np.testing.assert_array_equal(complete_depth(floor, np.zeros(floor.shape, bool)), floor)


def test_one_known_pixel_is_enough():
    seen = np.zeros((5, 7), np.float32)
    seen[2, 3] = 3.0
    np.testing.assert_allclose(complete_depth(seen, seen == 0.0), 3.0, rtol=1e-6)


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_no_known_depth_is_one_line(value):
    with pytest.raises(InputError, match="no depth is known outside the masks") as caught:
        complete_depth(np.full((4, 4), value, np.float32), np.zeros((4, 4), bool))
    assert "\n" not in str(caught.value)


def test_a_mask_over_everything_is_one_line():
    with pytest.raises(InputError, match="no depth is known outside the masks"):
        complete_depth(FLOORS[0], np.ones((HEIGHT, WIDTH), bool))
