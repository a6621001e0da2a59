"""Baking: standard gaussians look like the anchors, harmonics where colours depend on the view."""

from __future__ import annotations

import pytest
import torch

from diga3d_warp.gaussians.scaffold.bake import bake, harmonics_towards
from diga3d_warp.gaussians.scaffold.same import same_anchors
from diga3d_warp.kernels.harmonics import C0
from diga3d_warp.splatting.render import render
from scaffolds import cloud, ring, scaffold_of


def glossy():
    """Anchors whose colours follow the direction: red from one side, dark from the other."""
    scaffold = scaffold_of()
    width = scaffold.features.shape[1]
    scaffold.decoder.color.inner[0, width, 0] = 0.3  # the direction along x into a unit that is always on
    scaffold.decoder.color.outer[0, 0, 0::3] = 3.0
    return scaffold


def psnr(a, b, cameras) -> float:
    errors = [((render(a, camera).color - render(b, camera).color) ** 2).mean() for camera in cameras]
    return float(-10.0 * torch.log10(torch.stack(errors).mean()))


def test_anchors_without_gloss_are_baked_as_they_are():
    scaffold = scaffold_of()
    baked = bake(scaffold, ring(4), 1)
    assert len(baked.gaussians) == len(baked.owners) <= len(scaffold) * scaffold.slots
    assert baked.owners.max() < len(scaffold)
    assert psnr(scaffold, baked.gaussians, ring(5)) > 45.0


def test_harmonics_hold_what_depends_on_the_view():
    scaffold = glossy()
    quality = [psnr(scaffold, bake(scaffold, ring(12), count).gaussians, ring(12)) for count in (1, 4, 9, 16)]
    assert quality[0] < 32.0 < quality[2], quality
    assert quality[0] < quality[1] < quality[2] + 0.5
    assert quality[3] > quality[1]


def test_tints_are_baked():
    scaffold = scaffold_of()
    dark = scaffold.brightened(torch.ones(len(scaffold), dtype=torch.bool), 0.3)
    assert psnr(dark, bake(dark, ring(4), 1).gaussians, ring(4)) > 45.0


def test_one_view_leaves_the_other_sides_plain():
    """A single direction tells nothing of the others: harmonics stay small."""
    baked = bake(glossy(), ring(1), 16).gaussians
    assert all(tensor.isfinite().all() for _, tensor in baked.named())
    assert baked.sh[:, 1:].abs().max() < 2.0 and baked.sh[:, 0].abs().max() < 3.0
    for camera in ring(6):
        assert float(render(baked, camera).color.max()) < 2.0


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_harmonics_are_those_of_the_renderer(degree):
    """Orthonormal over the sphere, the first of them constant."""
    camera = ring(1)[0]
    random = torch.Generator().manual_seed(1)
    away = torch.nn.functional.normalize(torch.randn(20_000, 3, generator=random), dim=1)
    basis = harmonics_towards(camera, torch.from_numpy(camera.center).float() + away, degree).double()
    assert (basis[:, 0] - C0).abs().max() < 1e-5
    products = basis.T @ basis / len(basis) * 4.0 * torch.pi
    assert (products - torch.eye(len(products))).abs().max() < 0.1


def test_anchors_that_are_the_same_are_found_again():
    before = scaffold_of().joined(cloud(6, seed=4))
    kept = torch.arange(len(before)) % 3 != 0
    after = before.select(kept)
    after.features[2] += 0.1
    found = same_anchors(before, after)
    assert (found[~kept] == -1).all()
    assert found[kept].tolist() == [0, 1, -1, *range(3, int(kept.sum()))]
    after.decoder.color.outer[1] += 0.1
    changed = same_anchors(before, after)
    assert (changed[(before.parts == 1)] == -1).all() and (changed >= 0).any()
