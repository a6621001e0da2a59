"""Losses: trusted pixels only, and relative depth aligned before it is compared."""

from __future__ import annotations

import pytest
import torch

from diga3d_warp.gaussians.losses import align_depth, depth_loss, photometric_loss
from diga3d_warp.splatting.ssim import ssim


def images(seed: int = 0):
    random = torch.Generator().manual_seed(seed)
    return torch.rand(20, 24, 3, generator=random), torch.rand(20, 24, 3, generator=random)


def test_photometric_loss_is_the_sum_of_its_parts():
    color, wanted = images()
    loss = photometric_loss(color, wanted, None, 0.2)
    expected = 0.8 * (color - wanted).abs().mean() + 0.2 * (1 - ssim(color, wanted))
    torch.testing.assert_close(loss, expected)
    assert photometric_loss(wanted, wanted, None, 0.2).item() == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("ssim_weight", [0.0, 0.2, 1.0])
def test_pixels_of_weight_zero_have_no_gradient(ssim_weight):
    color, wanted = images()
    weight = torch.ones(20, 24)
    weight[5:12, 8:15], weight[0, 0] = 0.0, 0.5
    color.requires_grad_()
    photometric_loss(color, wanted, weight, ssim_weight).backward()
    assert not color.grad[weight == 0.0].any()
    assert (color.grad[weight > 0.0].abs().sum(-1) > 0.0).all()


def test_what_stands_at_weight_zero_does_not_matter():
    color, wanted = images()
    weight = torch.ones(20, 24)
    weight[5:12, 8:15] = 0.0
    loss = photometric_loss(color, wanted, weight, 0.2)
    color[weight == 0.0] = 7.0
    torch.testing.assert_close(photometric_loss(color, wanted, weight, 0.2), loss)
    reached = torch.where(weight[..., None] == 0.0, color, wanted)
    assert photometric_loss(reached, wanted, weight, 0.2).item() == pytest.approx(0.0, abs=1e-6)


def test_depth_loss_is_relative_and_looks_at_known_pixels_only():
    depth, wanted = torch.full((4, 5), 2.2), torch.full((4, 5), 2.0)
    wanted[0], depth[1] = 0.0, 0.0
    weight = torch.ones(4, 5)
    weight[2], wanted[2] = 0.0, 9.0
    depth.requires_grad_()
    loss = depth_loss(depth, wanted, weight)
    assert loss.item() == pytest.approx(0.1, rel=1e-5)
    loss.backward()
    assert not depth.grad[:3].any()
    assert (depth.grad[3] > 0.0).all()


@pytest.mark.parametrize("nothing", ["wanted", "depth", "weight"])
def test_where_no_depth_is_known_the_loss_is_zero(nothing):
    planes = {name: torch.ones(3, 3) for name in ("depth", "wanted", "weight")}
    planes[nothing][:] = 0.0
    assert depth_loss(**planes).item() == 0.0


def test_relative_depth_is_aligned():
    random = torch.Generator().manual_seed(1)
    depth = 2.0 + torch.rand(6, 7, generator=random)
    relative = 0.3 * depth - 0.1
    assert depth_loss(depth, relative, None).item() > 0.5
    assert depth_loss(depth, relative, None, aligned=True).item() < 1e-5
    scale, shift = align_depth(relative, depth)
    assert (scale, shift) == pytest.approx((1 / 0.3, 0.1 / 0.3), rel=1e-4)


def test_flat_or_reversed_depth_is_only_shifted():
    reference = torch.linspace(1.0, 3.0, 11)
    assert align_depth(torch.full((11,), 5.0), reference) == pytest.approx((1.0, -3.0))
    assert align_depth(4.0 - reference, reference) == pytest.approx((1.0, 0.0), abs=1e-6)
