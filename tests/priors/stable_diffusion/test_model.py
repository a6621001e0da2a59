"""Stable Diffusion behind the protocol: sizes, known part, attention, embeddings, gradients."""

import pytest
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.priors.attention import AttentionBank
from diga3d_warp.priors.conditioning import Control, Guidance
from diga3d_warp.priors.distillation import distillation_loss
from diga3d_warp.priors.settings import SamplingSettings
from diga3d_warp.priors.stable_diffusion.load import load_stable_diffusion
from diga3d_warp.priors.views import inpaint_views


def load(checkpoints, device):
    return load_stable_diffusion(
        checkpoints / "sd", device=device, sampling=SamplingSettings(steps=3), controls=("edges",)
    )


@pytest.fixture
def prior(checkpoints):
    return load(checkpoints, "cpu")


@pytest.fixture
def device_prior(checkpoints, device):
    return load(checkpoints, device)


def estimate(prior, photo, holes, **options):
    z = torch.randn(2, 4, 8, 12, generator=torch.Generator().manual_seed(4)).to(prior.device)
    text = prior.encode_prompts("a vase", "", "replace").positive
    return prior.predict_noise(z, 400, text, prior.conditioning(photo, holes), **options)


def test_fill(device_prior, photo, holes):
    image, hole = photo[0], holes[0]
    filled = device_prior.fill(image, hole, seed=3)
    assert torch.equal(filled[~hole], image[~hole])
    assert float((filled - image)[hole].abs().mean()) > 0.05
    assert float(filled[hole].std()) > 0.02
    assert torch.equal(filled, device_prior.fill(image, hole, seed=3))
    assert not torch.equal(filled, device_prior.fill(image, hole, seed=4))


def test_fill_looks_at_no_masked_pixel(device_prior, photo, holes):
    other = torch.where(holes[0][..., None], photo[1], photo[0])
    torch.testing.assert_close(device_prior.fill(photo[0], holes[0]), device_prior.fill(other, holes[0]))


def test_native_sizes(prior):
    """The short side is that of training, 32 px here; as 512 makes 512 x 904 of 567 x 1008."""
    assert prior.native_size(567, 1008) == (32, 56)
    assert prior.native_size(32, 48) == (32, 48)
    assert prior.native_size(90, 30) == (96, 32)


def test_a_cell_with_any_masked_pixel_is_masked(prior, photo):
    holes = torch.zeros(2, 32, 48, dtype=torch.bool)
    holes[0, 7, 11] = True
    mask = prior.conditioning(photo, holes).mask
    assert mask[0, 0, 1, 2] == 1.0
    assert float(mask.sum()) == 1.0


def test_every_self_attention_reads_and_nothing_else_is_touched(prior):
    unet = prior.networks.unet
    before = dict(unet.attn_processors)
    bank = AttentionBank()
    prior.install_attention(bank)
    changed = {name for name, processor in unet.attn_processors.items() if processor is not before[name]}
    assert changed == {name for name in before if ".attn1." in name}
    assert len(changed) == 4
    prior.install_attention(None)
    assert unet.attn_processors == before


def test_reading_oneself_changes_nothing_and_reading_another_does(prior, photo, holes):
    bank = AttentionBank(weight=0.6)
    alone = estimate(prior, photo, holes)
    prior.install_attention(bank)
    torch.testing.assert_close(estimate(prior, photo, holes), alone)
    with bank.writing():
        estimate(prior, photo[:1].expand(2, -1, -1, -1), holes[:1].expand(2, -1, -1))
    assert bank.size > 0
    with bank.reading():
        read = estimate(prior, photo, holes)
    assert float((read[1] - alone[1]).abs().max()) > 1e-3
    bank.clear()
    with bank.writing():
        estimate(prior, photo, holes)
    own_only = AttentionBank(weight=0.6)
    own_only._kept = {key: rows[:1] for key, rows in bank._kept.items()}
    prior.install_attention(own_only)
    with own_only.reading():
        torch.testing.assert_close(estimate(prior, photo, holes)[0], alone[0], atol=1e-5, rtol=1e-4)


def test_distillation_goes_through_the_autoencoder_to_masked_pixels_only(device_prior, photo, holes):
    images = photo.to(device_prior.device).requires_grad_()
    guidance = Guidance(device_prior.encode_prompts("a vase", "", "replace"))
    control = Control("edges", torch.ones(2, 32, 48, device=device_prior.device), 0.8)
    generator = torch.Generator().manual_seed(1)
    loss = distillation_loss(
        device_prior, images, holes.to(device_prior.device), guidance, [control], t=500, generator=generator
    )
    (gradient,) = torch.autograd.grad(loss, images)
    assert gradient.isfinite().all()
    assert (gradient[~holes] == 0.0).all()
    assert float((gradient[holes] != 0.0).float().mean()) > 0.9


