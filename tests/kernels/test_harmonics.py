"""View-dependent colour against harmonics built from Legendre polynomials, and those against SciPy."""

import numpy as np
import pytest
import torch

import oracle
from diga3d_warp.splatting.shade import degree_of, shade
from scenes import camera_at, random_gaussians

COUNT = 150


def scene(degree: int):
    gaussians = random_gaussians(COUNT, seed=4, degree=degree)
    gaussians.sh[:, 0] -= 1.0  # so that the maximum with zero cuts a good part of the colours
    extents = torch.ones(COUNT, 2)
    extents[::7] = 0.0
    return gaussians, extents


def shaded(degree: int, device: str = "cpu"):
    """Colours, their leaves, and the same from the oracle."""
    gaussians, extents = scene(degree)
    means, sh = (t.to(device).requires_grad_() for t in (gaussians.means, gaussians.sh))
    pose = camera_at().world_to_camera.clone().requires_grad_()
    colors = shade(means, sh, extents.to(device), camera_at().with_pose(pose), degree)
    leaves = [t.detach().cpu().double().requires_grad_() for t in (means, sh, pose)]
    reference = oracle.shade(*leaves, degree) * (extents[:, :1] > 0)
    return colors, [means, sh, pose], reference, leaves


@pytest.mark.parametrize("degree", range(4))
def test_colors_agree_with_float64(degree, device):
    colors, _, reference, _ = shaded(degree, device)
    torch.testing.assert_close(colors.cpu().double(), reference.detach(), atol=1e-5, rtol=0)
    assert 0.1 < (colors == 0).float().mean() < 0.9


@pytest.mark.parametrize("degree", range(4))
def test_gradients_agree_with_float64(degree, device):
    colors, found, reference, leaves = shaded(degree, device)
    weights = torch.rand(COUNT, 3, generator=torch.Generator().manual_seed(5))
    (colors * weights.to(device)).sum().backward()
    (reference * weights).sum().backward()
    for value, leaf in zip(found, leaves, strict=True):
        if degree == 0 and value is not found[1]:
            assert value.grad is None or not value.grad.any()
            continue
        assert leaf.grad.abs().max() > 0.01
        error = (value.grad.cpu().double() - leaf.grad).norm() / leaf.grad.norm()
        assert error < 1e-5


def test_the_oracle_agrees_with_scipy():
    from scipy.special import sph_harm_y

    random = np.random.default_rng(6)
    directions = random.normal(size=(50, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    polar, azimuth = np.arccos(directions[:, 2]), np.arctan2(directions[:, 1], directions[:, 0])
    columns = []
    for band in range(4):
        for order in range(-band, band + 1):
            value = sph_harm_y(band, abs(order), polar, azimuth)
            part = value.imag if order < 0 else value.real
            columns.append(part * (np.sqrt(2) if order else 1))
    found = oracle.harmonics(torch.tensor(directions), 3).numpy()
    np.testing.assert_allclose(found, np.stack(columns, -1), atol=1e-12)


def test_culled_gaussians_are_black_whatever_their_coefficients_hold():
    gaussians, extents = scene(3)
    culled = extents[:, 0] == 0
    gaussians.sh[culled] += 2.0
    gaussians.sh[::14] = torch.nan  # half of them
    sh = gaussians.sh.requires_grad_()
    colors = shade(gaussians.means, sh, extents, camera_at(), 3)
    colors.sum().backward()
    assert not colors[culled].any()
    assert not sh.grad[culled].any()
    assert colors.isfinite().all() and sh.grad.isfinite().all()
    assert colors[~culled].any()


def test_lower_degrees_leave_higher_coefficients_alone():
    gaussians, extents = scene(3)
    full = gaussians.sh.clone().requires_grad_()
    low = shade(gaussians.means, full, extents, camera_at(), 1)
    low.sum().backward()
    torch.testing.assert_close(low, shade(gaussians.means, gaussians.sh[:, :4], extents, camera_at(), 1))
    assert not full.grad[:, 4:].any()
    assert full.grad[:, :4].any()


def test_shapes_of_no_degree_are_refused():
    assert [degree_of(torch.zeros(2, terms, 3)) for terms in (1, 4, 9, 16)] == [0, 1, 2, 3]
    for shape in [(2, 5, 3), (2, 25, 3), (2, 4), (2, 4, 4)]:
        with pytest.raises(ValueError, match="spherical harmonics"):
            degree_of(torch.zeros(shape))
