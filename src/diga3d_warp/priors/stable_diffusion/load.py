"""Stable Diffusion priors from folders in diffusers format."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch

from diga3d_warp.checkpoints import (
    Checkpoint,
    best_device,
    load_model,
    load_tokenizer,
    locate,
    require_diffusion,
)
from diga3d_warp.errors import InputError
from diga3d_warp.priors.conditioning import ControlKind
from diga3d_warp.priors.protocol import Task
from diga3d_warp.priors.schedule import Schedule
from diga3d_warp.priors.settings import SamplingSettings
from diga3d_warp.priors.stable_diffusion.image_embedding import (
    ImageEncoder,
    attach_class_embedding,
    attach_ip_adapter,
)
from diga3d_warp.priors.stable_diffusion.model import Parts, StableDiffusionPrior
from diga3d_warp.priors.stable_diffusion.powerpaint import knows_task_words, task_prompts
from diga3d_warp.priors.stable_diffusion.text import WORDS, TextEncoder, plain_prompts

_HALF = ("*.json", "tokenizer/*", *(f"{part}/*.fp16.safetensors" for part in ("unet", "vae", "text_encoder")))
_CONTROLNET = ("config.json", "diffusion_pytorch_model.safetensors")

PRIORS: Mapping[str, Checkpoint] = {
    "sd-inpainting": Checkpoint("stable-diffusion-v1-5/stable-diffusion-inpainting", 2.1, _HALF),
    "powerpaint": Checkpoint("Sanster/PowerPaint-V1-stable-diffusion-inpainting", 2.1, _HALF),
}
"""Priors that have a name of their own."""

CONTROLNETS: Mapping[str, Checkpoint] = {
    "edges": Checkpoint("lllyasviel/sd-controlnet-canny", 1.4, _CONTROLNET),
    "depth": Checkpoint("lllyasviel/sd-controlnet-depth", 1.4, _CONTROLNET),
}

IMAGE_ENCODER = Checkpoint("openai/clip-vit-large-patch14", 1.7)
"""Of Stable Diffusion 1.5's text model; IP-Adapter brings its own."""


def load_stable_diffusion(
    prior: str | Path,
    *,
    controls: Sequence[ControlKind] = (),
    controlnets: Mapping[str, str | Path] | None = None,
    image_encoder: str | Path | None = None,
    ip_adapter: str | Path | None = None,
    device: str = "auto",
    positive: str = "",
    negative: str = "",
    task: Task = "remove",
    sampling: SamplingSettings | None = None,
) -> StableDiffusionPrior:
    """A prior by name or folder, with what it needs beside it.

    Args:
        prior: "sd-inpainting", "powerpaint", or a folder in diffusers format. A tokenizer that knows
            PowerPaint's words gets task prompts.
        controls: Kinds of ControlNet to load: from `controlnets`, else from `controlnet-KIND` in the prior's
            folder, else from the Hugging Face cache.
        controlnets: Folders of ControlNets by kind.
        image_encoder: Folder of CLIP's vision model: the already inpainted image then enters as class
            embedding, or through `ip_adapter` if given (see `image_embedding`).
        ip_adapter: Weights file of an IP-Adapter.
        device: "auto" (CUDA where there is one), or as torch names it.
        positive: Prompt of `fill`.
        negative: Negative prompt of `fill`.
        task: Task of `fill`.
        sampling: Of views, and of `fill`.

    Raises:
        InputError: something is missing, is a pickle, or does not fit; the line says what mends it.
    """
    require_diffusion()
    from diffusers import ControlNetModel, UNet2DConditionModel

    known = PRIORS.get(str(prior))
    if known is None and not Path(prior).expanduser().exists():
        raise InputError(f"there is no prior or folder {prior}: give {', '.join(PRIORS)} or a folder")
    folder = locate(known) if known else locate(PRIORS["sd-inpainting"], prior)
    name = str(prior) if known else folder.name
    unet, vae = load_model(UNet2DConditionModel, folder / "unet"), _load_vae(folder / "vae")
    latents = vae.config.latent_channels
    if unet.config.in_channels not in (latents, 2 * latents + 1):
        raise InputError(
            f"{folder / 'unet'} has {unet.config.in_channels} input channels: "
            f"give one with {latents} or {2 * latents + 1}"
        )
    text = _load_text(folder)
    schedule, prediction = read_schedule(folder / "scheduler" / "scheduler_config.json")
    nets: dict[ControlKind, Any] = {}
    for kind in controls:
        nets[kind] = load_model(ControlNetModel, _controlnet_folder(kind, folder, controlnets or {}))
    if ip_adapter is not None and image_encoder is None:
        raise InputError(
            "an IP-Adapter needs an image encoder: give the folder models/image_encoder beside it"
        )
    images = None if image_encoder is None else ImageEncoder.load(locate(IMAGE_ENCODER, image_encoder))
    if images is not None:
        _attach(unet, images, ip_adapter)
    return StableDiffusionPrior(
        name,
        Parts(
            unet=unet,
            vae=vae,
            text=text,
            schedule=schedule,
            prediction=prediction,
            controlnets=nets,
            images=images,
        ),
        best_device(device),
        prompting=task_prompts if knows_task_words(text.tokenizer) else plain_prompts,
        positive=positive,
        negative=negative,
        task=task,
        sampling=sampling,
    )


