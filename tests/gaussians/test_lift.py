"""Lifting masks: weights against one gaussian at a time, and exactly the ball that the masks show."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from diga3d_warp.gaussians.lift import LiftSettings, Votes, object_mask, object_rows, vote
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.scene.camera import Camera, look_at
from diga3d_warp.splatting.render import render

SETTINGS = LiftSettings()
WIDTH, HEIGHT = 64, 48


def lit(gaussians: Gaussians, rows: torch.Tensor) -> Gaussians:
    """The gaussians in black, but for some rows in white."""
    copy = gaussians.detached()
    copy.sh = torch.full((len(copy), 1, 3), -0.5 / 0.28209479177387814)
    copy.sh[rows] *= -1.0
    return copy


def ball(center, radius: float, count: int, seed: int) -> torch.Tensor:
    """Positions on a sphere, and one in twenty inside it."""
    random = np.random.default_rng(seed)
    directions = random.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    shell = np.where(np.arange(count) % 20 == 0, 0.3, 1.0)[:, None]
    return torch.tensor(np.asarray(center) + radius * shell * directions, dtype=torch.float32)


@pytest.fixture(scope="module")
def balls():
    """Two opaque balls and cameras on an arc, the rows of the first, and the masks where it shows."""
    means = torch.cat([ball([-0.5, 0.0, 0.0], 0.35, 400, 0), ball([0.5, 0.1, 0.0], 0.35, 400, 1)])
    gaussians = Gaussians(
        means=means,
        log_scales=torch.full((800, 3), float(np.log(0.04))),
        quaternions=torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(800, 1),
        opacity_logits=torch.full((800,), 3.0),
        sh=torch.zeros(800, 1, 3),
    )
    first = torch.arange(800) < 400
    cameras = []
    for angle in np.linspace(np.pi / 3, 5 * np.pi / 3, 12):
        eye = [3.0 * np.cos(angle), 3.0 * np.sin(angle), 1.2]
        pose = torch.from_numpy(look_at(np.array(eye), np.zeros(3)))
        cameras.append(Camera(WIDTH, HEIGHT, 70.0, 70.0, WIDTH / 2, HEIGHT / 2, pose))
    shows = lit(gaussians, first)
    masks = [render(shows, camera).color[..., 0].numpy() > 0.5 for camera in cameras]
    assert all(40 < mask.sum() < 600 for mask in masks)
    return gaussians, first, cameras, masks


def test_the_masked_ball_is_picked_with_its_inside(balls):
    gaussians, first, cameras, masks = balls
    votes = vote(gaussians, cameras, masks)
    inside = torch.arange(400) % 20 == 0
    assert (votes.total[:400][inside] < SETTINGS.faint).sum() > 10, "some of the inside is hardly seen"
    assert torch.equal(object_rows(votes, SETTINGS), first)


@pytest.mark.parametrize("flaw", ["one pixel off", "one mask empty"])
def test_flawed_masks_pick_nearly_the_same(balls, flaw):
    gaussians, first, cameras, masks = balls
    random = np.random.default_rng(3)
    flawed = [np.roll(m, random.integers(-1, 2, 2), (0, 1)) if "pixel" in flaw else m for m in masks]
    if "empty" in flaw:
        flawed[2] = np.zeros_like(masks[2])
    rows = object_rows(vote(gaussians, cameras, flawed), SETTINGS)
    assert (rows != first).float().mean() < 0.02


def test_votes_are_sums_over_views(balls):
    gaussians, _, cameras, masks = balls
    every = vote(gaussians, cameras, masks)
    parts = [vote(gaussians, [c], [m]) for c, m in zip(cameras, masks, strict=True)]
    for name in ("masked", "total", "inside", "visible"):
        total = sum(getattr(part, name) for part in parts)
        torch.testing.assert_close(getattr(every, name), total, msg=name)
    alpha = sum(float(render(gaussians, camera).alpha.sum()) for camera in cameras)
    assert float(every.total.sum()) == pytest.approx(alpha, rel=1e-4), "weights of a pixel sum to its opacity"
    assert (every.share <= 1.0 + 1e-5).all() and (every.share >= 0.0).all()


def test_a_gaussian_that_nobody_sees_is_none_of_the_object(balls):
    gaussians, first, cameras, masks = balls
    away = gaussians.select(torch.tensor([0]))
    away.means[:] = torch.tensor([0.0, 0.0, 40.0])
    votes = vote(gaussians.joined(away), cameras, masks)
    assert (votes.visible[-1], votes.total[-1], votes.share[-1]) == (0, 0, 0)
    assert torch.equal(object_rows(votes, SETTINGS)[:-1], first)
    assert not object_rows(votes, SETTINGS)[-1]


def test_thresholds():
    def rows(masked: float, total: float, inside: int, visible: int) -> bool:
        values = (torch.tensor([float(value)]) for value in (masked, total, inside, visible))
        return bool(object_rows(Votes(*values), SETTINGS))

    assert rows(6, 10, 0, 8) and not rows(4, 10, 8, 8), "seen: the weight decides"
    assert rows(0, 0.5, 8, 8) and not rows(0.5, 0.5, 5, 8), "hardly seen: the hull decides"


def test_the_object_mask_is_what_shows_of_it(balls):
    gaussians, first, cameras, masks = balls
    for camera, mask in zip(cameras, masks, strict=True):
        np.testing.assert_array_equal(object_mask(gaussians, camera, first, LiftSettings()), mask)
    front = cameras[6]  # from the side of the first ball: it hides most of the second
    assert (
        object_mask(gaussians, front, ~first, LiftSettings()).sum()
        < 0.7
        * object_mask(
            gaussians.select(~first), front, torch.ones(400, dtype=torch.bool), LiftSettings()
        ).sum()
    )
    assert not object_mask(gaussians, front, torch.zeros(800, dtype=torch.bool), LiftSettings()).any()


def test_empty_masks_pick_nothing(balls):
    gaussians, _, cameras, masks = balls
    assert not object_rows(vote(gaussians, cameras, [np.zeros_like(m) for m in masks]), SETTINGS).any()
    assert object_rows(vote(gaussians, cameras, [np.ones_like(m) for m in masks]), SETTINGS).all()
