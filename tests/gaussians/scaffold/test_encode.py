"""Encoding: anchors show the gaussians that they stand for, from every side."""

from __future__ import annotations

import pytest
import torch

from diga3d_warp.gaussians.scaffold.encode import encoded
from diga3d_warp.splatting.render import render
from scaffolds import cloud, ring, scaffold_of


def psnr(a: torch.Tensor, b: torch.Tensor) -> float:
    return float(-10.0 * torch.log10(((a - b) ** 2).mean()))


@pytest.mark.parametrize("count", [1, 2, 40, 400])
def test_anchors_show_what_they_stand_for(count):
    """With as many gaussians as slots nothing is copied, and all there is to lose is in the networks."""
    gaussians = cloud(count)
    scaffold = encoded(gaussians, 1.0, 1, 16)
    assert len(scaffold) == count
    for camera in ring(3):
        wanted, found = render(gaussians, camera).color, render(scaffold, camera).color
        assert wanted.max() > 0.05, "not blank"
        assert psnr(found, wanted) > 35.0


def test_slots_that_are_left_take_copies_within_the_original():
    gaussians = cloud(30)
    scaffold = encoded(gaussians, 1.0, 8, 16, 1e-3)
    assert len(scaffold) == 30 and scaffold.slots == 8
    for camera in ring(3):
        assert psnr(render(scaffold, camera).color, render(gaussians, camera).color) > 18.0


def test_a_voxel_of_more_gaussians_than_slots_has_several_anchors():
    gaussians = cloud(50)
    gaussians.means.abs_()
    scaffold = encoded(gaussians, 1.0, 4, 16, 100.0)
    assert len(scaffold) == 13
    assert (scaffold.means == 50.0).all()
    for camera in ring(2):
        # Of slots that are left two have copies.
        assert psnr(render(scaffold, camera).color, render(gaussians, camera).color) > 20.0


def test_gaussians_that_are_added_leave_the_others_as_they_were():
    scaffold = scaffold_of(40)
    joined = scaffold.joined(cloud(5, seed=9))
    assert len(joined) > len(scaffold) and len(joined.decoder) == 2
    kept = joined.select(torch.arange(len(scaffold)))
    for camera in ring(2):
        assert torch.equal(render(kept, camera).color, render(scaffold, camera).color)


def test_features_are_small_and_finite():
    """Where all gaussians look the same there is nothing to encode."""
    gaussians = cloud(20)
    gaussians.log_scales[:], gaussians.opacity_logits[:], gaussians.sh[:] = -2.0, 0.5, 0.3
    gaussians.quaternions[:] = torch.tensor([1.0, 0.0, 0.0, 0.0])
    scaffold = encoded(gaussians, 1.0, 1, 16)
    assert scaffold.features.isfinite().all() and scaffold.features.abs().max() < 1.0
    for camera in ring(2):
        assert psnr(render(scaffold, camera).color, render(gaussians, camera).color) > 40.0
