"""Checkpoints in the real format, but with a few thousand random numbers for weights."""

import json
from pathlib import Path

import torch

NOISE_LEVELS = {
    "beta_start": 0.00085,
    "beta_end": 0.012,
    "beta_schedule": "scaled_linear",
    "clip_sample": False,
    "set_alpha_to_one": False,
    "steps_offset": 1,
}
"""Stable Diffusion's, as diffusers' schedulers take them."""

CROSS = 8
"""Width of text embeddings."""

WORDS = ["a", "wooden", "cube", "vase", "empty", "scene", "blur", "worst", "quality", "low", "normal", "bad"]


def write_text(folder: Path, powerpaint: bool = False, tokens: int = 48) -> None:
    """Tokenizer and text encoder that know a few words, each one token, and all others by their letters."""
    from transformers import CLIPTextConfig, CLIPTextModel, CLIPTokenizer

    vocabulary, merges = {"<|startoftext|>": 0, "<|endoftext|>": 1}, []
    for letter in "abcdefghijklmnopqrstuvwxyz0123456789_,.":
        vocabulary[letter] = len(vocabulary)
        vocabulary[letter + "</w>"] = len(vocabulary)
    for word in WORDS:
        pieces = [*word[:-1], word[-1] + "</w>"]
        while len(pieces) > 1:
            merged = pieces[0] + pieces[1]
            if merged not in vocabulary:
                vocabulary[merged] = len(vocabulary)
                merges.append((pieces[0], pieces[1]))
            pieces = [merged, *pieces[2:]]
    tokenizer = CLIPTokenizer(vocab=vocabulary, merges=merges, model_max_length=tokens)
    if powerpaint:
        tokenizer.add_tokens([f"{word}_{k}" for word in ("P_ctxt", "P_shape", "P_obj") for k in range(10)])
    tokenizer.save_pretrained(folder / "tokenizer")
    text = CLIPTextModel(
        CLIPTextConfig(
            vocab_size=len(tokenizer),
            hidden_size=CROSS,
            intermediate_size=16,
            num_hidden_layers=1,
            num_attention_heads=2,
            max_position_embeddings=tokens,
            bos_token_id=0,
            eos_token_id=1,
            pad_token_id=1,
        )
    )
    _save(text, folder / "text_encoder")


def tiny_unet(channels: int = 9, **options):
    from diffusers import UNet2DConditionModel

    return UNet2DConditionModel(
        sample_size=8,
        in_channels=channels,
        out_channels=4,
        block_out_channels=(8, 16),
        norm_num_groups=4,
        down_block_types=("CrossAttnDownBlock2D", "DownBlock2D"),
        up_block_types=("UpBlock2D", "CrossAttnUpBlock2D"),
        layers_per_block=1,
        cross_attention_dim=CROSS,
        attention_head_dim=2,
        **options,
    )


def tiny_controlnet():
    """A ControlNet whose connections, zero before training, are random: it has an effect."""
    from diffusers import ControlNetModel

    net = ControlNetModel.from_unet(tiny_unet(4), conditioning_embedding_out_channels=(4, 8, 8))
    for name, parameter in net.named_parameters():
        if parameter.abs().max() == 0.0 and name.endswith("weight"):
            torch.nn.init.normal_(parameter, std=0.2)
    return net


def write_checkpoint(
    folder: Path, *, channels: int = 9, vae: str = "kl", prediction: str = "epsilon", powerpaint: bool = False
) -> Path:
    """A Stable Diffusion folder with two ControlNets; images of 32 px, latent cells of 4 px."""
    from diffusers import AutoencoderKL, AutoencoderTiny, DDIMScheduler

    with torch.random.fork_rng(), torch.no_grad():
        torch.manual_seed(11)
        unet = tiny_unet(channels)
        for name, parameter in unet.named_parameters():
            if ".attn1." in name:  # as initialised, attention is nearly uniform and hardly adds anything
                parameter.mul_(5.0)
        _save(unet, folder / "unet")
        if vae == "kl":
            autoencoder = AutoencoderKL(
                block_out_channels=(4, 8, 8),
                down_block_types=("DownEncoderBlock2D",) * 3,
                up_block_types=("UpDecoderBlock2D",) * 3,
                latent_channels=4,
                norm_num_groups=4,
                layers_per_block=1,
                sample_size=32,
                scaling_factor=0.7,
            )
        else:
            autoencoder = AutoencoderTiny(
                encoder_block_out_channels=(4, 4, 4),
                decoder_block_out_channels=(4, 4, 4),
                num_encoder_blocks=(1, 1, 1),
                num_decoder_blocks=(1, 1, 1),
                scaling_factor=0.9,
            )
        _save(autoencoder, folder / "vae")
        write_text(folder, powerpaint)
        for kind in ("edges", "depth"):
            _save(tiny_controlnet(), folder / f"controlnet-{kind}")
    DDIMScheduler(**NOISE_LEVELS, prediction_type=prediction).save_pretrained(folder / "scheduler")
    return folder


def write_image_encoder(folder: Path, width: int = 6) -> Path:
    """CLIP's vision model."""
    from transformers import CLIPVisionConfig, CLIPVisionModelWithProjection

    with torch.random.fork_rng():
        torch.manual_seed(12)
        model = CLIPVisionModelWithProjection(
            CLIPVisionConfig(
                hidden_size=8,
                intermediate_size=16,
                projection_dim=width,
                num_hidden_layers=1,
                num_attention_heads=2,
                image_size=16,
                patch_size=4,
            )
        )
    _save(model, folder)
    settings = {"image_mean": [0.5, 0.4, 0.3], "image_std": [0.3, 0.3, 0.2]}
    (folder / "preprocessor_config.json").write_text(json.dumps(settings), encoding="utf-8")
    return folder


def write_ip_adapter(file: Path, width: int = 6) -> Path:
    """IP-Adapter weights for `tiny_unet`, in the layout of h94/IP-Adapter."""
    from safetensors.torch import save_file

    generator = torch.Generator().manual_seed(13)
    weights = {
        "image_proj.proj.weight": torch.randn(4 * CROSS, width, generator=generator),
        "image_proj.proj.bias": torch.randn(4 * CROSS, generator=generator),
        "image_proj.norm.weight": torch.ones(CROSS),
        "image_proj.norm.bias": torch.zeros(CROSS),
    }
    unet = tiny_unet()
    for index, (name, module) in enumerate(
        (name, unet.get_submodule(name.removesuffix(".processor"))) for name in unet.attn_processors
    ):
        if "attn2" in name:
            for key in ("to_k_ip", "to_v_ip"):
                weights[f"ip_adapter.{index}.{key}.weight"] = torch.randn(
                    module.to_k.out_features, CROSS, generator=generator
                )
    save_file(weights, file)
    return file


def _save(model, folder: Path) -> None:
    model.save_pretrained(folder, safe_serialization=True)
