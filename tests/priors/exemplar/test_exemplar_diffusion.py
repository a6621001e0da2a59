"""The exemplar prior in the loops that all diffusion priors share."""

import pytest
import torch
from known_textures import HEIGHT, TEXTURES, WIDTH, error_db, hole, spoilt

from diga3d_warp.errors import InputError
from diga3d_warp.priors.attention import AttentionBank
from diga3d_warp.priors.classical import telea_fill
from diga3d_warp.priors.conditioning import Conditioning, Control, Guidance, Prompts
from diga3d_warp.priors.distillation import distillation_loss
from diga3d_warp.priors.exemplar.prior import ExemplarPrior
from diga3d_warp.priors.exemplar.prompts import OBJECT, SURROUNDINGS, PatchPrompt
from diga3d_warp.priors.inversion import invert
from diga3d_warp.priors.protocol import DiffusionPrior
from diga3d_warp.priors.sampling import ViewLatents, initial_noise, sample_views
from diga3d_warp.priors.settings import SamplingSettings
from diga3d_warp.priors.views import fill_one, inpaint_views

REMOVE = Guidance(Prompts(SURROUNDINGS, SURROUNDINGS), scale=1.0)


def small(name: str) -> tuple[torch.Tensor, torch.Tensor]:
    """A quarter of a texture, and a disc of 12 % of it."""
    rows, columns = torch.meshgrid(torch.arange(48), torch.arange(64), indexing="ij")
    return TEXTURES[name]()[24:72, 32:96], (rows - 22) ** 2 + (columns - 30) ** 2 < 11**2


def sampled(prior, z, text, cond, steps):
    views = ViewLatents(z, cond)
    guidance = Guidance(Prompts(text, text), scale=1.0)
    return sample_views(prior, views, guidance, SamplingSettings(steps=steps, afp_weight=0.0))


@pytest.mark.parametrize("name", ["stripes", "boundary"])
def test_the_shared_sampler_continues_a_texture(name):
    truth, mask = small(name)
    image = spoilt(truth, mask)
    filled = fill_one(ExemplarPrior(), image, mask, REMOVE, SamplingSettings(steps=12), seed=1)
    assert torch.equal(filled[~mask], image[~mask])
    assert error_db(filled, truth, mask) > error_db(telea_fill(image, mask), truth, mask) + 2.0


def test_noise_estimates_take_the_known_part_as_clean():
    prior = ExemplarPrior()
    truth, mask = small("stripes")
    cond = prior.conditioning(truth[None], mask[None])
    noise = torch.randn(cond.latent.shape, generator=torch.Generator().manual_seed(0))
    for t in (10, 400, 900):
        z = prior.schedule.add_noise(cond.latent, noise, t)
        estimate = prior.predict_noise(z, t, SURROUNDINGS, cond)
        outside = ~mask[None, None].expand_as(z)
        torch.testing.assert_close(estimate[outside], noise[outside], atol=1e-3, rtol=0.0)
        again = prior.predict_noise(z, t, SURROUNDINGS, cond)
        assert torch.equal(again, estimate), "nothing that depends on noise is kept between calls"
        anew = prior.predict_noise(z, t, SURROUNDINGS, Conditioning(cond.latent, cond.mask))
        assert torch.equal(anew, estimate), "what is prepared changes nothing"


def test_other_controls_are_heeded_with_the_same_conditioning():
    """What was prepared with one set of controls does not stand in for another."""
    prior = ExemplarPrior()
    truth, mask = small("stripes")
    cond = prior.conditioning(truth[None], mask[None])
    t = 300
    z = prior.schedule.add_noise(cond.latent, initial_noise(cond.latent.shape, 0), t)
    edges = (truth[..., 0] > 0.5).float()[None]
    controls = [(), (Control("edges", edges, 1.0),), (Control("edges", edges.flip(1), 1.0),), ()]
    shared = [prior.predict_noise(z, t, SURROUNDINGS, cond, each) for each in controls]
    own = [
        prior.predict_noise(z, t, SURROUNDINGS, prior.conditioning(truth[None], mask[None]), each)
        for each in controls
    ]
    for a, b in zip(shared, own, strict=True):
        assert torch.equal(a, b)
    assert not torch.equal(own[0], own[1]) and not torch.equal(own[1], own[2])


