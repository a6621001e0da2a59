"""A plinth before a wall: the hole over both is split, and each surface goes on by itself."""

from __future__ import annotations

import numpy as np
import pytest

from diga3d_warp.propagation.layers import complete_layers, near_layer

HEIGHT, WIDTH = 80, 100
PLINTH, WALL = 2.0, 6.0


def plinth_before_wall() -> tuple[np.ndarray, np.ndarray]:
    """Depth of a wall with a plinth before it, and the hole that a figure on the plinth left."""
    depth = np.full((HEIGHT, WIDTH), WALL, np.float32)
    depth[50:, 20:80] = PLINTH
    hole = np.zeros((HEIGHT, WIDTH), bool)
    hole[15:60, 35:65] = True
    return np.where(hole, 0.0, depth).astype(np.float32), hole


def test_the_plinth_goes_on_up_to_its_edge():
    depth, hole = plinth_before_wall()
    layer = near_layer(depth, hole)
    assert layer is not None
    rows = np.flatnonzero(layer.part.any(axis=1))
    assert abs(int(rows[0]) - 50) <= 2 and rows[-1] == 59
    assert not (layer.part & ~hole).any()
    assert layer.surface.any() and (depth[layer.surface] == PLINTH).all()


def test_what_is_not_behind_the_plinth_is_kept_from_the_rest():
    depth, hole = plinth_before_wall()
    depth[:, :5] = 1.5  # a post in front
    layer = near_layer(depth, hole)
    assert layer is not None
    assert layer.front[:, :5].all() and layer.front[70, 50] and not layer.front[5, 50]
    assert not (layer.front & hole).any()


def test_depth_is_continued_on_each_surface():
    depth, hole = plinth_before_wall()
    completed = complete_layers(depth, hole, near_layer(depth, hole))
    truth = np.full((HEIGHT, WIDTH), WALL, np.float32)
    truth[50:, 20:80] = PLINTH
    wrong = np.abs(completed - truth) > 0.05 * truth
    assert wrong[hole].mean() < 0.08  # two rows at the plinth's edge, where smoothness was lost
    assert (completed[~hole] == depth[~hole]).all()


def sloping_floor() -> np.ndarray:
    """Depth of a floor that runs away from the camera: one surface, near and far."""
    return np.repeat(1.0 / np.linspace(0.1, 0.5, HEIGHT, dtype=np.float32)[:, None], WIDTH, axis=1)


@pytest.mark.parametrize("depth", [np.full((HEIGHT, WIDTH), 3.0, np.float32), sloping_floor()])
def test_one_surface_is_not_split(depth: np.ndarray):
    _, hole = plinth_before_wall()
    assert near_layer(np.where(hole, 0.0, depth).astype(np.float32), hole) is None


def test_a_twig_at_the_rim_is_not_a_surface():
    depth, hole = plinth_before_wall()
    depth[50:, 20:80] = WALL
    depth[61:63, 40:44] = PLINTH
    assert near_layer(np.where(hole, 0.0, depth), hole) is None


def test_without_known_depth_there_are_no_layers():
    _, hole = plinth_before_wall()
    assert near_layer(np.zeros(hole.shape, np.float32), hole) is None
