"""Sampling of one view and of many, on a prior whose estimates are exact."""

from dataclasses import replace

import pytest
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.priors.attention import AttentionBank
from diga3d_warp.priors.conditioning import Conditioning, Control, Guidance, Prompts
from diga3d_warp.priors.guidance import guided_noise
from diga3d_warp.priors.inversion import invert
from diga3d_warp.priors.plan import plan_sampling
from diga3d_warp.priors.sampling import ViewLatents, initial_noise, sample_views
from diga3d_warp.priors.settings import SamplingSettings
from gaussian_prior import GaussianPrior

PLAIN = Guidance(Prompts(0.4, 0.0), scale=1.0)


def views_of(count, size=6, seed=0, controls=()):
    start = initial_noise((count, 3, size, size), seed)
    clean = 0.1 * initial_noise((count, 3, size, size), seed + 1)
    mask = torch.zeros(count, 1, size, size)
    mask[..., : size // 2, :] = 1.0
    return ViewLatents(start, Conditioning(clean, mask), tuple(controls))


def test_sampling_follows_the_exact_flow(device):
    """Noise e goes to mean + spread e: the probability flow between two normal distributions."""
    prior = GaussianPrior(device=device)
    views = views_of(2)
    z = sample_views(prior, views, PLAIN, SamplingSettings(steps=250))
    torch.testing.assert_close(z, 0.4 + 0.3 * views.start, atol=0.02, rtol=0.0)


def test_guidance_weighs_the_two_prompts():
    prior = GaussianPrior()
    z = initial_noise((1, 3, 4, 4), 3)
    positive, negative = (prior.predict_noise(z, 500, mean) for mean in (0.4, -0.2))
    guided = guided_noise(prior, z, 500, Guidance(Prompts(0.4, -0.2), scale=7.5))
    torch.testing.assert_close(guided, negative + 7.5 * (positive - negative))


def test_the_negative_prompt_costs_nothing_at_scale_one():
    prior = GaussianPrior()
    guided_noise(prior, initial_noise((1, 3, 4, 4), 3), 500, PLAIN)
    assert [text for _, _, text, _ in prior.calls] == [0.4]


@pytest.mark.parametrize("references", [[0], [4, 1, 2]])
def test_propagation_equals_the_method_written_out(references):
    """At each timestep and in each half: references first, then every other view reads what they left."""
    prior = GaussianPrior(attention=0.3)
    guidance = Guidance(Prompts(0.4, -0.2), scale=3.0)
    settings = SamplingSettings(steps=5, batch=2, afp_weight=0.6)
    views = views_of(6)
    z = sample_views(prior, views, guidance, settings, references=references)

    expected = views.start.clone()
    timesteps = prior.schedule.timesteps(5)
    for t, to in zip(timesteps, [*timesteps[1:], None], strict=True):
        before = expected.clone()
        for i in range(6):
            halves = []
            for mean in (-0.2, 0.4):
                bank = AttentionBank(0.6)
                prior.install_attention(bank)
                for r in references if i not in references else ():
                    with bank.writing():
                        prior.predict_noise(before[r : r + 1], t, mean)
                with bank.reading() if i not in references else bank.writing():
                    halves.append(prior.predict_noise(before[i : i + 1], t, mean))
            noise = halves[0] + 3.0 * (halves[1] - halves[0])
            expected[i] = prior.schedule.step(before[i : i + 1], noise, t, to)[0]
    torch.testing.assert_close(z, expected)


def test_weight_zero_is_each_view_for_itself():
    prior = GaussianPrior(attention=0.3)
    views = views_of(4)
    settings = SamplingSettings(steps=4, afp_weight=0.0)
    alone = sample_views(prior, views, PLAIN, settings)
    assert torch.equal(sample_views(prior, views, PLAIN, settings, references=[1, 2]), alone)
    propagated = sample_views(prior, views, PLAIN, SamplingSettings(steps=4), references=[1, 2])
    assert torch.equal(propagated[1:3], alone[1:3])
    assert not torch.allclose(propagated[0], alone[0], atol=1e-3)


def test_inpainted_references_can_keep_their_own_trajectory():
    """From the inversion of what they show they return to it; what they leave on the way differs slightly."""
    prior = GaussianPrior(attention=0.3)
    clean = 0.4 + 0.3 * initial_noise((2, 3, 6, 6), 5)
    views = views_of(2)
    cond = replace(views.cond, latent=clean)
    start = torch.cat([invert(prior, clean[:1], 0.4, steps=40), views.start[1:]])
    views = replace(views, start=start, cond=cond, inpainted=True)
    seen = {}
    for resampled in (False, True):
        settings = SamplingSettings(steps=40, resampled=resampled)
        prior.calls.clear()
        z = sample_views(prior, views, PLAIN, settings, references=[0])
        assert torch.equal(z[:1], clean[:1]), "they end as they are"
        seen[resampled] = z[1]
    assert not torch.equal(seen[False], seen[True])
    assert float((seen[False] - seen[True]).abs().mean()) < 0.03 < float(seen[True].std())


@pytest.mark.parametrize("batch", [1, 3, 100])
def test_the_batch_does_not_change_the_result(batch):
    prior = GaussianPrior(attention=0.3)
    control = Control("edges", torch.rand(5, 6, 6, generator=torch.Generator().manual_seed(1)), 0.8)
    views = views_of(5, controls=[control])
    expected = sample_views(prior, views, PLAIN, SamplingSettings(steps=3, batch=2), references=[3])
    z = sample_views(prior, views, PLAIN, SamplingSettings(steps=3, batch=batch), references=[3])
    torch.testing.assert_close(z, expected)


def test_memory_does_not_grow_with_the_views(device):
    """What is on the prior's device at one time: a batch, and one timestep's keys of the references."""
    most = []
    for count in (6, 60):
        prior = GaussianPrior(attention=0.3, device=device)
        if device == "cuda":
            torch.cuda.reset_peak_memory_stats()
        sample_views(prior, views_of(count), PLAIN, SamplingSettings(steps=3, batch=2), references=[0, 1, 2])
        allocated = torch.cuda.max_memory_allocated() if device == "cuda" else 0
        most.append((max(c[0] for c in prior.calls), max(c[3] for c in prior.calls), allocated))
    assert most[0] == most[1]
    assert most[0][:2] == (2, 3 * 2 * 36 * 3 * 4)


def test_the_known_part_is_put_back_for_a_prior_that_does_not_heed_it():
    prior = GaussianPrior(mask_aware=False)
    views = views_of(2)
    z = sample_views(prior, views, PLAIN, SamplingSettings(steps=4))
    known = views.cond.mask.expand_as(z) == 0.0
    assert torch.equal(z[known], views.cond.latent[known])
    assert not torch.allclose(z[~known], views.cond.latent[~known], atol=0.1)


def test_the_bank_is_taken_out_even_after_an_error():
    prior = GaussianPrior(attention=0.3)
    prior.predict_noise = lambda *args: 1 / 0
    with pytest.raises(ZeroDivisionError):
        sample_views(prior, views_of(1), PLAIN)
    assert prior.bank is None


@pytest.mark.parametrize("references", [[0, 0], [4], [-1]])
def test_references_that_are_not_there(references):
    with pytest.raises(InputError, match=r"are not distinct indices of 4 views"):
        sample_views(GaussianPrior(), views_of(4), PLAIN, references=references)


def test_the_plan_counts_what_sampling_does():
    prior = GaussianPrior(attention=0.3)
    views, settings = views_of(7), SamplingSettings(steps=6, batch=3)
    guidance = Guidance(Prompts(0.4, 0.0))
    plan = plan_sampling(prior, views, guidance, settings, [0, 1])
    probes = len(prior.calls)
    sample_views(prior, views, guidance, settings, references=[0, 1])
    assert probes == 2 + 5
    estimates = sum(rows for rows, *_ in prior.calls[probes:])
    assert estimates == plan.views * plan.steps * plan.halves
    assert plan.bank_bytes == max(size for *_, size in prior.calls[probes:])
    assert plan.host_bytes == sum(x.nbytes for x in (views.start, views.cond.latent, views.cond.mask))
    assert "7 views, 2 of them references, 6 steps: 84 noise estimates" in str(plan)


class Replicas(GaussianPrior):
    """The prior on three devices, which here are one."""

    def __init__(self, **options):
        super().__init__(**options)
        self.replicas = [GaussianPrior(**options) for _ in range(2)]


@pytest.mark.parametrize("references", [[], [4, 1, 2]])
def test_several_devices_share_the_views(references, device):
    """The same latents as one device gives; each timestep's references are read by all, written by one."""
    guidance = Guidance(Prompts(0.4, -0.2), scale=3.0)
    settings = SamplingSettings(steps=4, batch=1)
    views = views_of(12)
    one, three = GaussianPrior(attention=0.3, device=device), Replicas(attention=0.3, device=device)
    alone = sample_views(one, views, guidance, settings, references=references)
    shared = sample_views(three, views, guidance, settings, references=references)
    assert torch.equal(shared, alone)
    team = [three, *three.replicas]
    assert sum(len(member.calls) for member in team) == len(one.calls) == 4 * 12 * 2
    if references:
        assert all(kept > 0 for member in three.replicas for _, _, _, kept in member.calls)
    assert all(member.bank is None for member in team)


def test_an_error_on_one_device_ends_the_sampling():
    prior = Replicas(attention=0.3)

    def fail(*_, **__):
        raise RuntimeError("CUDA out of memory")

    prior.replicas[1].predict_noise = fail
    prior.predict_noise = prior.replicas[0].predict_noise = lambda z, *_, **__: torch.zeros_like(z)
    with pytest.raises(RuntimeError, match="out of memory"):
        for _ in range(50):  # the failing one may come too late for any view
            sample_views(prior, views_of(40), PLAIN, SamplingSettings(steps=4, batch=1))
    assert all(member.bank is None for member in [prior, *prior.replicas])