def test_a_reference_that_is_all_known_leaves_its_clean_patches():
    """Nothing is missing in it: its noise is told exactly, whatever the level, and its image is kept."""
    prior = ExemplarPrior()
    truth, mask = small("stripes")
    cond = prior.conditioning(truth[None], torch.zeros_like(mask)[None])
    t = 800
    noise = initial_noise(cond.latent.shape, 0)
    bank = AttentionBank(1.0)
    prior.install_attention(bank)
    with bank.writing():
        estimate = prior.predict_noise(prior.schedule.add_noise(cond.latent, noise, t), t, SURROUNDINGS, cond)
    torch.testing.assert_close(estimate, noise, atol=1e-4, rtol=1e-4)
    assert bank.size == cond.latent.nbytes + mask.nbytes, "colours, and beside them where the hole was"

    grey = torch.full_like(truth, 0.5)
    other = prior.conditioning(grey[None], mask[None])
    low = 300
    z = prior.schedule.add_noise(cond.latent, noise, low)
    with bank.reading():
        read = prior.schedule.denoise(z, prior.predict_noise(z, low, SURROUNDINGS, other), low)
    prior.install_attention(None)
    inside = mask[None, None].expand_as(z)
    assert (read - cond.latent)[inside].abs().mean() < 0.1 < (read - other.latent)[inside].abs().mean()


def test_little_noise_is_told_from_the_image():
    """Where the image is made of the source's patches, its noise can be told almost exactly."""
    prior = ExemplarPrior()
    truth, mask = small("stripes")
    cond = prior.conditioning(truth[None], mask[None])
    noise = torch.randn(cond.latent.shape, generator=torch.Generator().manual_seed(0))
    t = 300
    estimate = prior.predict_noise(
        prior.schedule.add_noise(cond.latent, noise, t), t, PatchPrompt(exemplar=truth), cond
    )
    inside = mask[None, None].expand_as(noise)
    assert (estimate - noise)[inside].square().mean() < 0.1


def test_inversion_then_sampling_returns_the_image():
    """Of an image no pixel of which is known, from patches of the same image."""
    prior = ExemplarPrior()
    truth, _ = small("bricks")
    everything = torch.ones(truth.shape[:2], dtype=torch.bool)
    text = PatchPrompt(exemplar=truth)
    cond = prior.conditioning(truth[None], everything[None])
    z = invert(prior, cond.latent, text, cond, steps=15)
    assert (z - cond.latent).abs().mean() > 0.3, "noise, not the image"
    back = prior.decode_latent(sampled(prior, z, text, cond, 15))[0]
    assert error_db(back, truth, everything) > 30.0
    other = initial_noise(z.shape, 0)
    assert error_db(prior.decode_latent(sampled(prior, other, text, cond, 15))[0], truth, everything) < 15.0


def test_a_material_is_painted_where_it_is_asked_for():
    prior = ExemplarPrior()
    truth, mask = small("stripes")
    prompts = prior.encode_prompts("gold", "", "retexture")
    filled = fill_one(prior, truth, mask, Guidance(prompts, 1.0), SamplingSettings(steps=8))
    inner = mask & (torch.nn.functional.max_pool2d(-mask[None].float(), 9, 1, 4)[0] == -1.0)
    nearest = torch.cdist(filled[inner], prompts.positive.exemplar.reshape(-1, 3)[::7]).min(1).values
    assert nearest.mean() < 0.1
    assert (
        torch.cdist(truth[inner], prompts.positive.exemplar.reshape(-1, 3)[::7]).min(1).values.mean() > 0.15
    )


def test_a_view_without_a_hole_stays_whatever_it_is_to_go_away_from():
    """It shows no object whose patches a negative prompt could stand for."""
    prior = ExemplarPrior(negative="stripes")
    truth, mask = small("stripes")
    settings = SamplingSettings(steps=4, strength=0.5)
    views = [truth, truth], [mask, torch.zeros_like(mask)]
    filled = list(inpaint_views(prior, *views, prior.guidance, settings))
    assert torch.equal(filled[1], truth) and not torch.equal(filled[0], truth)


def test_prompts_that_mean_nothing_are_refused():
    prior = ExemplarPrior()
    assert prior.encode_prompts("", "", "remove") == Prompts(SURROUNDINGS, SURROUNDINGS)
    assert prior.encode_prompts("lawn", "statue", "remove") == Prompts(SURROUNDINGS, OBJECT)
    assert prior.encode_prompts("gold", "", "retexture").negative is OBJECT
    for positive, negative in (("", ""), ("a unicorn", ""), ("gold", "unicorn"), ("gold " * 2500, "")):
        with pytest.raises(InputError):
            prior.encode_prompts(positive, negative, "retexture")


def test_the_negative_prompt_stands_for_the_object():
    """Its estimate is the object, that of the positive one is not: guidance leads from one to the other."""
    prior = ExemplarPrior()
    truth, mask = small("ground")
    image = torch.where(mask[..., None], truth.mean((0, 1)), truth)
    cond = prior.conditioning(image[None], mask[None])
    t = 700
    z = prior.schedule.add_noise(cond.latent, initial_noise(cond.latent.shape, 0), t)
    means = {}
    for part in (SURROUNDINGS, OBJECT):
        means[part] = prior.schedule.denoise(z, prior.predict_noise(z, t, part, cond), t)
    inside = mask[None, None].expand_as(z)
    object_color = cond.latent[inside].mean()
    assert (means[OBJECT][inside] - cond.latent[inside]).abs().mean() < 0.02
    assert (means[SURROUNDINGS][inside] - object_color).abs().mean() > 0.05


