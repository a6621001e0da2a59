"""Thinning of sparse points: deterministic, even in space, not led astray by outliers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from diga3d_warp.gaussians.thinning import thinned
from diga3d_warp.scene.scene import Points


def cloud(count: int, seed: int = 0) -> Points:
    """Points on a unit square, nine tenths of them in one corner of a tenth of its side."""
    generator = np.random.default_rng(seed)
    positions = np.zeros((count, 3))
    positions[:, :2] = generator.random((count, 2))
    positions[: 9 * count // 10, :2] *= 0.1
    colors = np.arange(count)[:, None].astype(np.uint32).view(np.uint8)[:, :3]
    return Points(positions, colors)


def test_few_points_are_kept_as_they_are():
    points = cloud(50)
    assert thinned(points, 50) is points and thinned(points, 60) is points


def test_thinning_is_even_in_space_and_keeps_colours():
    points = cloud(20_000)
    kept = thinned(points, 1000)
    assert len(kept) == 1000
    corner = (kept.positions[:, :2] < 0.1).all(axis=1).mean()
    assert corner < 0.1, "nine tenths of the points lie there, on a hundredth of the square"
    apart, _ = cKDTree(kept.positions).query(kept.positions, k=2)
    assert (apart[:, 1] < 0.2 / np.sqrt(1000)).mean() < 0.06
    holes, _ = cKDTree(kept.positions).query(points.positions)
    assert holes.max() < 3 / np.sqrt(1000)
    _, row = cKDTree(points.positions).query(kept.positions)
    np.testing.assert_array_equal(kept.colors, points.colors[row])
    assert (np.diff(row) > 0).all(), "in the order of the file"


def test_thinning_is_the_same_at_each_call_and_in_each_unit():
    points = cloud(5000)
    first, again = thinned(points, 700), thinned(points, 700)
    np.testing.assert_array_equal(first.positions, again.positions)
    # A power of two: no rounding.
    scaled = thinned(Points(points.positions * 2.0**-20, points.colors), 700)
    np.testing.assert_array_equal(scaled.positions, first.positions * 2.0**-20)


def test_outliers_do_not_make_the_scene_one_cell():
    points = cloud(20_000)
    points.positions[-5:] = [[1e7, 0, 0], [0, -1e8, 0], [0, 0, 1e9], [1e9, 1e9, 1e9], [-1e6, 0, 3]]
    kept = thinned(points, 1000)
    inside = kept.positions[np.abs(kept.positions).max(axis=1) <= 1]
    assert len(inside) >= 995
    holes, _ = cKDTree(inside).query(points.positions[:-5])
    assert holes.max() < 3 / np.sqrt(1000)


@pytest.mark.parametrize("spread", [0.0, 1e-300])
def test_points_that_coincide(spread):
    positions = np.full((3000, 3), 5.0) + spread
    kept = thinned(Points(positions, np.zeros((3000, 3), np.uint8)), 100)
    assert len(kept) == 100


def test_one_point_is_left_if_one_is_asked_for():
    assert len(thinned(cloud(300), 1)) == 1
