"""With propagation off, our loop gives what diffusers' own pipelines give."""

import pytest
import torch

from diga3d_warp.priors.conditioning import Control, Guidance
from diga3d_warp.priors.sampling import ViewLatents, initial_noise, sample_views
from diga3d_warp.priors.settings import SamplingSettings
from diga3d_warp.priors.stable_diffusion.load import load_stable_diffusion
from tiny_diffusion import NOISE_LEVELS

STEPS = 4


@pytest.fixture
def deterministic_vae(monkeypatch):
    """Diffusers draws latents from the autoencoder's distribution; we take its mean."""
    from diffusers.models.autoencoders.vae import DiagonalGaussianDistribution

    monkeypatch.setattr(DiagonalGaussianDistribution, "sample", lambda self, generator=None: self.mode())


def ours(prior, photo, holes, controls=(), image_embeds=None, weight=0.0):
    """Both views under prompts, with references in place but without weight."""
    z = initial_noise((2, 4, 8, 12), 5)
    prompts = prior.encode_prompts("a wooden cube", "a vase", "replace")
    decoded = sample_views(
        prior,
        ViewLatents(z, prior.conditioning(photo, holes), tuple(controls)),
        Guidance(prompts, image_embeds=image_embeds),
        SamplingSettings(steps=STEPS, afp_weight=weight),
        references=[0],
    )
    return z, prior.decode_latent(decoded)


def stock(kind, prior, photo, holes, z, **extra):
    """The same from a pipeline of diffusers made of the same models."""
    import diffusers

    scheduler = diffusers.DDIMScheduler(**NOISE_LEVELS, prediction_type=prior.parts.prediction)
    models = {name: extra.pop(name) for name in ("controlnet", "image_encoder") if name in extra}
    pipeline = getattr(diffusers, kind)(
        vae=prior.networks.vae,
        unet=prior.networks.unet,
        text_encoder=prior.parts.text.model,
        tokenizer=prior.parts.text.tokenizer,
        scheduler=scheduler,
        safety_checker=None,
        feature_extractor=None,
        requires_safety_checker=False,
        **models,
    )
    pipeline.set_progress_bar_config(disable=True)
    pipeline.vae_scale_factor = prior.cell
    return pipeline(
        prompt=["a wooden cube"] * 2,
        negative_prompt=["a vase"] * 2,
        image=photo.permute(0, 3, 1, 2),
        mask_image=holes[:, None].float(),
        height=32,
        width=48,
        num_inference_steps=STEPS,
        guidance_scale=7.5,
        latents=z.clone(),
        output_type="pt",
        **extra,
    ).images.permute(0, 2, 3, 1)


def assert_same_pictures(first, second):
    assert float(first.std()) > 0.02
    torch.testing.assert_close(first, second, atol=1e-4, rtol=0.0)


@pytest.mark.parametrize("folder", ["sd", "sd4"])
def test_inpainting(checkpoints, photo, holes, deterministic_vae, folder):
    """Nine channels with noise prediction, four channels with v-prediction and the known part put back."""
    prior = load_stable_diffusion(checkpoints / folder, device="cpu")
    z, images = ours(prior, photo, holes)
    assert_same_pictures(images, stock("StableDiffusionInpaintPipeline", prior, photo, holes, z))


def test_inpainting_under_two_controlnets(checkpoints, photo, holes, deterministic_vae):
    from diffusers import MultiControlNetModel

    prior = load_stable_diffusion(checkpoints / "sd", controls=("edges", "depth"), device="cpu")
    generator = torch.Generator().manual_seed(6)
    edges, depth = (torch.rand(2, 32, 48, generator=generator) > 0.7).float(), torch.rand(2, 32, 48)
    controls = [Control("edges", edges, 0.8), Control("depth", depth, 1.0)]
    z, images = ours(prior, photo, holes, controls)
    expected = stock(
        "StableDiffusionControlNetInpaintPipeline",
        prior,
        photo,
        holes,
        z,
        controlnet=MultiControlNetModel(list(prior.networks.controlnets.values())),
        control_image=[control[:, None].expand(-1, 3, -1, -1) for control in (edges, depth)],
        controlnet_conditioning_scale=[0.8, 1.0],
    )
    assert_same_pictures(images, expected)
    _, free = ours(prior, photo, holes)
    assert float((images - free).abs().max()) > 0.01


def test_inpainting_with_an_ip_adapter(checkpoints, photo, holes, deterministic_vae):
    prior = load_stable_diffusion(
        checkpoints / "sd",
        image_encoder=checkpoints / "clip",
        ip_adapter=checkpoints / "ip-adapter.safetensors",
        device="cpu",
    )
    embedding = prior.embed_images(photo[:1])
    z, images = ours(prior, photo, holes, image_embeds=embedding)
    halves = torch.cat([torch.zeros(1, 1, 6), embedding[None]])
    expected = stock(
        "StableDiffusionInpaintPipeline",
        prior,
        photo,
        holes,
        z,
        ip_adapter_image_embeds=[halves],
    )
    assert_same_pictures(images, expected)
    _, without = ours(prior, photo, holes)
    assert float((images - without).abs().max()) > 0.01


def test_propagation_changes_the_reading_view_only(checkpoints, photo, holes):
    prior = load_stable_diffusion(checkpoints / "sd", device="cpu")
    (_, alone), (_, propagated) = (ours(prior, photo, holes, weight=weight) for weight in (0.0, 0.6))
    torch.testing.assert_close(propagated[0], alone[0])
    assert float((propagated[1] - alone[1]).abs().max()) > 0.01