def test_a_control_without_its_network(prior, photo, holes):
    with pytest.raises(InputError, match=r"prior sd has no ControlNet for depth"):
        estimate(prior, photo, holes, controls=[Control("depth", torch.ones(2, 32, 48), 1.0)])


def test_a_new_class_embedding_has_no_effect_until_it_is_trained(checkpoints, prior, photo, holes):
    embedded = load_stable_diffusion(checkpoints / "sd", image_encoder=checkpoints / "clip", device="cpu")
    embedding = embedded.embed_images(photo)
    assert embedding.shape == (1, 6)
    assert float(embedding.abs().max()) > 0.01
    plain = estimate(prior, photo, holes)
    assert torch.equal(estimate(embedded, photo, holes, image_embeds=embedding), plain)
    torch.nn.init.normal_(embedded.networks.unet.class_embedding.weight)
    assert torch.equal(estimate(embedded, photo, holes), plain)
    trained = estimate(embedded, photo, holes, image_embeds=embedding)
    assert float((trained - plain).abs().max()) > 1e-3


def test_the_image_embedding_is_clips(checkpoints, photo):
    """The middle square at the model's size, normalised by its own mean and deviation."""
    prior = load_stable_diffusion(checkpoints / "sd", image_encoder=checkpoints / "clip", device="cpu")
    square = torch.nn.functional.interpolate(
        photo.permute(0, 3, 1, 2)[..., 8:40], (16, 16), mode="bicubic", antialias=True
    ).clamp(0, 1)
    mean, std = torch.tensor([0.5, 0.4, 0.3]), torch.tensor([0.3, 0.3, 0.2])
    pixels = (square - mean[:, None, None]) / std[:, None, None]
    expected = prior.networks.images.model(pixels).image_embeds.mean(0, keepdim=True)
    torch.testing.assert_close(prior.embed_images(photo), expected, atol=0.05, rtol=0.05)


def test_a_bank_goes_well_with_an_ip_adapter(checkpoints, photo, holes):
    prior = load_stable_diffusion(
        checkpoints / "sd",
        image_encoder=checkpoints / "clip",
        ip_adapter=checkpoints / "ip-adapter.safetensors",
        device="cpu",
    )
    embedding = prior.embed_images(photo)
    plain = estimate(prior, photo, holes, image_embeds=embedding)
    prior.install_attention(AttentionBank())
    torch.testing.assert_close(estimate(prior, photo, holes, image_embeds=embedding), plain)
    prior.install_attention(None)
    torch.testing.assert_close(estimate(prior, photo, holes, image_embeds=embedding), plain)


def test_a_replica_has_networks_of_its_own(prior, photo, holes):
    """It estimates the same noise, and attention that is installed in one is not in the other."""
    assert list(prior.replicas) == []
    other = prior.on(torch.device("cpu"))
    first, bank = estimate(prior, photo, holes), AttentionBank()
    assert torch.equal(first, estimate(other, photo, holes))
    assert other.networks.unet is not prior.networks.unet and list(other.replicas) == []
    other.install_attention(bank)
    with bank.writing():
        estimate(prior, photo, holes)
        assert bank.size == 0
        estimate(other, photo, holes)
    assert bank.size > 0


@pytest.mark.parametrize(
    ("device", "count", "found"), [("cuda", 3, [1, 2]), ("cuda:1", 3, []), ("cpu", 3, [])]
)
def test_replicas_are_on_the_further_gpus(prior, monkeypatch, device, count, found):
    monkeypatch.setattr(torch.cuda, "device_count", lambda: count)
    prior.device = torch.device(device)
    prior.__dict__.pop("replicas", None)
    assert [each.device.index for each in prior.replicas] == found


def test_replicas_sample_the_same_views(device_prior, photo, holes):
    """With float16 on a GPU, too: a mini-batch is computed alike, whoever takes it."""

    def sampled():
        images, masks = [photo[k % 2] for k in range(6)], [holes[k % 2] for k in range(6)]
        settings = SamplingSettings(steps=3, batch=1)
        guidance = device_prior.guidance
        return list(inpaint_views(device_prior, images, masks, guidance, settings, references=[0, 1]))

    alone = sampled()
    device_prior.replicas = [device_prior.on(device_prior.device) for _ in range(2)]
    assert all(torch.equal(*pair) for pair in zip(alone, sampled(), strict=True))
    assert float((alone[2] - photo[0]).abs().max()) > 0.05
