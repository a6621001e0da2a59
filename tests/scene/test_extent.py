"""The size of a capture: that of most cameras, in any unit and anywhere."""

from __future__ import annotations

import numpy as np
import pytest

from diga3d_warp.scene.extent import EXTENT, central_cameras, middle_and_extent

AROUND = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
RING = np.stack([2.0 * np.cos(AROUND), 2.0 * np.sin(AROUND), np.ones(16)], axis=1)
POINTS = np.random.default_rng(0).normal(size=(50, 3))


def test_it_is_the_radius_of_the_cameras_as_in_3dgs():
    middle, extent = middle_and_extent(RING, POINTS)
    np.testing.assert_allclose(middle, [0.0, 0.0, 1.0], atol=1e-12)
    assert extent == pytest.approx(1.1 * 2.0)


@pytest.mark.parametrize("far", [20.0, 1e3, 1e6])
def test_single_cameras_far_away_do_not_count(far):
    centers = np.concatenate([RING, [[far, 0.0, 0.0], [0.0, -far, 0.0]]])
    assert central_cameras(centers).tolist() == [True] * 16 + [False] * 2
    assert middle_and_extent(centers, POINTS)[1] == pytest.approx(1.1 * 2.0)


def test_points_far_away_and_points_that_are_none_do_not_count():
    points = np.concatenate([POINTS, [[1e9, 0.0, 0.0], [np.nan, 0.0, 0.0], [np.inf, 0.0, 0.0]]])
    assert middle_and_extent(RING, points)[1] == middle_and_extent(RING, POINTS)[1]


def test_a_camera_at_one_end_of_a_walk_counts():
    walk = np.linspace(0.0, 30.0, 40)[:, None] * [1.0, 0.0, 0.0]
    assert central_cameras(walk).all()


def test_cameras_at_one_place_have_the_extent_of_what_they_see():
    depth = np.median(np.linalg.norm(POINTS - [5.0, 0.0, 0.0], axis=1))
    extent = middle_and_extent(np.full((9, 3), [5.0, 0.0, 0.0]), POINTS)[1]
    assert extent == pytest.approx(EXTENT.depth_part * depth)
    assert middle_and_extent(np.zeros((3, 3)), np.empty((0, 3)))[1] == 1.0


@pytest.mark.parametrize("scale", [1e-5, 1.0, 1e4])
def test_it_follows_shift_and_scale(scale):
    shift = np.array([5e5, 4.6e6, 300.0])
    middle, extent = middle_and_extent(RING, POINTS)
    there, size = middle_and_extent(RING * scale + shift, POINTS * scale + shift)
    assert size == pytest.approx(scale * extent, rel=1e-3 if scale < 1.0 else 1e-8)
    np.testing.assert_allclose(there, middle * scale + shift, rtol=1e-12)
