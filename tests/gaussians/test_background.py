"""Fits to images with an alpha channel: over the same colour on both sides, with exposures and without."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from test_fit import SETTINGS, cameras, same, stopped_at

from diga3d_warp.config import Effects
from diga3d_warp.gaussians import fit as fitting
from diga3d_warp.gaussians.exposure import exposed, exposure_corrected, unexposed
from diga3d_warp.gaussians.fit import fit
from diga3d_warp.gaussians.target import Target
from diga3d_warp.scene.photographs.images import BACKGROUND
from diga3d_warp.splatting.render import render
from scenes import random_gaussians

OFF = Effects(background=False)


@pytest.fixture(scope="module")
def truth():
    gaussians = random_gaussians(40, seed=8, degree=0)
    gaussians.means *= 0.7
    gaussians.opacity_logits += 1.0
    return gaussians


def seen_by(gaussians, camera, background=BACKGROUND):
    with torch.no_grad():
        return render(gaussians, camera, background=background)


def to_uint8(plane: torch.Tensor) -> torch.Tensor:
    return (255 * plane.clamp(0, 1)).round().to(torch.uint8)


@pytest.fixture(scope="module")
def targets(truth) -> list[Target]:
    made = []
    for camera in cameras():
        seen = seen_by(truth, camera)
        assert 0.2 < seen.alpha.mean() < 0.8, "something shows, and something shows through"
        made.append(Target(camera, to_uint8(seen.color), alpha=to_uint8(seen.alpha)))
    return made


@pytest.fixture(scope="module")
def start(truth):
    gaussians = truth.detached()
    gaussians.opacity_logits[:] = 0.0
    gaussians.sh = 0.3 * gaussians.sh
    return gaussians


@pytest.fixture(scope="module")
def whole(start, targets):
    return fit(start, targets, 1.0, SETTINGS, seed=3).gaussians


def error(gaussians, targets) -> float:
    """Mean difference of alpha."""
    errors = [(seen_by(gaussians, t.camera).alpha - t.alpha / 255.0).abs().mean() for t in targets]
    return float(torch.stack(errors).mean())


@pytest.mark.parametrize("color", [(0.0, 0.0, 0.0), (0.2, 0.9, 0.4)])
def test_a_target_is_what_the_scene_shows_over_any_color(truth, targets, color):
    for target in targets:
        shown = seen_by(truth, target.camera, color).color
        # Two roundings to a level: of the image and of its alpha.
        assert (target.over(torch.tensor(color)) - shown.clamp(max=1.0)).abs().max() < 1.01 / 255 + 0.02
    assert torch.equal(targets[0].over(torch.tensor(BACKGROUND)), targets[0].color)


def test_half_of_a_target_is_half_of_both(targets):
    whole, half = targets[0], targets[0].halved()
    assert half.alpha is not None and half.alpha.dtype == torch.uint8
    black = torch.zeros(3)
    small = whole.over(black).reshape(16, 2, 24, 2, 3).mean((1, 3))
    assert (half.over(black) - small).abs().max() < 1.01 / 255


def test_opacity_is_found(whole, start, targets):
    assert error(whole, targets) < 0.65 * error(start, targets)


def test_without_the_effect_what_is_nowhere_gets_painted(targets, start):
    painted = fit(start, targets, 1.0, SETTINGS, seed=3, effects=OFF).gaussians
    assert error(painted, targets) > error(start, targets)


def test_a_target_that_is_opaque_draws_no_random_numbers(start, targets, monkeypatch):
    opaque = [replace(target, alpha=None) for target in targets]
    first = fit(start, opaque, 1.0, SETTINGS, seed=3).gaussians
    monkeypatch.setattr(fitting._Fit, "_behind", lambda self, target: torch.zeros(3))
    assert same(fit(start, opaque, 1.0, SETTINGS, seed=3).gaussians, first)


@pytest.mark.parametrize("step", [7, 50])
def test_an_interrupted_fit_ends_with_the_same_bytes(whole, start, targets, tmp_path, monkeypatch, step):
    checkpoint = tmp_path / "checkpoint.pt"
    stopped_at(step, monkeypatch, start, targets, seed=3, checkpoint=checkpoint)
    assert same(fit(start, targets, 1.0, SETTINGS, seed=3, checkpoint=checkpoint).gaussians, whole)


def test_a_guide_is_shown_renderings_over_the_one_background(start, targets):
    corners = []

    def guide(color, done, generator):
        corners.append(color[0, 0].detach())
        return color.sum() * 0.0

    empty = start.select(torch.arange(1))
    guided = [replace(target, guide=guide) for target in targets]
    few = replace(SETTINGS, iterations=4, coarse_part=0.0, budget=1)
    fit(empty, guided, 1.0, few)
    assert all(torch.equal(corner, torch.tensor(BACKGROUND)) for corner in corners) and len(corners) == 4


GAIN = torch.tensor([[0.8, 0.05, 0.0, 0.02], [0.0, 0.9, 0.1, 0.0], [0.0, 0.0, 1.1, -0.03]])


def test_an_exposure_and_its_inverse():
    color = torch.rand(5, 7, 3, generator=torch.Generator().manual_seed(1))
    torch.testing.assert_close(unexposed(exposed(color, GAIN), GAIN), color)


def test_an_evened_photograph_keeps_its_background(truth):
    seen = seen_by(truth, cameras()[0], (0.0, 0.0, 0.0))
    through = (1.0 - seen.alpha)[..., None]
    photograph = exposed(seen.color, GAIN) - through * GAIN[:, 3] + through * torch.tensor(BACKGROUND)
    even = exposure_corrected(to_uint8(photograph).numpy(), GAIN, to_uint8(seen.alpha).numpy())
    wanted = seen_by(truth, cameras()[0]).color.clamp(0, 1)
    inside = (photograph > 0.01).all(2) & (photograph < 0.99).all(2)  # what was clipped stays clipped
    assert inside.sum() > 200
    assert (torch.from_numpy(even) / 255.0 - wanted)[inside].abs().max() < 3 / 255
    assert (even[(seen.alpha == 0).numpy()] == 255).all()


def test_exposures_are_those_of_the_object_alone(truth, start):
    """Gains from 0.7 to 1.3 of things that fill a third of each image, over a background that has none."""
    gains, made = (0.7, 1.0, 1.3, 0.8, 1.1, 1.1), []
    for camera, gain in zip(cameras(), gains, strict=True):
        seen = seen_by(truth, camera, (0.0, 0.0, 0.0))
        color = 0.7 * gain * seen.color.clamp(0, 1) + (1.0 - seen.alpha)[..., None]
        made.append(Target(camera, to_uint8(color), alpha=to_uint8(seen.alpha)))
    long = replace(SETTINGS, iterations=240, coarse_part=0.0)
    result = fit(start, made, 1.0, long, effects=Effects(exposure=True))
    # Judged on a colour of the object: its colours are too alike to tell a gain from an offset.
    color = torch.full((3,), 0.5)
    found = torch.stack([(exposed(color, transform) / color).mean() for transform in result.exposures])
    assert torch.corrcoef(torch.stack([found, torch.tensor(gains)]))[0, 1] > 0.98
    assert 0.45 < found.max() - found.min() < 0.75, "not pulled to 1 by the background"
