"""Adam over a changing number of gaussians: nobody's moments suffer, and a saved state goes on exactly."""

from __future__ import annotations

import io

import pytest
import torch

from diga3d_warp.gaussians.optimiser import GaussianAdam, LearningRates
from scenes import random_gaussians

COUNT = 12
RATES = LearningRates()


def pulled(seed: int = 0) -> GaussianAdam:
    """An optimiser after three steps."""
    optimiser = GaussianAdam(random_gaussians(COUNT, seed), RATES)
    for k in range(3):
        pull(optimiser, k)
    return optimiser


def pull(optimiser: GaussianAdam, k: int, held=None, visible=None) -> None:
    """A step with a gradient that differs in every entry and step."""
    random = torch.Generator().manual_seed(100 + k)
    gradients = {
        name: torch.randn(tensor.shape, generator=random) for name, tensor in optimiser.gaussians().named()
    }
    optimiser.step(gradients, RATES.of_means(k / 10, 2.0), held, visible)


def moments(optimiser: GaussianAdam) -> dict[tuple[str, int], torch.Tensor]:
    return {
        (name, k): moment.clone() for name, pair in optimiser.moments.items() for k, moment in enumerate(pair)
    }


def values(optimiser: GaussianAdam) -> dict[str, torch.Tensor]:
    return {name: tensor.detach().clone() for name, tensor in optimiser.tensors.items()}


def same(a: dict, b: dict) -> None:
    assert a.keys() == b.keys()
    for key in a:
        torch.testing.assert_close(a[key], b[key], rtol=0, atol=0, msg=str(key))


def test_overwritten_rows_start_anew_and_the_others_keep_their_moments():
    optimiser, fresh, rows = pulled(), random_gaussians(2, seed=9), torch.tensor([1, 7])
    others = [k for k in range(COUNT) if k not in rows]
    before, values_before = moments(optimiser), values(optimiser)
    optimiser.overwrite(rows, fresh)
    torch.testing.assert_close(optimiser.gaussians().means[rows], fresh.means, rtol=0, atol=0)
    torch.testing.assert_close(optimiser.gaussians().sh[rows], fresh.sh, rtol=0, atol=0)
    for key, moment in moments(optimiser).items():
        assert not moment[rows].any()
        assert before[key][others].any()
        torch.testing.assert_close(moment[others], before[key][others], rtol=0, atol=0)
    for name, tensor in values(optimiser).items():
        torch.testing.assert_close(tensor[others], values_before[name][others], rtol=0, atol=0)


def test_appended_rows_start_anew_and_the_others_keep_their_moments():
    optimiser, added = pulled(), random_gaussians(3, seed=9)
    before, values_before = moments(optimiser), values(optimiser)
    optimiser.append(added)
    assert len(optimiser.gaussians()) == COUNT + 3
    torch.testing.assert_close(optimiser.gaussians().quaternions[COUNT:], added.quaternions, rtol=0, atol=0)
    same({key: moment[:COUNT] for key, moment in moments(optimiser).items()}, before)
    assert not any(moment[COUNT:].any() for moment in moments(optimiser).values())
    pull(optimiser, 3)
    moved = {name: tensor[:COUNT] for name, tensor in values(optimiser).items()}
    assert all((moved[name] != values_before[name]).any() for name in moved)
    assert (optimiser.gaussians().means[COUNT:] != added.means).all(), "added rows learn"


def test_rows_may_change_before_the_first_step():
    optimiser = GaussianAdam(random_gaussians(COUNT), RATES)
    optimiser.overwrite(torch.tensor([0]), random_gaussians(1, seed=4))
    optimiser.append(random_gaussians(2, seed=5))
    pull(optimiser, 0)
    assert torch.isfinite(optimiser.gaussians().means).all()


@pytest.mark.parametrize("into", [COUNT, 3])
def test_a_saved_state_goes_on_to_the_same_bytes(into):
    whole = pulled()
    whole.append(random_gaussians(2, seed=9))
    stored = io.BytesIO()
    torch.save(whole.state_dict(), stored)
    stored.seek(0)
    resumed = GaussianAdam(random_gaussians(into, seed=5), RATES)
    resumed.load_state_dict(torch.load(stored, weights_only=True))
    for optimiser in (whole, resumed):
        for k in range(3, 6):
            pull(optimiser, k)
        optimiser.append(random_gaussians(1, seed=11))
        pull(optimiser, 6)
    same(values(resumed), values(whole))
    same(moments(resumed), moments(whole))


