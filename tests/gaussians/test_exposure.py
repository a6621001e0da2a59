"""Exposure: found beside the gaussians, the identity in the mean, and undone where wanted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from test_fit import SETTINGS, cameras, psnr, same, stopped_at

from diga3d_warp.config import Effects
from diga3d_warp.gaussians.exposure import IDENTITY, Exposures, best_transform, exposed, exposure_corrected
from diga3d_warp.gaussians.fit import fit
from diga3d_warp.gaussians.target import Target
from diga3d_warp.scene.camera import Camera, look_at
from diga3d_warp.splatting.render import render
from scenes import random_gaussians

EXPOSING = Effects(exposure=True)

GAINS = (0.7, 1.0, 1.3, 0.8, 1.1, 1.1)
"""Of mean 1, as the gauge has it."""


@pytest.fixture(scope="module")
def truth():
    gaussians = random_gaussians(40, seed=8, degree=0)
    gaussians.log_scales += 0.5
    return gaussians


@pytest.fixture(scope="module")
def even(truth):
    """What the scene looks like under one exposure, dark enough for every gain."""
    return [Target(camera, 0.7 * render(truth, camera).color.detach().clamp(0, 1)) for camera in cameras()]


@pytest.fixture(scope="module")
def uneven(even):
    return [replace(target, image=gain * target.image) for target, gain in zip(even, GAINS, strict=True)]


@pytest.fixture(scope="module")
def start(truth):
    gaussians = truth.detached()
    gaussians.sh = 0.3 * gaussians.sh
    return gaussians


LONG = replace(SETTINGS, iterations=240, coarse_part=0.0)


@pytest.fixture(scope="module")
def fitted(start, uneven):
    return fit(start, uneven, 1.0, LONG, effects=EXPOSING)


def test_gains_are_found(fitted):
    found = fitted.exposures[:, :, :3].sum(2).mean(1)
    assert torch.corrcoef(torch.stack([found, torch.tensor(GAINS)]))[0, 1] > 0.99
    assert (found - torch.tensor(GAINS)).abs().max() < 0.1


def test_the_mean_transform_is_the_identity(fitted):
    torch.testing.assert_close(fitted.exposures.mean(0), IDENTITY, atol=1e-5, rtol=0)


def test_what_follows_the_camera_is_left_to_the_gaussians():
    """Each image is brighter by its camera's place; one in the middle is brighter by itself."""
    count = 30
    poses = [
        look_at(np.array([x, -3.0, 0.5 + 0.2 * np.sin(x)]), np.zeros(3)) for x in np.linspace(-2, 2, count)
    ]
    places = [Camera(8, 6, 9.0, 9.0, 4.0, 3.0, torch.from_numpy(pose)) for pose in poses]
    gains = 1.0 + 0.1 * np.linspace(-2, 2, count)
    gains[14] += 0.3
    exposures = Exposures(places)
    generator = torch.Generator().manual_seed(0)
    for _ in range(12):
        for index, gain in enumerate(gains):
            color = torch.rand(6, 8, 3, generator=generator) * 0.5
            exposures.update(index, color, float(gain) * color, None)
    found = exposures.transforms[:, :, :3].sum(2).mean(1)
    others = torch.arange(count) != 14
    assert found[14] > 1.2
    assert (found[others] - 1.0).abs().max() < 0.08, "against 0.2 at both ends"


def test_a_rendering_has_the_mean_look_of_the_photographs(start, even, uneven, fitted):
    without = fit(start, uneven, 1.0, LONG)
    assert without.exposures is None
    assert psnr(fitted.gaussians, even) > psnr(without.gaussians, even) + 1.0


def test_an_interrupted_fit_ends_with_the_same_bytes(start, uneven, tmp_path, monkeypatch):
    whole = fit(start, uneven, 1.0, SETTINGS, effects=EXPOSING, seed=3)
    checkpoint = tmp_path / "checkpoint.pt"
    stopped_at(37, monkeypatch, start, uneven, effects=EXPOSING, seed=3, checkpoint=checkpoint)
    again = fit(start, uneven, 1.0, SETTINGS, effects=EXPOSING, seed=3, checkpoint=checkpoint)
    assert same(again.gaussians, whole.gaussians) and torch.equal(again.exposures, whole.exposures)


def test_degrees_stay_within_the_effects(start, even):
    wide = start.detached()
    wide.sh = torch.cat([wide.sh, torch.zeros(40, 15, 3)], dim=1)
    settings = replace(SETTINGS, sh_steps=(0.0, 0.0, 0.0), iterations=20)
    for degree, last in ((0, 1), (1, 4), (2, 9), (None, 16)):
        sh = fit(wide, even, 1.0, settings, effects=Effects(sh_degree=degree)).gaussians.sh
        assert (sh[:, :last] != 0).any((0, 2)).all() and (sh[:, last:] == 0).all()


def test_the_best_transform_is_found_beside_what_moved():
    generator = torch.Generator().manual_seed(2)
    color = torch.rand(30, 40, 3, generator=generator)
    transform = IDENTITY + 0.1 * torch.randn(3, 4, generator=generator)
    photograph = exposed(color, transform)
    assert (best_transform(color, photograph, None, IDENTITY) - transform).abs().max() < 0.01
    photograph[:8, :8] = 0.0
    weight = torch.ones(30, 40)
    weight[:8, :8] = 0.0
    assert (best_transform(color, photograph, weight, IDENTITY) - transform).abs().max() < 0.01
    robust = best_transform(color, photograph, None, transform)
    assert (robust - transform).abs().max() < 0.01, "without a mask, by the weights"


def test_a_flat_image_keeps_its_gain():
    color = torch.full((8, 8, 3), 0.4)
    found = best_transform(color, color + 0.1, None, IDENTITY)
    assert (exposed(color, found) - color - 0.1).abs().max() < 1e-3
    assert (found[:, :3] - torch.eye(3)).abs().max() < 0.05


def test_an_exposure_can_be_undone():
    pixels = np.random.default_rng(0).integers(60, 180, (8, 9, 3), dtype=np.uint8)
    gain = torch.eye(3) * 1.2 + 0.05 * torch.randn(3, 3, generator=torch.Generator().manual_seed(1))
    transform = torch.cat([gain, torch.tensor([[0.02], [-0.01], [0.0]])], dim=1)
    photograph = (exposed(torch.from_numpy(pixels) / 255.0, transform) * 255).round().to(torch.uint8).numpy()
    assert np.abs(photograph.astype(int) - pixels).mean() > 10
    assert np.abs(exposure_corrected(photograph, transform).astype(int) - pixels).max() <= 2
    assert exposure_corrected(photograph, 0.1 * IDENTITY) is photograph, "noise would be amplified"
