"""Fits of scenes in which there is nothing to see, or next to nothing, or something broken."""

from __future__ import annotations

import pytest
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.gaussians.density import DensitySettings
from diga3d_warp.gaussians.fit import FitSettings, fit
from diga3d_warp.gaussians.losses import depth_loss
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.gaussians.target import Target
from diga3d_warp.splatting.render import render
from scenes import camera_at, random_gaussians, single

CAMERA = camera_at(width=40, height=30)
SETTINGS = FitSettings(iterations=50, budget=1, density=DensitySettings(interval=10))
STILL = FitSettings(iterations=50, budget=1, density=DensitySettings(end=0.0))
"""Without density control, which moves faded gaussians."""


def target_of(gaussians: Gaussians) -> Target:
    return Target(CAMERA, render(gaussians, CAMERA).color.detach().clamp(0, 1))


def error(gaussians: Gaussians, target: Target) -> float:
    return float((render(gaussians, CAMERA).color.detach() - target.color).square().mean())


def finite(gaussians: Gaussians) -> bool:
    return all(bool(tensor.isfinite().all()) for _, tensor in gaussians.named())


@pytest.mark.parametrize("settings", [SETTINGS, STILL], ids=["with density control", "still"])
def test_nothing_in_view(settings):
    """Images pull at nothing: positions, rotations and colours keep their bits."""
    hidden = random_gaussians(30, degree=1)
    hidden.means += 100.0 * torch.tensor([0.8, -0.5, 0.33])  # behind the camera
    target = target_of(random_gaussians(30, degree=1))
    assert target.color.std() > 0.1 and not render(hidden, CAMERA).alpha.any()
    fitted = fit(hidden, [target], 1.0, settings, seed=1).gaussians
    assert len(fitted) == 30 and finite(fitted)
    assert torch.equal(fitted.sh, hidden.sh)
    if settings is STILL:
        assert torch.equal(fitted.means, hidden.means)
        assert torch.equal(fitted.quaternions, hidden.quaternions)


def test_one_gaussian():
    target = target_of(single(means=[0.05, 0.0, 0.05]))
    start = single(opacity_logits=0.0)
    fitted = fit(start, [target], 1.0, STILL, seed=1).gaussians
    assert finite(fitted)
    assert error(fitted, target) < 0.5 * error(start, target)


def test_an_empty_photograph():
    """A black image: gaussians darken or fade, and stay finite."""
    start = random_gaussians(30, degree=1)
    black = Target(CAMERA, torch.zeros(30, 40, 3))
    fitted = fit(start, [black], 1.0, SETTINGS, seed=1).gaussians
    assert finite(fitted)
    assert error(fitted, black) < 0.5 * error(start, black)


def test_no_gaussians_are_refused_in_one_line():
    with pytest.raises(InputError, match="no gaussians") as caught:
        fit(random_gaussians(0), [target_of(single())], 1.0, SETTINGS)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("field", ["means", "log_scales", "quaternions", "opacity_logits", "sh"])
def test_a_broken_gaussian_does_not_spoil_the_others(field):
    truth = random_gaussians(30, degree=1)
    target = target_of(truth)
    start = truth.detached()
    start.sh[:, 0] -= 0.5
    getattr(start, field)[4] = torch.nan
    others = torch.arange(30) != 4
    result = fit(start, [target], 1.0, SETTINGS, seed=1)
    assert finite(result.gaussians.select(others))
    assert error(result.gaussians, target) < 0.5 * error(start, target)


@pytest.mark.parametrize("value", [0.0, -1.0, torch.nan, torch.inf, -torch.inf])
@pytest.mark.parametrize("aligned", [False, True])
def test_unknown_depth_does_not_count(value, aligned):
    """Inverting a disparity of zero gives infinity; an emptied region has a rendered depth of zero."""
    depth = torch.linspace(1.0, 3.0, 30).reshape(5, 6)
    wanted = depth + 0.1 * torch.sin(7.0 * depth)
    known = torch.ones(5, 6, dtype=torch.bool)
    known[1:3, 2:5] = False
    expected = depth_loss(depth, torch.where(known, wanted, torch.zeros(())), None, aligned=aligned)
    assert expected > 0.01
    leaf = depth.clone().requires_grad_()
    loss = depth_loss(leaf, torch.where(known, wanted, torch.tensor(value)), None, aligned=aligned)
    loss.backward()
    assert loss.item() == pytest.approx(expected.item())
    assert leaf.grad[known].abs().min() > 0 and not leaf.grad[~known].any()


@pytest.mark.parametrize("aligned", [False, True])
def test_in_an_emptied_region_there_is_no_depth_to_compare(aligned):
    depth = torch.zeros(4, 4, requires_grad=True)
    assert depth_loss(depth, torch.ones(4, 4), None, aligned=aligned).item() == 0.0
    one_pixel = torch.zeros(4, 4)
    one_pixel[1, 2] = 2.0
    loss = depth_loss(one_pixel.requires_grad_(), torch.full((4, 4), 3.0), None, aligned=aligned)
    loss.backward()
    assert loss.isfinite() and one_pixel.grad.isfinite().all()
    assert loss.item() == pytest.approx(0.0 if aligned else 1 / 3)
