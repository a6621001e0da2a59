"""DDIM inversion, on a prior whose estimates are exact."""

import pytest
import torch

from diga3d_warp.priors.conditioning import Conditioning, Guidance, Prompts
from diga3d_warp.priors.inversion import invert
from diga3d_warp.priors.sampling import ViewLatents, sample_views
from diga3d_warp.priors.settings import SamplingSettings
from gaussian_prior import GaussianPrior
from tiny_diffusion import NOISE_LEVELS


def there_and_back(steps, fixed_point=True, strength=1.0):
    prior = GaussianPrior()
    x = 0.2 + 0.3 * torch.randn(1, 3, 8, 8, generator=torch.Generator().manual_seed(7))
    cond = Conditioning(x, torch.ones(1, 1, 8, 8))
    z = invert(prior, x, 0.4, cond, steps=steps, fixed_point=fixed_point, strength=strength)
    settings = SamplingSettings(steps=steps, strength=strength)
    back = sample_views(prior, ViewLatents(z, cond), Guidance(Prompts(0.4, 0.0), scale=1.0), settings)
    return x, z, float((back - x).abs().max())


def test_inversion_follows_the_exact_flow():
    x, z, _ = there_and_back(250)
    torch.testing.assert_close(z, (x - 0.4) / 0.3, atol=0.1, rtol=0.0)


def test_sampling_returns_the_better_the_more_steps():
    errors = [there_and_back(steps)[2] for steps in (10, 40, 160)]
    assert errors[0] > 2.0 * errors[1] > 4.0 * errors[2]


@pytest.mark.parametrize("steps", [20, 50])
def test_the_fixed_point_iteration_brings_it_closer(steps):
    assert there_and_back(steps)[2] < 0.7 * there_and_back(steps, fixed_point=False)[2]


def test_a_part_of_the_way():
    x, z, error = there_and_back(50, strength=0.4)
    assert error < 0.05
    first = GaussianPrior().schedule.timesteps(50, 0.4)[0]
    assert first == 381
    assert float((z - x).abs().max()) > 0.1


def test_the_steps_are_those_of_diffusers():
    diffusers = pytest.importorskip("diffusers")
    prior = GaussianPrior()
    inverse = diffusers.DDIMInverseScheduler(**NOISE_LEVELS)
    inverse.set_timesteps(20)
    x = z = torch.randn(1, 3, 8, 8, generator=torch.Generator().manual_seed(7))
    for t in inverse.timesteps:
        z = inverse.step(prior.predict_noise(z, int(t), 0.4), int(t), z).prev_sample
    torch.testing.assert_close(invert(prior, x, 0.4, steps=20, fixed_point=False), z)
