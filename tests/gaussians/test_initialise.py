"""First gaussians: as wide as their neighbours are far, and on the pixels that they came from."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.gaussians.initialise import SMALLEST, from_image, initialise
from diga3d_warp.scene.scene import Points
from diga3d_warp.splatting.project import project
from diga3d_warp.splatting.render import render
from scenes import LENSES, camera_at

RED = [255, 0, 0]


def points(positions) -> Points:
    positions = np.asarray(positions, np.float64)
    return Points(positions, np.full((len(positions), 3), RED, np.uint8))


def test_a_gaussian_is_as_wide_as_its_three_nearest_neighbours_are_far():
    positions = np.random.default_rng(0).normal(size=(60, 3))
    squared = ((positions[:, None] - positions[None]) ** 2).sum(-1)
    nearest = np.sort(squared, axis=1)[:, 1:4]
    gaussians = initialise(points(positions))
    expected = np.sqrt(nearest.mean(axis=1))
    np.testing.assert_allclose(gaussians.scales, np.repeat(expected[:, None], 3, axis=1), rtol=1e-5)
    np.testing.assert_allclose(gaussians.means, positions, rtol=1e-6)
    np.testing.assert_allclose(gaussians.opacities, 0.1, rtol=1e-6)
    assert gaussians.sh.shape == (60, 16, 3)


def test_the_color_is_that_of_the_point():
    gaussians = initialise(points([[0.0, 0.0, 0.0]]), coefficients=4)
    gaussians.opacity_logits += 20.0
    middle = render(gaussians, camera_at()).color.amax(dim=(0, 1))
    torch.testing.assert_close(middle, torch.tensor([0.99, 0.0, 0.0]), atol=0.01, rtol=0)


def test_coincident_points_have_a_size():
    gaussians = initialise(points([[1.0, 2.0, 3.0]] * 5 + [[2.0, 2.0, 3.0]]))
    assert torch.isfinite(gaussians.log_scales).all()
    np.testing.assert_allclose(gaussians.scales[:5], SMALLEST, rtol=1e-5)  # points are 1 apart


@pytest.mark.parametrize("unit", [1e-7, 1e5])
def test_sizes_follow_the_unit(unit):
    positions = np.random.default_rng(3).normal(size=(40, 3)).repeat(2, axis=0)
    positions[::8] += 0.1
    here, there = initialise(points(positions)), initialise(points(positions * unit))
    np.testing.assert_allclose(there.scales, here.scales * unit, rtol=1e-5)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_fewer_points_than_neighbours(count):
    gaussians = initialise(points(np.arange(count)[:, None] * [2.0, 0.0, 0.0]))
    assert len(gaussians) == count
    assert ((gaussians.scales > 0.5) & (gaussians.scales < 5.0)).all()


@pytest.mark.parametrize("positions", [np.empty((0, 3)), np.full((4, 3), np.nan)], ids=["none", "NaN"])
def test_no_point_is_one_line(positions):
    with pytest.raises(InputError, match="no sparse points to start from") as caught:
        initialise(points(positions))
    assert "\n" not in str(caught.value)


def test_points_that_are_not_finite_are_left_out():
    gaussians = initialise(points([[0, 0, 0], [np.inf, 0, 0], [1, 0, 0]]))
    assert gaussians.means.tolist() == [[0, 0, 0], [1, 0, 0]]


def surface(camera, seed=1):
    random = np.random.default_rng(seed)
    shape = (camera.height, camera.width)
    return random.random((*shape, 3), np.float32), random.uniform(1.5, 4.0, shape).astype(np.float32)


@pytest.mark.parametrize("lens", LENSES)
def test_gaussians_from_an_image_lie_behind_their_pixels(lens):
    camera = camera_at(lens)
    image, depth = surface(camera)
    where = np.zeros(depth.shape, bool)
    where[5:40, 10:50] = True
    gaussians = from_image(image, depth, where, camera, 4, most=10_000)
    assert len(gaussians) == where.sum()
    seen = project(
        gaussians.means, gaussians.log_scales, gaussians.quaternions, gaussians.opacity_logits, camera
    )
    rows, columns = np.nonzero(where)
    np.testing.assert_allclose(seen.centers, np.stack([columns, rows], axis=1) + 0.5, atol=2e-3)
    np.testing.assert_allclose(seen.depths, depth[where], rtol=1e-5)


def test_gaussians_from_an_image_show_it():
    camera = camera_at()
    image, depth = surface(camera)
    image[:], depth[:] = [0.2, 0.6, 0.9], 2.0
    gaussians = from_image(image, depth, np.ones(depth.shape, bool), camera, 1, most=10_000)
    rendering = render(gaussians, camera)
    inner = (slice(4, -4), slice(4, -4))
    assert rendering.alpha[inner].min() > 0.9, "no gap between neighbours"
    error = (rendering.color / rendering.alpha[..., None] - torch.from_numpy(image))[inner].abs()
    assert error.max() < 0.02
    assert (rendering.depth[inner] - 2.0).abs().max() < 0.02


def test_pixels_without_depth_or_ray_are_left_out():
    camera = camera_at()
    image, depth = surface(camera)
    depth[:, ::2], depth[3], depth[4] = 0.0, np.nan, np.inf
    gaussians = from_image(image, depth, np.ones(depth.shape, bool), camera, 1, most=10_000)
    assert len(gaussians) == (np.isfinite(depth) & (depth > 0)).sum()
    assert torch.isfinite(gaussians.means).all()


def region(kind: str, camera) -> np.ndarray:
    where = np.zeros((camera.height, camera.width), bool)
    if kind == "all":
        where[:] = True
    elif kind == "row":
        where[24] = True
    elif kind == "comb":
        where[:, ::6] = True
    else:
        where |= np.random.default_rng(2).random(where.shape) < 0.3
    return where


@pytest.mark.parametrize("kind", ["all", "row", "comb", "dust"])
@pytest.mark.parametrize("most", [1, 20, 150])
def test_the_number_is_bounded_and_gaussians_widen(kind, most):
    camera = camera_at()
    image, depth = surface(camera)
    where = region(kind, camera)
    every = from_image(image, depth, where, camera, 1, most=10_000)
    fewer = from_image(image, depth, where, camera, 1, most=most)
    assert 1 <= len(fewer) <= most
    if len(every) > most:
        ratio = fewer.scales.mean() / every.scales.mean()
        assert ratio > 0.8 * np.sqrt(len(every) / len(fewer)) or kind != "all"
        assert ratio > 1.2
