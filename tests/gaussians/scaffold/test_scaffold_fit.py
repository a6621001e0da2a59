"""Fitting anchors: it comes closer, resumes with the same bytes, holds, grows in its budget, and prunes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from diga3d_warp.config import Effects
from diga3d_warp.errors import InputError
from diga3d_warp.gaussians import fit as fitting
from diga3d_warp.gaussians.fit import FitSettings, fit
from diga3d_warp.gaussians.scaffold.initialise import initial_anchors
from diga3d_warp.gaussians.scaffold.settings import GrowthSettings, ScaffoldSettings
from diga3d_warp.gaussians.target import Target
from diga3d_warp.kernels.harmonics import C0
from diga3d_warp.scene.scene import Points
from diga3d_warp.splatting.render import render
from scaffolds import cloud, lively, ring, same

GROWTH = GrowthSettings(interval=20, visits=2)
SCAFFOLD = ScaffoldSettings(slots=4, width=16, drawn=2.0, growth=GROWTH)
SETTINGS = FitSettings(iterations=80, budget=160, scaffold=SCAFFOLD)


@pytest.fixture(scope="module")
def targets() -> list[Target]:
    truth, made = cloud(), []
    for camera in ring():
        color = (render(truth, camera).color.clamp(0, 1) * 255).round().to(torch.uint8)
        assert color.float().std() > 30, "not blank"
        made.append(Target(camera, color))
    return made


@pytest.fixture(scope="module")
def points() -> Points:
    truth = cloud()
    random = np.random.default_rng(0)
    colors = (255 * (0.5 + C0 * truth.sh[:, 0]).clamp(0, 1)).numpy().astype(np.uint8)
    return Points(truth.means.double().numpy() + 0.03 * random.normal(size=(60, 3)), colors)


@pytest.fixture(scope="module")
def start(points):
    return initial_anchors(points, 1.0, SETTINGS.budget, SCAFFOLD)


@pytest.fixture(scope="module")
def whole(start, targets):
    return fit(start, targets, 1.0, SETTINGS, seed=3)


def psnr(scene, targets) -> float:
    with torch.no_grad():
        errors = [((render(scene, t.camera).color - t.color) ** 2).mean() for t in targets]
    return float(-10 * torch.log10(torch.stack(errors).mean()))


def test_the_first_anchors_are_coloured_as_their_points(points, start, targets):
    assert 8 <= len(start) <= 48, "0.6 of the 80 anchors of the budget"
    assert psnr(start, targets) > psnr(
        initial_anchors(Points(points.positions, 255 - points.colors), 1.0, 160, SCAFFOLD), targets
    )


def test_a_fit_comes_closer(start, targets, whole):
    assert psnr(whole.gaussians, targets) > psnr(start, targets) + 3.0
    assert [point["gaussians"] for point in whole.curve][-1] == len(whole.gaussians)


def test_the_same_seed_gives_the_same_bytes(start, targets, whole):
    assert same(fit(start, targets, 1.0, SETTINGS, seed=3).gaussians, whole.gaussians)


@pytest.mark.parametrize("stop", [1, 37, 61])
def test_a_resumed_fit_gives_the_same_bytes(start, targets, whole, tmp_path, stop):
    file = tmp_path / "checkpoint.pt"
    stopped = fitting._Fit(start, targets, 1.0, SETTINGS, 3, None)
    stopped.go_on(file, None)
    for _ in range(stop):
        stopped.step()
    stopped.save(file)
    notes: list[str] = []
    resumed = fit(start, targets, 1.0, SETTINGS, seed=3, checkpoint=file, note=notes.append)
    assert notes == [] and same(resumed.gaussians, whole.gaussians)


def test_growing_keeps_to_its_budget(start, targets):
    """Whatever asks for anchors: memory grows with their number."""
    hungry = replace(SCAFFOLD, growth=replace(GROWTH, pull=0.0, chance=1.0, faint=0.0))
    result = fit(start, targets, 1.0, replace(SETTINGS, scaffold=hungry))
    counts = [point["gaussians"] for point in result.curve]
    assert len(start) < len(result.gaussians) <= 80 and max(counts) <= 80
    none = fit(start, targets, 1.0, replace(SETTINGS, budget=0, scaffold=hungry))
    assert len(none.gaussians) <= len(start)


def test_held_anchors_look_as_before(start, targets):
    held = torch.arange(len(start)) % 2 == 0
    before, last = start.select(held), int(torch.nonzero(held)[-1])
    result = fit(start, targets, 1.0, SETTINGS, held=held).gaussians
    rows = torch.zeros(len(result), dtype=torch.bool)
    rows[: last + 1] = held[: last + 1]
    after = result.select(rows)
    for camera in ring(2):
        assert torch.equal(render(after, camera).color, render(before, camera).color)
    assert not torch.equal(result.features[1], start.features[1]), "the others have moved"


def test_anchors_that_no_view_shows_are_taken_out(start, targets):
    outside = start.select(torch.arange(5))
    outside.means += 100.0
    lost = start.with_anchors(outside)
    result = fit(lost, targets, 1.0, replace(SETTINGS, budget=0)).gaussians
    assert (result.means.abs() < 50.0).all()
    held = torch.arange(len(lost)) >= len(start)
    kept = fit(lost, targets, 1.0, replace(SETTINGS, budget=0), held=held).gaussians
    assert torch.equal(kept.means[len(start) : len(lost)], outside.means)


def test_something_is_left_where_no_view_shows_anything(targets):
    nowhere = lively()
    nowhere.means += 1e3
    result = fit(nowhere, targets, 1.0, replace(SETTINGS, iterations=70))
    assert len(result.gaussians) >= 1


def test_exposures_are_fitted_beside_anchors(start, targets):
    dark = [replace(t, image=(t.color * gain)) for t, gain in zip(targets, [0.7, 1.0] * 3, strict=True)]
    result = fit(start, dark, 1.0, SETTINGS, effects=Effects(exposure=True))
    gains = torch.diagonal(result.exposures[:, :, :3], dim1=1, dim2=2).mean(dim=1)
    assert (gains[::2] < gains[1::2] - 0.05).all()


def test_depth_is_fitted(start, targets):
    truth = cloud()
    deep = [replace(t, depth=render(truth, t.camera).depth.detach()) for t in targets]
    result = fit(start, deep, 1.0, replace(SETTINGS, depth_weight=0.5, coarse_part=0.0, iterations=40))
    assert psnr(result.gaussians, targets) > psnr(start, targets)


class Poison(torch.autograd.Function):
    """A loss of zero whose gradient is not finite."""

    @staticmethod
    def forward(ctx, image, broken):
        ctx.shape, ctx.broken = image.shape, broken
        return image.new_zeros(())

    @staticmethod
    def backward(ctx, _):
        return torch.full(ctx.shape, ctx.broken), None


@pytest.mark.parametrize("broken", [torch.nan, torch.inf])
def test_a_gradient_that_is_not_finite_stops_the_fit(start, targets, monkeypatch, broken):
    """It would spoil all anchors at once, through the networks."""
    monkeypatch.setattr(fitting, "photometric_loss", lambda color, *_: Poison.apply(color, broken))
    with pytest.raises(InputError, match=r"the gradient of image \d of 6 is nan at iteration 1 of 80"):
        fit(start, targets, 1.0, SETTINGS)


def test_no_point_and_broken_points():
    with pytest.raises(InputError, match="no sparse points"):
        initial_anchors(Points(np.full((3, 3), np.nan), np.zeros((3, 3), np.uint8)), 1.0, 100)
    one = initial_anchors(
        Points(np.array([[0.0, 1.0, 2.0], [np.inf, 0, 0]]), np.full((2, 3), 9, np.uint8)), 1.0, 100
    )
    assert len(one) == 1
