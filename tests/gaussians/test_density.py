"""Density control: a split keeps the image, faded gaussians move, held ones stay."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from diga3d_warp.gaussians.density import DensitySettings, relocate_and_grow, split, walk
from diga3d_warp.gaussians.optimiser import GaussianAdam, LearningRates
from diga3d_warp.splatting.render import render
from scenes import camera_at, random_gaussians, single

SETTINGS = DensitySettings()
OPACITIES = [0.02, 0.3, 0.7, 0.95, 0.99]


def adam(gaussians) -> GaussianAdam:
    return GaussianAdam(gaussians, LearningRates(), extent=1.0)


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


@pytest.mark.parametrize("copies", [1, 2, 3, 10, 51])
def test_the_opacities_of_copies_compose_to_the_old_one(copies):
    old = torch.tensor([0.3, 0.7, 0.95, 0.999])
    new, _ = split(old, torch.ones(4, 3), torch.full((4,), copies), SETTINGS)
    torch.testing.assert_close(1 - (1 - new.double()) ** copies, old.double(), rtol=2e-5, atol=1e-7)


@pytest.mark.parametrize("opacity", OPACITIES[1:])
@pytest.mark.parametrize("copies", [2, 5, 20, 51])
def test_copies_on_one_spot_cover_as_much_as_the_original(opacity, copies):
    """3DGS-MCMC Eq. 9: along a line, the blended copies have the integral of the original."""
    new, scale = split(torch.tensor([opacity]), torch.ones(1, 3), torch.tensor([copies]), SETTINGS)
    x = np.linspace(-12, 12, 20_001)
    original = opacity * np.exp(-0.5 * x**2)
    blended = 1 - (1 - new.item() * np.exp(-0.5 * (x / scale[0, 0].item()) ** 2)) ** copies
    assert blended.sum() == pytest.approx(original.sum(), rel=1e-4)
    assert scale.max() < 1.0


@pytest.mark.parametrize("copies", [2, 6])
@pytest.mark.parametrize("opacity", [0.3, 0.8])
def test_a_split_gaussian_looks_like_the_original(opacity, copies):
    logit = float(np.log(opacity / (1 - opacity)))
    original, camera = single(opacity_logits=logit), camera_at()
    new, scales = split(original.opacities, original.scales, torch.tensor([copies]), SETTINGS)
    several = original.select(torch.zeros(copies, dtype=torch.int64))
    several.opacity_logits[:], several.log_scales[:] = torch.logit(new), torch.log(scales)
    plain = original.select(torch.zeros(copies, dtype=torch.int64))
    image, split_image, plain_image = (
        render(each, camera).color.double() for each in (original, several, plain)
    )
    assert image.max() > 0.2, "not blank"
    assert (split_image - image).abs().max() < 0.1 * image.max()
    # In the plane the equation of a line keeps the sum to a fifth; plain copies double it.
    assert 0.8 < split_image.sum() / image.sum() < 1.05
    assert plain_image.sum() / image.sum() > 1.4


def faded(count: int = 40, dead: int = 8):
    """Gaussians of which the first few have faded."""
    gaussians = random_gaussians(count, seed=2)
    gaussians.opacity_logits = gaussians.opacity_logits.clamp(min=-2.0)
    gaussians.opacity_logits[:dead] = -8.0
    return gaussians


def on_the_same_spot(means: torch.Tensor, others: torch.Tensor) -> torch.Tensor:
    """Which of N positions equal which of M others, shape (N, M)."""
    return (means[:, None] == others[None]).all(dim=2)


def test_faded_gaussians_move_onto_visible_ones():
    start = faded()
    optimiser = adam(start)
    assert relocate_and_grow(optimiser, 40, SETTINGS, generator()) == 8
    after = optimiser.gaussians().detached()
    assert len(after) == 40
    assert (after.opacities > SETTINGS.dead_opacity).all()
    spots = on_the_same_spot(after.means[:8], start.means[8:])
    assert (spots.sum(dim=1) == 1).all()
    sources = spots.int().argmax(dim=1) + 8
    torch.testing.assert_close(after.means[8:], start.means[8:], rtol=0, atol=0)
    torch.testing.assert_close(after.sh[:8], start.sh[sources], rtol=0, atol=0)
    torch.testing.assert_close(after.log_scales[:8], after.log_scales[sources], rtol=0, atol=0)
    untouched = torch.ones(40, dtype=torch.bool)
    untouched[:8] = untouched[sources] = False
    assert untouched.sum() > 10
    for (name, now), (_, then) in zip(after.named(), start.named(), strict=True):
        torch.testing.assert_close(now[untouched], then[untouched], rtol=0, atol=0, msg=name)
    transparency = 1 - after.opacities
    composed = 1 - transparency.clone().scatter_reduce(0, sources, transparency[:8], reduce="prod")
    torch.testing.assert_close(composed[8:], start.opacities[8:], rtol=2e-4, atol=1e-5)


@pytest.mark.parametrize("wanted", [40, 41, 70, 300])
def test_the_wanted_number_is_reached(wanted):
    optimiser = adam(faded())
    assert relocate_and_grow(optimiser, wanted, SETTINGS, generator()) == 8 + wanted - 40
    gaussians = optimiser.gaussians().detached()
    assert len(gaussians) == wanted
    for name, tensor in gaussians.named():
        assert torch.isfinite(tensor).all(), name


def test_gaussians_are_never_removed():
    optimiser = adam(faded(dead=0))
    assert relocate_and_grow(optimiser, 5, SETTINGS, generator()) == 0
    assert len(optimiser.gaussians()) == 40


def test_where_all_have_faded_nothing_moves():
    start = faded(dead=40)
    optimiser = adam(start)
    assert relocate_and_grow(optimiser, 60, SETTINGS, generator()) == 0
    torch.testing.assert_close(optimiser.gaussians().means, start.means)


def test_held_gaussians_are_neither_moved_nor_chosen():
    start = faded()
    held = torch.zeros(40, dtype=torch.bool)
    held[4:30] = True  # four that have faded, and most of the visible ones
    optimiser = adam(start)
    assert relocate_and_grow(optimiser, 90, SETTINGS, generator(), held) == 4 + 50
    after = optimiser.gaussians().detached()
    for (name, now), (_, then) in zip(after.named(), start.named(), strict=True):
        torch.testing.assert_close(now[:40][held], then[held], rtol=0, atol=0, msg=name)
    spots = on_the_same_spot(torch.cat([after.means[:4], after.means[40:]]), start.means[30:])
    assert spots.any(dim=1).all(), "copies come from free rows only"


def test_opaque_gaussians_are_chosen_more_often():
    gaussians = random_gaussians(2, seed=1)
    gaussians.opacity_logits[:] = torch.logit(torch.tensor([0.9, 0.1]))
    optimiser = adam(gaussians)
    relocate_and_grow(optimiser, 1002, SETTINGS, generator())
    added = optimiser.gaussians().means[2:]
    share = (added == gaussians.means[0]).all(dim=1).float().mean().item()
    assert 0.87 < share < 0.93


def test_the_same_generator_makes_the_same_choices():
    results = []
    for seed in (3, 3, 4):
        optimiser = adam(faded())
        relocate_and_grow(optimiser, 80, SETTINGS, generator(seed))
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
    optimiser = adam(gaussians)
    walk(optimiser, SETTINGS, generator())
    steps = (optimiser.tensors["means"].detach() - gaussians.means).double().numpy()
    turn = rotation(gaussians.quaternions[0])
    sigma = turn @ np.diag(np.exp(2.0 * gaussians.log_scales[0].double().numpy())) @ turn.T
    gate = 1 / (1 + np.exp(-100.0 * ((1 - 0.006) - 0.995)))
    expected = (gate * 5e5 * 1.6e-4) ** 2 * sigma @ sigma
    np.testing.assert_allclose(np.cov(steps.T), expected, atol=0.08 * expected.max())
    others = {name: tensor for name, tensor in optimiser.tensors.items() if name != "means"}
    assert torch.equal(others["log_scales"].detach(), gaussians.log_scales)


def test_opaque_and_held_gaussians_do_not_walk():
    gaussians = flat(0.006, count=20)
    gaussians.opacity_logits[:10] = 0.0
    held = torch.zeros(20, dtype=torch.bool)
    held[10:15] = True
    optimiser = adam(gaussians)
    walk(optimiser, SETTINGS, generator(), held)
    moved = (optimiser.tensors["means"].detach() != gaussians.means).any(dim=1)
    assert moved.tolist() == [False] * 15 + [True] * 5
