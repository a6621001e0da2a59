"""The surround: behind everything, without gaps, in the colours of what was photographed nearby."""

import numpy as np
import pytest
import torch

from diga3d_warp.config import Effects
from diga3d_warp.gaussians.fit import FitSettings, fit
from diga3d_warp.gaussians.initialise import round_gaussians
from diga3d_warp.gaussians.surround import SURROUND, behind_view, beyond, render_before, sphere, surround_of
from diga3d_warp.gaussians.target import Target
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


def empty_share(splat, target, widened: float) -> float:
    """Share of nearly empty pixels in a view widened by some degrees."""
    half = np.arctan(24 / 40.0) + np.radians(0.5 * widened)
    return float((render(splat, camera(target, focal=24 / np.tan(half))).alpha < 0.5).float().mean())


def wall(opacity: float):
    """Grey gaussians that end where three photographs do."""
    rng = np.random.default_rng(0)
    places = np.c_[np.full(1500, 4.0), rng.uniform(-3.8, 3.8, 1500), rng.uniform(-2.3, 2.3, 1500)]
    return round_gaussians(places, np.full(1500, np.log(0.12)), np.full((1500, 3), 0.5), opacity, 1)


TURNS = [(1.0, turn, 0.0) for turn in (-0.3, 0.0, 0.3)]


def test_views_widened_by_20_degrees_are_not_black():
    splat = wall(0.9)
    shots = [(render(splat, camera(turn)).color.numpy() * 255).astype(np.uint8) for turn in TURNS]
    shell = surround_of([camera(turn) for turn in TURNS], shots, splat.means, 1.0, 1)
    before = np.mean([empty_share(splat, turn, 20.0) for turn in TURNS])
    after = np.mean([empty_share(splat.joined(shell), turn, 20.0) for turn in TURNS])
    assert before > 0.1 and after == 0.0


def test_a_fit_sees_the_shell_wherever_it_lets_light_through():
    """Published behind the splat, the shell changes nothing of what was fitted."""
    cameras = [camera(turn) for turn in TURNS]
    targets = [Target(each, torch.full((48, 48, 3), 0.6)) for each in cameras]
    shell = surround_of(cameras, [picture((150, 150, 150))] * 3, torch.ones(1, 3), 1.0, 1)
    settings = FitSettings(iterations=30, budget=0)
    with_shell, without = (
        fit(wall(0.3), targets, 1.0, settings, surround=each).gaussians for each in (shell, None)
    )
    behind = [render(each.joined(shell), cameras[1]).color for each in (with_shell, without)]
    errors = [float((each - 0.6).square().mean()) for each in behind]
    assert errors[0] < 0.7 * errors[1]


def test_a_splat_is_shown_over_the_shell_with_its_own_depth(shell):
    splat, eye = wall(0.3), camera((1.0, 0.0, 0.0))
    splat.sh = torch.nn.functional.pad(splat.sh, (0, 0, 0, 3))
    effects = Effects(depth=True)
    alone, shown = (render_before(each, splat, eye, effects) for each in (None, shell))
    assert torch.equal(shown.alpha, alone.alpha) and torch.equal(shown.depth, alone.depth)
    assert 0.2 < float(shown.alpha.mean()) < 0.99
    joined = render(splat.joined(shell), eye).color
    assert float((shown.color - joined).abs().max()) < 0.02 < float((alone.color - joined).abs().max())


def test_a_guide_sees_the_shell(shell):
    seen = []

    def guide(image, done, generator):
        seen.append(image.detach())
        return 0.0 * image.sum()

    eye = camera((1.0, 0.0, 0.0))
    target = Target(eye, torch.full((48, 48, 3), 0.6), guide=guide)
    fit(wall(0.3), [target], 1.0, FitSettings(iterations=1, budget=0, coarse_part=0.0), surround=shell)
    shown = render_before(shell, wall(0.3), eye, Effects()).color
    assert float((seen[0] - shown).abs().max()) < 0.01


def test_it_grows_with_the_splat(shell):
    far = torch.tensor([[0.0, 200.0, 0.0]])
    larger = beyond(shell, far, 1.0)
    assert float(larger.means.norm(dim=1).min()) > 200.0
    torch.testing.assert_close(beyond(shell, torch.zeros(1, 3), 1.0).means, shell.means)
    for target in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.2)):
        before, after = (behind_view(each, camera(target)) for each in (shell, larger))
        assert before.shape == (SURROUND.rows, SURROUND.rows, 3)
        torch.testing.assert_close(before, after, atol=1e-3, rtol=0)
