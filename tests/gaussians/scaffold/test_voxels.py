"""Voxels: one cell, a million, and positions out of all bounds."""

from __future__ import annotations

import numpy as np
import pytest

from diga3d_warp.gaussians.scaffold.voxels import CELLS_MOST, grouped, usual_distance, voxel_size, voxels_of


def points(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, 3))


def test_positions_are_grouped_by_their_voxel():
    positions = np.array([[0.1, 0.1, 0.1], [-0.1, 0.1, 0.1], [0.4, 0.4, 0.4], [1.6, 0.0, 0.0]])
    cells, number = grouped(voxels_of(positions, 0.5))
    assert cells.tolist() == [[-1, 0, 0], [0, 0, 0], [3, 0, 0]]
    assert number.tolist() == [1, 0, 1, 2]


def test_one_cell_holds_all():
    cells, number = grouped(voxels_of(np.abs(points(50)), 1e6))
    assert cells.tolist() == [[0, 0, 0]] and (number == 0).all()


def test_a_million_cells():
    side = np.arange(100)
    positions = np.stack(np.meshgrid(side, side, side), axis=-1).reshape(-1, 3) + 0.5
    shuffled = positions[np.random.default_rng(1).permutation(len(positions))]
    cells, number = grouped(voxels_of(shuffled, 1.0))
    assert len(cells) == 1_000_000
    assert (cells[number] + 0.5 == shuffled).all()


@pytest.mark.parametrize("most", [1, 10, 200])
def test_the_size_grows_until_few_enough_hold_a_position(most):
    positions = points(1000) + 50.0
    size = voxel_size(positions, most)
    assert len(grouped(voxels_of(positions, size))[0]) <= most
    smaller = grouped(voxels_of(positions, 0.5 * size))[0]
    assert len(smaller) > most or size == usual_distance(positions)


def test_fewer_than_eight_may_not_be_reached_around_the_origin():
    positions = points(100)
    size = voxel_size(positions, 1)
    assert len(grouped(voxels_of(positions, size))[0]) == 8


@pytest.mark.parametrize("positions", [np.zeros((5, 3)), np.ones((1, 3)), np.full((3, 3), 1e-40)])
def test_positions_that_coincide_have_a_size(positions):
    assert voxel_size(positions, 1) > 0.0


def test_voxels_far_away_count_as_on_the_border():
    cells = voxels_of(np.array([[1e200, -1e200, 0.0]]), 1e-100)
    assert cells.tolist() == [[int(CELLS_MOST), -int(CELLS_MOST), 0]]


def test_the_usual_distance_overlooks_copies():
    positions = np.repeat(np.arange(4.0)[:, None] * [2.0, 0.0, 0.0], 3, axis=0)
    assert usual_distance(positions) == 2.0
