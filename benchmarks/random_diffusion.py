"""Stable Diffusion 1.5 for inpainting with random weights: what it costs does not depend on what it knows."""

import torch

from diga3d_warp.priors.conditioning import Prompts
from diga3d_warp.priors.schedule import Schedule
from diga3d_warp.priors.stable_diffusion.model import Networks, Parts, StableDiffusionPrior
from diga3d_warp.priors.stable_diffusion.text import TextEncoder

WIDTH = 320
"""Channels of the first block of Stable Diffusion 1.5; the others have 2, 4 and 4 times as many."""

CROSS = 768
"""Width of its text embeddings."""


def unet_config(width: int, in_channels: int) -> dict:
    """Configuration of `diffusers.UNet2DConditionModel`; with `WIDTH` that of version 1.5."""
    return {
        "sample_size": 64,
        "in_channels": in_channels,
        "block_out_channels": (width, 2 * width, 4 * width, 4 * width),
        "cross_attention_dim": CROSS,
    }


def random_prior(width: int, device: str, controls: tuple[str, ...] = ()) -> StableDiffusionPrior:
    """A 9-channel inpainting prior with ControlNets, of any width; it has no tokenizer.

    Narrower than the real one it gets a text model of one layer, which nothing here asks.
    """
    from diffusers import AutoencoderKL, ControlNetModel, UNet2DConditionModel
    from transformers import CLIPTextConfig, CLIPTextModel

    torch.manual_seed(0)
    first = max(32, width * 128 // WIDTH // 32 * 32)
    vae = AutoencoderKL(
        block_out_channels=(first, 2 * first, 4 * first, 4 * first),
        down_block_types=("DownEncoderBlock2D",) * 4,
        up_block_types=("UpDecoderBlock2D",) * 4,
        layers_per_block=2,
        latent_channels=4,
        sample_size=512,
    )
    text = CLIPTextModel(
        CLIPTextConfig(
            hidden_size=CROSS,
            intermediate_size=3072,
            num_hidden_layers=12 if width == WIDTH else 1,
            num_attention_heads=12,
        )
    )
    plain = UNet2DConditionModel(**unet_config(width, 4)) if controls else None
    networks = Networks(
        unet=UNet2DConditionModel(**unet_config(width, 9)),
        vae=vae,
        controlnets={kind: ControlNetModel.from_unet(plain) for kind in controls},
    )
    for model in (networks.unet, vae, text, *networks.controlnets.values()):
        model.eval().requires_grad_(False)
    parts = Parts(
        text=TextEncoder(None, text),
        schedule=Schedule.scaled_linear(),
        mask_aware=True,
        open=lambda: networks,
        control_kinds=tuple(controls),
    )
    return StableDiffusionPrior("random", parts, device, prompting=lambda *_: Prompts(None, None))
