"""Density control: a split keeps the image, faded gaussians move, held ones stay."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from diga3d_warp.gaussians.density import DensitySettings, relocate_and_grow, spread_out, walk
from diga3d_warp.gaussians.optimiser import GaussianAdam, LearningRates
from scenes import random_gaussians, single

SETTINGS = DensitySettings()
SEEN = torch.zeros(40, dtype=torch.bool)


def adam(gaussians) -> GaussianAdam:
    return GaussianAdam(gaussians, LearningRates())


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def test_copies_together_have_the_shape_of_the_original():
    original = single(log_scales=[-1.0, -2.0, -3.0], quaternions=[0.8, 0.2, -0.5, 0.3])
    count = 20_000
    copies = spread_out(original.select(torch.zeros(count, dtype=torch.int64)), 0.8, generator())
    turn = rotation(original.quaternions[0])
    shape = turn @ np.diag(np.exp(2.0 * original.log_scales[0].double().numpy())) @ turn.T
    own = turn @ np.diag(np.exp(2.0 * copies.log_scales[0].double().numpy())) @ turn.T
    places = copies.means.double().numpy()
    np.testing.assert_allclose(np.cov(places.T) + own, shape, atol=0.03 * shape.max())
    np.testing.assert_allclose(places.mean(0), original.means[0].numpy(), atol=0.02)
    assert own.max() < 0.5 * shape.max()
    assert torch.equal(copies.sh[0], original.sh[0])
    assert torch.equal(copies.opacity_logits[:1], original.opacity_logits)


def faded(count: int = 40, dead: int = 8):
    """Gaussians of which the first few have faded."""
    gaussians = random_gaussians(count, seed=2)
    gaussians.opacity_logits = gaussians.opacity_logits.clamp(min=-2.0)
    gaussians.opacity_logits[:dead] = -8.0
    return gaussians


def even(count: int) -> torch.Tensor:
    """The same pull on every gaussian."""
    return torch.ones(count)


def sources_of(sh: torch.Tensor, others: torch.Tensor) -> torch.Tensor:
    """Which of N gaussians has the colours of which of M others, shape (N, M): copies keep their colours."""
    return (sh[:, None] == others[None]).flatten(2).all(dim=2)


def test_faded_gaussians_move_onto_visible_ones():
    start = faded()
    optimiser = adam(start)
    assert relocate_and_grow(optimiser, 40, even(40), SEEN, SETTINGS, generator()).tolist() == list(range(8))
    after = optimiser.gaussians().detached()
    assert len(after) == 40
    assert (after.opacities > SETTINGS.dead_opacity).all()
    matches = sources_of(after.sh[:8], start.sh[8:])
    assert (matches.sum(dim=1) == 1).all()
    sources = matches.int().argmax(dim=1) + 8
    apart = (after.means[:8] - start.means[sources]).norm(dim=1)
    assert (apart > 0.0).all()
    assert (apart < 4.0 * start.scales[sources].max(dim=1).values).all()
    assert (after.log_scales[sources] < start.log_scales[sources]).all()
    untouched = torch.ones(40, dtype=torch.bool)
    untouched[:8] = untouched[sources] = False
    assert untouched.sum() > 10
    for (name, now), (_, then) in zip(after.named(), start.named(), strict=True):
        torch.testing.assert_close(now[untouched], then[untouched], rtol=0, atol=0, msg=name)


def test_gaussians_that_no_image_shows_move_and_nothing_moves_onto_them():
    start = faded(dead=0)
    unseen = torch.arange(40) < 15
    optimiser = adam(start)
    rows = relocate_and_grow(optimiser, 70, even(40), unseen, SETTINGS, generator())
    assert rows.tolist() == [*range(15), *range(40, 70)]
    assert sources_of(optimiser.gaussians().sh[rows], start.sh[15:]).any(dim=1).all()


@pytest.mark.parametrize("wanted", [40, 41, 70, 300])
def test_the_wanted_number_is_reached(wanted):
    optimiser = adam(faded())
    rows = relocate_and_grow(optimiser, wanted, even(40), SEEN, SETTINGS, generator())
    assert rows.tolist() == [*range(8), *range(40, wanted)]
    gaussians = optimiser.gaussians().detached()
    assert len(gaussians) == wanted
    for name, tensor in gaussians.named():
        assert torch.isfinite(tensor).all(), name


def test_gaussians_are_never_removed():
    optimiser = adam(faded(dead=0))
    assert len(relocate_and_grow(optimiser, 5, even(40), SEEN, SETTINGS, generator())) == 0
    assert len(optimiser.gaussians()) == 40


def test_where_all_have_faded_nothing_moves():
    start = faded(dead=40)
    optimiser = adam(start)
    assert len(relocate_and_grow(optimiser, 60, even(40), SEEN, SETTINGS, generator())) == 0
    torch.testing.assert_close(optimiser.gaussians().means, start.means)


def test_held_gaussians_are_neither_moved_nor_chosen():
    start = faded()
    held = torch.zeros(40, dtype=torch.bool)
    held[4:30] = True  # four that have faded, and most of the visible ones
    optimiser = adam(start)
    rows = relocate_and_grow(optimiser, 90, even(40), SEEN, SETTINGS, generator(), held)
    assert rows.tolist() == [*range(4), *range(40, 90)]
    after = optimiser.gaussians().detached()
    for (name, now), (_, then) in zip(after.named(), start.named(), strict=True):
        torch.testing.assert_close(now[:40][held], then[held], rtol=0, atol=0, msg=name)
    matches = sources_of(torch.cat([after.sh[:4], after.sh[40:]]), start.sh[30:])
    assert matches.any(dim=1).all(), "copies come from free rows only"


def test_gaussians_that_are_pulled_harder_are_chosen_more_often():
    gaussians = random_gaussians(2, seed=1)
    optimiser = adam(gaussians)
    relocate_and_grow(optimiser, 1002, torch.tensor([0.9, 0.1]), SEEN[:2], SETTINGS, generator())
    share = sources_of(optimiser.gaussians().sh[2:], gaussians.sh)[:, 0].float().mean().item()
    assert 0.87 < share < 0.93


def test_the_same_generator_makes_the_same_choices():
    results = []
    for seed in (3, 3, 4):
        optimiser = adam(faded())
        relocate_and_grow(optimiser, 80, even(40), SEEN, SETTINGS, generator(seed))
        results.append(optimiser.gaussians().detached().means)
    assert torch.equal(results[0], results[1])
    assert not torch.equal(results[0], results[2])


def flat(opacity: float, count: int = 4000):
    """Gaussians alike, long along a turned axis, so that their walk has a shape."""
    one = single(log_scales=[-1.0, -3.0, -5.0], quaternions=[0.8, 0.2, -0.5, 0.3])
    gaussians = one.select(torch.zeros(count, dtype=torch.int64))
    gaussians.opacity_logits[:] = float(np.log(opacity / (1 - opacity)))
    return gaussians


def rotation(quaternion: torch.Tensor) -> np.ndarray:
    w, x, y, z = (quaternion / quaternion.norm()).double().tolist()
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def test_faint_gaussians_walk_by_their_own_covariance():
    """3DGS-MCMC Eq. 8: the step is Sigma times noise, so its covariance is Sigma squared times a number."""
    gaussians = flat(0.006)
    walking = gaussians.detached()
    walk(walking, 5e-4, SETTINGS, generator())
    steps = (walking.means - gaussians.means).double().numpy()
    turn = rotation(gaussians.quaternions[0])
    sigma = turn @ np.diag(np.exp(2.0 * gaussians.log_scales[0].double().numpy())) @ turn.T
    gate = 1 / (1 + np.exp(-100.0 * ((1 - 0.006) - 0.995)))
    expected = (gate * SETTINGS.noise * 5e-4) ** 2 * sigma @ sigma
    np.testing.assert_allclose(np.cov(steps.T), expected, atol=0.08 * expected.max())
    for name, tensor in walking.named():
        assert torch.equal(tensor, getattr(gaussians, name)) == (name != "means"), name


def test_opaque_and_held_gaussians_do_not_walk():
    gaussians = flat(0.006, count=20)
    gaussians.opacity_logits[:10] = 0.0
    held = torch.zeros(20, dtype=torch.bool)
    held[10:15] = True
    walking = gaussians.detached()
    walk(walking, 5e-4, SETTINGS, generator(), held)
    moved = (walking.means != gaussians.means).any(dim=1)
    assert moved.tolist() == [False] * 15 + [True] * 5