def read_schedule(file: Path) -> tuple[Schedule, Any]:
    """Noise levels of a diffusers scheduler, whichever sampler it names, and what the UNet predicts.

    Raises:
        InputError: the file is missing or asks for levels that DDIM cannot use.
    """
    config = _read_json(file)
    kind, prediction = config.get("beta_schedule", "linear"), config.get("prediction_type", "epsilon")
    if kind not in ("scaled_linear", "linear") or config.get("rescale_betas_zero_snr"):
        raise InputError(
            f"{file}: noise levels {kind!r} are not supported: give a Stable Diffusion 1 or 2 model"
        )
    if prediction not in ("epsilon", "v_prediction", "sample"):
        raise InputError(f"{file}: prediction {prediction!r} is not supported: epsilon or v_prediction are")
    power = 2.0 if kind == "scaled_linear" else 1.0
    start, end = config.get("beta_start", 1e-4), config.get("beta_end", 0.02)
    ladder = torch.linspace(
        start ** (1 / power), end ** (1 / power), config.get("num_train_timesteps", 1000), dtype=torch.float64
    )
    alphas_cumprod = torch.cumprod(1.0 - ladder**power, 0)
    final = 1.0 if config.get("set_alpha_to_one", False) else float(alphas_cumprod[0])
    return Schedule(alphas_cumprod, final, config.get("steps_offset", 0)), prediction


def _load_text(folder: Path) -> TextEncoder:
    from transformers import CLIPTextModel, CLIPTokenizer

    model = load_model(CLIPTextModel, folder / "text_encoder")
    tokenizer = load_tokenizer(CLIPTokenizer, folder / "tokenizer")
    words = folder / "tokenizer" / WORDS
    return TextEncoder(tokenizer, model, _read_json(words) if words.exists() else None)


def _load_vae(folder: Path) -> Any:
    import diffusers

    name = _read_json(folder / "config.json").get("_class_name", "AutoencoderKL")
    if name not in ("AutoencoderKL", "AutoencoderTiny"):
        raise InputError(f"{folder} is a {name}: give an AutoencoderKL or an AutoencoderTiny")
    return load_model(getattr(diffusers, name), folder)


def _controlnet_folder(kind: str, folder: Path, given: Mapping[str, str | Path]) -> Path:
    inside = folder / f"controlnet-{kind}"
    if kind not in given and inside.is_dir():
        return inside
    return locate(CONTROLNETS[kind], given.get(kind))


def _attach(unet: Any, images: ImageEncoder, ip_adapter: str | Path | None) -> None:
    if ip_adapter is None:
        attach_class_embedding(unet, images.width)
        return
    width = attach_ip_adapter(unet, Path(ip_adapter))
    if width != images.width:
        raise InputError(
            f"{ip_adapter} takes image embeddings of {width} numbers, the encoder gives {images.width}: "
            "use the encoder that came with it"
        )


def _read_json(file: Path) -> dict[str, Any]:
    try:
        return json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{file} cannot be read: give a complete folder in diffusers format") from error