def two_views():
    """The same floor twice, the hole elsewhere; the second is lit differently."""
    truth, mask = small("boundary")
    images = torch.stack([spoilt(truth, mask), spoilt(truth.flip(1), mask)])
    return images, torch.stack([mask, mask])


def propagated(weight: float, references=(0,)):
    prior = ExemplarPrior()
    images, masks = two_views()
    cond = prior.conditioning(images, masks)
    start = torch.cat([initial_noise((1, 3, 48, 64), seed) for seed in (0, 1)])
    settings = SamplingSettings(steps=8, afp_weight=weight)
    return sample_views(prior, ViewLatents(start, cond), REMOVE, settings, references=references)


def test_propagation_at_weight_zero_is_exactly_no_propagation():
    assert torch.equal(propagated(0.0), propagated(0.6, references=()))


def test_propagation_changes_the_other_views_alone():
    alone, together = propagated(0.0), propagated(0.6)
    assert torch.equal(alone[0], together[0]), "a reference attends to itself"
    assert (alone[1] - together[1]).abs().max() > 0.05
    _, masks = two_views()
    outside = ~masks[1].expand(3, -1, -1)
    torch.testing.assert_close(alone[1][outside], together[1][outside], atol=1e-5, rtol=0.0)


def test_a_view_takes_what_only_the_reference_shows():
    """The reference is all gold where the other view has a hole among grey."""
    prior = ExemplarPrior()
    gold, mask = torch.tensor([0.9, 0.7, 0.2]), small("stripes")[1]
    images = torch.stack([gold.expand(48, 64, 3), torch.full((48, 64, 3), 0.4)])
    cond = prior.conditioning(images, torch.stack([mask, mask]))
    start = torch.cat([initial_noise((1, 3, 48, 64), seed) for seed in (0, 1)])
    settings = SamplingSettings(steps=6, afp_weight=0.6)
    z = sample_views(prior, ViewLatents(start, cond), REMOVE, settings, references=[0])
    color = prior.decode_latent(z)[1][mask].mean(0)
    expected = 0.6 * gold + 0.4 * torch.full((3,), 0.4)
    torch.testing.assert_close(color, expected, atol=0.02, rtol=0.0)


def test_edges_lead_the_fill():
    """Half of the hole is asked to hold edges: there the fill takes from where there are some."""
    prior = ExemplarPrior()
    rows, columns = torch.meshgrid(torch.arange(48), torch.arange(64), indexing="ij")
    image = torch.full((48, 64, 3), 0.5)
    image[:, ::6][:20] = 0.9  # ruled above, blank below
    edges = ((columns % 6 == 0) & (rows < 20)).float()
    mask = (rows - 24).abs() < 10
    mask &= (columns > 20) & (columns < 44)
    wanted = edges.clone()
    wanted[mask] = ((columns % 6 == 0) & (columns < 32)).float()[mask]
    cond = prior.conditioning(image[None], mask[None])
    views = ViewLatents(initial_noise((1, 3, 48, 64), 0), cond, (Control("edges", wanted[None], 1.0),))
    filled = prior.decode_latent(sample_views(prior, views, REMOVE, SamplingSettings(steps=10)))[0, ..., 0]
    below = mask & (rows > 24) & (rows < 32)
    left, right = below & (columns < 30), below & (columns > 35)
    assert filled[left].std() > 2.0 * filled[right].std()


def test_score_distillation_improves_masked_pixels_alone():
    prior = ExemplarPrior()
    truth, mask = small("stripes")
    start = spoilt(truth, mask)
    image = start.clone().requires_grad_()
    generator = torch.Generator().manual_seed(0)
    optimiser = torch.optim.Adam([image], lr=0.05)
    for step in range(24):
        optimiser.zero_grad()
        t = 760 - 25 * step
        distillation_loss(prior, image[None], mask[None], REMOVE, t=t, generator=generator).backward()
        assert not image.grad[~mask].any()
        optimiser.step()
    filled = image.detach()
    assert torch.equal(filled[~mask], start[~mask])
    assert error_db(filled, truth, mask) > error_db(start, truth, mask) + 3.0


def test_it_is_a_diffusion_prior():
    prior: DiffusionPrior = ExemplarPrior()
    assert prior.native_size(HEIGHT, WIDTH) == (HEIGHT, WIDTH)
    images = torch.rand(2, 12, 16, 3, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(prior.decode_latent(prior.encode_image(images)), images)
    assert hole().any()
