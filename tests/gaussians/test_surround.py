"""The surround: behind everything, without gaps, in the colours of what was photographed nearby."""

import numpy as np
import pytest
import torch

from diga3d_warp.gaussians.surround import SURROUND, sphere, surround_of
from diga3d_warp.scene.camera import Camera, look_at
from diga3d_warp.splatting.render import render

RED, BLUE = (200, 30, 30), (30, 30, 200)


def camera(target, size=48, focal=40.0) -> Camera:
    return Camera(size, size, focal, focal, size / 2, size / 2, look_at(np.zeros(3), np.array(target)))


def picture(color) -> np.ndarray:
    return np.full((48, 48, 3), color, np.uint8)


@pytest.fixture
def shell():
    """Red was photographed along x, blue along -x."""
    means = torch.tensor([[3.0, 0.0, 0.0], [0.0, -40.0, 0.0], [1e7, 0.0, 0.0]])
    cameras = [camera((1.0, 0.0, 0.0)), camera((-1.0, 0.0, 0.0))]
    return surround_of(cameras, [picture(RED), picture(BLUE)], means, 1.0, 4)


def test_directions_are_spread_evenly():
    directions = sphere(SURROUND.count)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0)
    np.testing.assert_allclose(directions.mean(axis=0), 0.0, atol=1e-2)
    cosines = directions @ directions.T - 2.0 * np.eye(len(directions))
    nearest = np.degrees(np.arccos(cosines.max(axis=1)))
    assert nearest.min() > 5.0 and nearest.max() < 10.0


def test_it_lies_behind_everything_but_runaways(shell):
    radius = shell.means.norm(dim=1)
    assert float(radius.min()) > 40.0 and float(radius.max()) < 45.0


def test_no_direction_looks_into_nothing(shell):
    for target in np.concatenate([np.eye(3), -np.eye(3)]) + 0.01:
        rendering = render(shell, camera(target))
        assert float(rendering.alpha.min()) > 0.97
        assert float(rendering.color.mean()) > 0.05


def test_colours_are_those_photographed_nearest(shell):
    for target, color in (((1.0, 0.0, 0.0), RED), ((-1.0, 0.1, 0.0), BLUE)):
        shown = render(shell, camera(target)).color.mean(dim=(0, 1))
        np.testing.assert_allclose(shown.numpy() * 255.0, color, atol=12.0)
    above = render(shell, camera((0.0, 0.01, 1.0))).color.mean(dim=(0, 1))
    np.testing.assert_allclose(above.numpy() * 255.0, np.mean([RED, BLUE], axis=0), atol=12.0)


def test_a_scene_without_gaussians_in_reach_has_one_too():
    far = torch.full((3, 3), 1e8)
    shell = surround_of([camera((1.0, 0.0, 0.0))], [picture(RED)], far, 2.0, 1)
    assert float(shell.means.norm(dim=1).mean()) == pytest.approx(SURROUND.radius_least * 2.0, rel=1e-5)


def test_it_hides_nothing_of_an_opaque_splat(shell):
    """Behind a wall that fills the view, it changes nothing that can be seen."""
    wall = surround_of([camera((1.0, 0.0, 0.0))], [picture((90, 140, 60))], torch.zeros(1, 3), 0.5, 4)
    wall.opacity_logits += 6.0
    alone = render(wall, camera((1.0, 0.0, 0.0))).color
    both = render(wall.joined(shell), camera((1.0, 0.0, 0.0))).color
    assert float((alone - both).abs().max()) < 2.0 / 255.0
