"""Disagreement of views: a painted wall seen from several places agrees, views painted one by one do not."""

import math

import numpy as np
import pytest
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.consistency import depth_errors, disagreement
from diga3d_warp.scene.camera import Camera

WIDTH, HEIGHT, FOCAL = 48, 36, 40.0
WALL = 4.0
STEP = 0.15


def cameras(count=4):
    """In a row along x, looking along z."""
    poses = [np.eye(4) for _ in range(count)]
    for number, pose in enumerate(poses):
        pose[0, 3] = -STEP * number
    return [Camera(WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, torch.tensor(pose)) for pose in poses]


def positions(camera, depth):
    """World x and y of what each pixel shows at a depth, shape (H, W) each."""
    column, row = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    x, y = (column - camera.cx) * depth / camera.fx, (row - camera.cy) * depth / camera.fy
    return x + camera.center[0], y + camera.center[1]


def painted(camera, depth=WALL):
    """What the camera shows of a smooth painting on the wall, RGB."""
    x, y = positions(camera, depth)
    waves = [np.sin(1.5 * x + 0.3), np.cos(1.1 * x - 0.9 * y), np.sin(1.3 * y)]
    return (0.5 + 0.4 * np.stack(waves, -1)).astype(np.float32)


def walls(count):
    return [np.full((HEIGHT, WIDTH), WALL, np.float32)] * count


def middle():
    region = np.zeros((HEIGHT, WIDTH), bool)
    region[10:26, 14:34] = True
    return region


def test_one_painting_agrees_up_to_resampling():
    views = cameras()
    result = disagreement(views, [painted(view) for view in views], walls(4), [middle()] * 4)
    assert result.difference < 0.1
    # 12 ordered pairs of 16 x 20 pixels, a row and a column of which fall between target pixels
    assert 12 * 15 * 18 < result.pixels <= 12 * 16 * 20


def test_paintings_made_one_by_one_disagree():
    rng = np.random.default_rng(0)
    views = cameras()
    images = [rng.random((HEIGHT, WIDTH, 3), np.float32) for _ in views]
    agreeing = [images[0]] * 4
    result = disagreement(views, images, walls(4), [middle()] * 4)
    # |u - v| of two uniform numbers has mean 1/3; warping by part of a pixel averages two of them
    assert 60.0 < result.difference < 86.0
    # shifted views of one far picture, had they no parallax, would agree
    still = [views[0]] * 4
    assert disagreement(still, agreeing, walls(4), [middle()] * 4).difference < 1e-3


def test_difference_is_in_levels():
    views = cameras(2)
    grey = np.full((HEIGHT, WIDTH, 3), 0.5, np.float32)
    brighter = grey + np.float32(10 / 255)
    result = disagreement(views, [grey, brighter], walls(2), [middle()] * 2)
    assert result.difference == pytest.approx(10.0, abs=1e-3)


def test_what_one_view_hides_is_not_compared():
    """A screen before the wall in the second view only: the wall behind it is left out, not compared."""
    views = cameras(2)
    images, depths = [painted(view) for view in views], walls(2)
    screen = np.zeros((HEIGHT, WIDTH), bool)
    screen[:, 20:30] = True
    images[1], depths[1] = images[1].copy(), depths[1].copy()
    images[1][screen], depths[1][screen] = 1.0, 2.0
    regions = [middle(), np.zeros_like(screen)]
    result = disagreement(views, images, depths, regions)
    assert result.difference < 0.1
    assert 0 < result.pixels <= 16 * 10, "half of the region's columns lie behind the screen"


def test_surfaces_that_land_on_one_pixel_count_once():
    """The first view's region holds a screen and the wall beside it, which the second sees behind it."""
    views = cameras(2)
    screen = np.zeros((HEIGHT, WIDTH), bool)
    screen[:, 20:26] = True
    depths = walls(2)
    shift = round(FOCAL * STEP / 1.0)  # the screen stands at depth 1 and moves 6 px, the wall 1.5 px
    images = [painted(view) for view in views]
    for number, place in enumerate((screen, np.roll(screen, -shift, 1))):
        images[number], depths[number] = images[number].copy(), depths[number].copy()
        images[number][place], depths[number][place] = (1.0, 0.0, 0.0), 1.0
    result = disagreement(views, images, depths, [middle(), np.zeros_like(screen)])
    assert result.difference < 0.1, "neither sees the wall through the screen"
    assert result.pixels <= 16 * 20


def test_only_neighbours_are_compared():
    views = cameras(5)
    region, empty = middle(), np.zeros((HEIGHT, WIDTH), bool)
    images = [painted(view) for view in views]
    images[4] = 1.0 - images[4]
    regions = [region, empty, empty, empty, empty]
    near = disagreement(views, images, walls(5), regions, neighbours=3)
    everyone = disagreement(views, images, walls(5), regions, neighbours=9)
    assert near.difference < 0.1 < 10.0 < everyone.difference
    assert near.pixels < everyone.pixels


def test_nothing_to_compare():
    empty = np.zeros((HEIGHT, WIDTH), bool)
    views = cameras(2)
    result = disagreement(views, [painted(view) for view in views], walls(2), [empty] * 2)
    assert math.isnan(result.difference)
    assert result.pixels == 0


@pytest.mark.parametrize(("count", "regions"), [(1, 1), (3, 2)])
def test_lists_that_do_not_fit_are_refused(count, regions):
    views = cameras(count)
    with pytest.raises(InputError, match=f"{count} cameras.*{regions} regions.*at least two views"):
        disagreement(views, [painted(view) for view in views], walls(count), [middle()] * regions)


def test_depth_errors_are_relative_and_count_holes():
    truth = np.array([[2.0, 4.0], [8.0, 1.0]])
    depth = np.array([[2.2, 3.0], [0.0, 5.0]], np.float32)
    region = np.array([[True, True], [True, False]])
    np.testing.assert_allclose(depth_errors([depth], [truth], [region]), [0.1, 0.25, 1.0], atol=1e-6)
    assert len(depth_errors([depth, depth], [truth, truth], [region, ~region])) == 4
