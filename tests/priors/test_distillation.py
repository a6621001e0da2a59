"""Score distillation, on a prior whose estimates are exact."""

import pytest
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.priors.conditioning import Control, Guidance, Prompts
from diga3d_warp.priors.distillation import (
    DistillationSettings,
    TextureGeometryGuide,
    distillation_loss,
    distillation_timestep,
)
from diga3d_warp.priors.guidance import guided_noise
from diga3d_warp.priors.schedule import Schedule
from gaussian_prior import GaussianPrior

GUIDANCE = Guidance(Prompts(0.4, -0.1), scale=3.0)


@pytest.fixture
def images():
    return torch.rand(2, 8, 10, 3, generator=torch.Generator().manual_seed(1)).requires_grad_()


@pytest.fixture
def masks():
    masks = torch.zeros(2, 8, 10, dtype=torch.bool)
    masks[0, 2:5, 3:7] = True
    masks[1, 4:, :4] = True
    return masks


def gradient(prior, images, masks, t=500, seed=3, controls=()):
    generator = torch.Generator().manual_seed(seed)
    loss = distillation_loss(prior, images, masks, GUIDANCE, controls, t=t, generator=generator)
    return loss, torch.autograd.grad(loss, images)[0]


def test_the_gradient_is_that_of_the_paper(images, masks):
    prior = GaussianPrior()
    control = Control("depth", torch.rand(2, 8, 10, generator=torch.Generator().manual_seed(2)), 1.0)
    loss, found = gradient(prior, images, masks, controls=[control])
    z = prior.encode_image(images.detach())
    noise = torch.randn(z.shape, generator=torch.Generator().manual_seed(3))
    estimate = guided_noise(prior, prior.schedule.add_noise(z, noise, 500), 500, GUIDANCE, None, [control])
    on_latents = (1.0 - prior.schedule.alpha(500)) * (estimate - noise)
    torch.testing.assert_close(loss, on_latents.square().sum() / 2 / len(images))
    through_encoder = 2.0 * on_latents.permute(0, 2, 3, 1) / len(images)
    torch.testing.assert_close(found, through_encoder * masks[..., None])


@pytest.mark.parametrize("options", [{"blur": 5}, {"factor": 2}])
def test_unmasked_pixels_get_exactly_nothing(images, masks, options):
    """Although a latent is made of many pixels, masked and unmasked."""
    _, found = gradient(GaussianPrior(**options), images, masks)
    assert (found[masks] != 0.0).any(-1).all()
    assert (found[~masks] == 0.0).all()


def test_a_guide_is_the_weighted_loss_of_one_view(images, masks):
    prior = GaussianPrior()
    control = Control("edges", torch.ones(1, 8, 10), 0.8)
    settings = DistillationSettings(weight=0.25, annealed=False)
    guide = TextureGeometryGuide(prior, masks[0], GUIDANCE, (control,), settings=settings)
    found = guide(images[0], 0.3, torch.Generator().manual_seed(6))
    generator = torch.Generator().manual_seed(6)
    t = distillation_timestep(prior.schedule, 0.3, settings, generator)
    expected = distillation_loss(prior, images[:1], masks[:1], GUIDANCE, [control], t=t, generator=generator)
    torch.testing.assert_close(found, 0.25 * expected)


def test_what_is_not_a_number_is_left_out(images, masks):
    prior = GaussianPrior()
    exact = prior.predict_noise

    def broken(z, *args):
        noise = exact(z, *args).clone()
        noise[0, :, 3, 4] = torch.nan
        return noise

    prior.predict_noise = broken
    _, found = gradient(prior, images, masks)
    assert found.isfinite().all()
    assert (found[0, 3, 4] == 0.0).all()
    assert (found[0, 3, 5] != 0.0).all()


def test_following_it_leads_to_the_prompt(images, masks):
    prior, x = GaussianPrior(spread=0.05), images.detach().clone()
    guidance = Guidance(Prompts(0.4, 0.0), scale=1.0)
    generator = torch.Generator().manual_seed(5)
    settings = DistillationSettings()
    for step in range(200):
        x.requires_grad_()
        t = distillation_timestep(prior.schedule, step / 200, settings, generator)
        loss = distillation_loss(prior, x, masks, guidance, t=t, generator=generator)
        x = x.detach() - 0.1 * torch.autograd.grad(loss, x)[0]
    assert abs(float(x[masks].mean()) - 0.7) < 0.03
    assert torch.equal(x[~masks], images.detach()[~masks])


def test_the_same_generator_gives_the_same_bytes(images, masks):
    first, second, other = (gradient(GaussianPrior(), images, masks, seed=seed)[1] for seed in (3, 3, 4))
    assert torch.equal(first, second)
    assert not torch.equal(first, other)


def test_timesteps_fall_from_the_noisy_end_to_the_clean_one():
    schedule, settings = Schedule.scaled_linear(), DistillationSettings()
    generator = torch.Generator().manual_seed(0)
    steps = [distillation_timestep(schedule, k / 100, settings, generator) for k in range(101)]
    assert (steps[0], steps[25], steps[100]) == (980, 500, 20)
    assert steps == sorted(steps, reverse=True)


def test_timesteps_are_drawn_from_the_whole_range():
    schedule, settings = Schedule.scaled_linear(), DistillationSettings(t_min=0.2, t_max=0.6, annealed=False)
    generator = torch.Generator().manual_seed(0)
    steps = [distillation_timestep(schedule, 0.0, settings, generator) for _ in range(500)]
    assert 200 <= min(steps) < 210
    assert 590 < max(steps) < 600


def test_bad_settings_and_shapes(images, masks):
    with pytest.raises(InputError, match=r"timesteps from 0.5 to 0.5 are no range"):
        DistillationSettings(t_min=0.5, t_max=0.5)
    with pytest.raises(InputError, match=r"do not fit"):
        distillation_loss(GaussianPrior(), images, masks[:1], GUIDANCE, t=500, generator=torch.Generator())


def test_a_guide_shows_the_prior_its_window_only(images, masks):
    prior, window = GaussianPrior(), (slice(1, 7), slice(2, 9))
    control = Control("edges", torch.ones(1, 6, 7), 0.8)
    settings = DistillationSettings(weight=1.0)
    guide = TextureGeometryGuide(prior, masks[0], GUIDANCE, (control,), None, settings, window)
    loss = guide(images[0], 0.5, torch.Generator().manual_seed(6))
    cut = images[0][window][None]
    t = distillation_timestep(prior.schedule, 0.5, settings, torch.Generator())
    expected = distillation_loss(
        prior,
        cut,
        masks[0][window][None],
        GUIDANCE,
        [control],
        t=t,
        generator=torch.Generator().manual_seed(6),
    )
    torch.testing.assert_close(loss, expected)
    found = torch.autograd.grad(loss, images)[0][0]
    assert (found[masks[0]] != 0.0).any(-1).all() and (found[~masks[0]] == 0.0).all()


def test_controls_of_another_size_are_refused(images, masks):
    with pytest.raises(InputError, match=r"edges of \(16, 20\) do not fit prior gaussian"):
        gradient(GaussianPrior(), images, masks, controls=[Control("edges", torch.ones(2, 16, 20), 0.8)])
