"""Noise levels and DDIM steps, against diffusers' scheduler where it is installed."""

import pytest
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.priors.schedule import Schedule
from tiny_diffusion import NOISE_LEVELS


def test_a_step_down_and_up_is_the_identity():
    schedule = Schedule.scaled_linear()
    z, noise = torch.randn(2, 1, 4, 8, 8, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    for t, to in [(981, 961), (21, 1), (1, None)]:
        there = schedule.step(z, noise, t, to)
        assert not torch.allclose(there, z, atol=1e-3)
        torch.testing.assert_close(schedule.step(there, noise, to, t), z)


def test_the_true_noise_leads_to_the_clean_image_in_one_step():
    schedule = Schedule.scaled_linear()
    x, noise = torch.randn(2, 1, 4, 8, 8, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    z = schedule.add_noise(x, noise, 500)
    torch.testing.assert_close(schedule.denoise(z, noise, 500), x)
    torch.testing.assert_close(schedule.step(z, noise, 500, 40), schedule.add_noise(x, noise, 40))


@pytest.mark.parametrize("steps", [1, 7, 20, 50])
def test_the_levels_and_steps_are_those_of_diffusers(steps):
    diffusers = pytest.importorskip("diffusers")
    ddim = diffusers.DDIMScheduler(**NOISE_LEVELS)
    ddim.set_timesteps(steps)
    schedule = Schedule.scaled_linear()
    timesteps = schedule.timesteps(steps)
    assert timesteps == ddim.timesteps.tolist()
    z, noise = torch.randn(2, 1, 4, 8, 8, generator=torch.Generator().manual_seed(4))
    for t, to in zip(timesteps, [*timesteps[1:], None], strict=True):
        torch.testing.assert_close(schedule.step(z, noise, t, to), ddim.step(noise, t, z).prev_sample)


@pytest.mark.parametrize("steps", [0, 1001])
def test_a_number_of_steps_that_there_is_not(steps):
    with pytest.raises(InputError, match=f"{steps} diffusion steps are not between 1 and 1000"):
        Schedule.scaled_linear().timesteps(steps)