def test_held_rows_keep_their_bits():
    start = random_gaussians(COUNT)
    optimiser = GaussianAdam(start, RATES)
    held = torch.arange(COUNT) < 5
    for k in range(4):
        pull(optimiser, k, held)
    for (name, tensor), (_, first) in zip(optimiser.gaussians().named(), start.named(), strict=True):
        torch.testing.assert_close(tensor[held], first[held], rtol=0, atol=0, msg=name)
        assert (tensor[~held] != first[~held]).all(), name


def test_rates_are_in_the_units_of_the_parameters_and_the_extent():
    start = random_gaussians(COUNT)
    rates = LearningRates(
        means=2e-4, means_final=3e-6, log_scales=5e-3, quaternions=1e-3, opacity_logits=4e-2, sh_dc=2e-3
    )
    optimiser = GaussianAdam(start, rates)
    ones = {name: torch.ones_like(tensor) for name, tensor in optimiser.tensors.items()}
    optimiser.step(ones, rates.of_means(0.0, extent=3.0))
    moved = {
        name: (tensor.detach() - getattr(start, name)).abs() for name, tensor in optimiser.tensors.items()
    }
    moved["sh_rest"], moved["sh_dc"] = moved["sh"][:, 1:], moved.pop("sh")[:, :1]
    expected = {
        "means": 6e-4, "log_scales": 5e-3, "quaternions": 1e-3, "opacity_logits": 4e-2,
        "sh_dc": 2e-3, "sh_rest": 1e-4,
    }  # fmt: skip
    assert moved.keys() == expected.keys()
    for name, rate in expected.items():
        assert moved[name].min().item() == pytest.approx(rate, rel=2e-2), name
        assert moved[name].max().item() == pytest.approx(rate, rel=2e-2), name
    assert rates.of_means(1.0, extent=3.0) == pytest.approx(9e-6)
    assert rates.of_means(0.5, extent=1.0) == pytest.approx((2e-4 * 3e-6) ** 0.5)


def test_the_start_is_copied():
    start = random_gaussians(COUNT)
    before = start.detached()
    optimiser = GaussianAdam(start, RATES)
    pull(optimiser, 0)
    for (_, now), (_, then) in zip(start.named(), before.named(), strict=True):
        assert torch.equal(now, then) and not now.requires_grad


def test_steps_are_those_of_torch():
    """Thousands of rows, so that vector loops and what is left over of them both run."""
    start = random_gaussians(3000)
    optimiser = GaussianAdam(start, RATES)
    leaves = {name: tensor.double().requires_grad_() for name, tensor in start.detached().named()}
    groups = [{"params": [leaf], "lr": 1e-2} for leaf in leaves.values()]
    reference = torch.optim.Adam(groups, eps=1e-15)
    for k in range(5):
        random = torch.Generator().manual_seed(k)
        gradients = {}
        for name, tensor in optimiser.tensors.items():
            gradients[name] = torch.randn(tensor.shape, generator=random)
            leaves[name].grad = gradients[name].double()
        for group, name in zip(reference.param_groups, leaves, strict=True):
            group["lr"] = {
                "means": 1e-3 * 0.01 ** (k / 10), "log_scales": 1e-2, "quaternions": 3e-3,
                "opacity_logits": 5e-2, "sh": 5e-3,
            }[name]  # fmt: skip
        optimiser.step(gradients, RATES.of_means(k / 10, extent=2.0))
        reference.step()
    for name, tensor in optimiser.tensors.items():
        first = dict(start.named())[name]
        moved, expected = tensor.detach() - first, leaves[name].detach() - first
        if name == "sh":
            expected[:, 1:] /= 20
        error = (moved.double() - expected).abs()
        rounding = 5 * 1.2e-7 * first.double().abs()
        assert (error < 1e-5 * expected.abs().max() + rounding).all(), name


def test_rows_that_are_not_visible_keep_value_and_moments():
    optimiser = pulled()
    before, moments_before = values(optimiser), moments(optimiser)
    visible = torch.arange(COUNT) % 3 == 0
    held = torch.arange(COUNT) == 3
    moving = visible & ~held
    pull(optimiser, 4, held, visible)
    for name, tensor in values(optimiser).items():
        torch.testing.assert_close(tensor[~moving], before[name][~moving], rtol=0, atol=0)
        assert (tensor[moving] != before[name][moving]).all(), name
    for key, moment in moments(optimiser).items():
        torch.testing.assert_close(moment[~moving], moments_before[key][~moving], rtol=0, atol=0)
        assert (moment[moving] != moments_before[key][moving]).all(), key


def test_bits_do_not_depend_on_the_number_of_threads(threads):
    results = []
    for count in (1, 2, 3, 7):
        threads(count)
        optimiser = GaussianAdam(random_gaussians(5000), RATES)
        for k in range(2):
            pull(optimiser, k, visible=torch.arange(5000) % 5 != 0)
        results.append(values(optimiser))
    for other in results[1:]:
        same(other, results[0])
