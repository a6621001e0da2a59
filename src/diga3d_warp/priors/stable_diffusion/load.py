"""Stable Diffusion priors from folders in diffusers format."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from diga3d_warp.checkpoints import (
    Checkpoint,
    best_device,
    check_model,
    load_model,
    load_tokenizer,
    locate,
    read_config,
    read_json,
    require_diffusion,
)
from diga3d_warp.errors import InputError
from diga3d_warp.priors.conditioning import GUIDANCE, ControlKind
from diga3d_warp.priors.protocol import Task
from diga3d_warp.priors.schedule import Schedule
from diga3d_warp.priors.settings import SamplingSettings
from diga3d_warp.priors.stable_diffusion.image_embedding import (
    ImageEncoder,
    attach_class_embedding,
    attach_ip_adapter,
    check_ip_adapter,
)
from diga3d_warp.priors.stable_diffusion.model import Networks, Parts, StableDiffusionPrior
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

SAMPLE, SAMPLES = 65_536, 64
"""Bytes of a sample, and samples of a file, by which weights are told from others: 4 GB take no time."""

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
    scale: float = GUIDANCE,
) -> StableDiffusionPrior:
    """A prior by name or folder, with what it needs beside it.

    Only the text model is loaded at once; the files of the networks are checked, and loaded when the prior is
    first used.

    Args:
        prior: "sd-inpainting", "powerpaint", or a folder in diffusers format. A tokenizer that knows
            PowerPaint's words gets task prompts.
        controls: Kinds of ControlNet to load: from `controlnets`, else from `controlnet-KIND` in the prior's
            folder, else from the Hugging Face cache.
        controlnets: Folders of ControlNets by kind.
        image_encoder: Folder of CLIP's vision model: the already inpainted image then enters as class
            embedding, or through `ip_adapter` if given (see `image_embedding`). If None, `image_encoder` in
            the folder of a prior whose UNet was trained with a class embedding.
        ip_adapter: Weights file of an IP-Adapter.
        device: "auto" (CUDA where there is one), or as torch names it.
        positive: Prompt of `fill`.
        negative: Negative prompt of `fill`.
        task: Task of `fill`.
        sampling: Of views, and of `fill`.
        scale: Guidance scale of both [1].

    Raises:
        InputError: something is missing, is a pickle, or does not fit; the line says what mends it.
    """
    require_diffusion()
    known = PRIORS.get(str(prior))
    if known is None and not Path(prior).expanduser().exists():
        raise InputError(f"there is no prior or folder {prior}: give {', '.join(PRIORS)} or a folder")
    folder = locate(known) if known else locate(PRIORS["sd-inpainting"], prior)
    text = _load_text(folder)
    schedule, prediction = read_schedule(folder / "scheduler" / "scheduler_config.json")
    unet, vae = read_config(folder / "unet"), read_config(folder / "vae")
    latents, channels = vae.get("latent_channels", 4), unet.get("in_channels", 4)
    if channels not in (latents, 2 * latents + 1):
        raise InputError(
            f"{folder / 'unet'} has {channels} input channels for {latents} of the autoencoder: "
            f"give one with {latents} or {2 * latents + 1}"
        )
    if image_encoder is None and unet.get("class_embed_type") == "simple_projection":
        inside = folder / "image_encoder"
        image_encoder = inside if inside.is_dir() else None
    if ip_adapter is not None and image_encoder is None:
        raise InputError(
            "an IP-Adapter needs an image encoder: give the folder models/image_encoder beside it"
        )
    files = _Files(
        unet=folder / "unet",
        vae=folder / "vae",
        controlnets={kind: _controlnet_folder(kind, folder, controlnets or {}) for kind in controls},
        images=None if image_encoder is None else locate(IMAGE_ENCODER, image_encoder),
        ip_adapter=None if ip_adapter is None else Path(ip_adapter),
    )
    files.check()
    return StableDiffusionPrior(
        str(prior) if known else folder.name,
        Parts(
            text=text,
            schedule=schedule,
            mask_aware=channels != latents,
            open=files.open,
            prediction=prediction,
            control_kinds=tuple(controls),
        ),
        best_device(device),
        prompting=task_prompts if knows_task_words(text.tokenizer) else plain_prompts,
        positive=positive,
        negative=negative,
        task=task,
        sampling=sampling,
        scale=scale,
        weights=files.digest(),
    )


@dataclass(frozen=True)
class _Files:
    """Where the networks are.

    Attributes:
        unet, vae: Folders.
        controlnets: Folders by kind.
        images: Folder of the image encoder, if there is one.
        ip_adapter: Weights file of the IP-Adapter, if there is one.
    """

    unet: Path
    vae: Path
    controlnets: Mapping[ControlKind, Path]
    images: Path | None
    ip_adapter: Path | None

    def check(self) -> None:
        """Refuse files that `open` could not read, without reading their weights."""
        _vae_class(self.vae)
        for folder in (self.unet, self.vae, *self.controlnets.values(), self.images):
            if folder is not None:
                check_model(folder)
        if self.ip_adapter is not None:
            check_ip_adapter(self.ip_adapter)

    def digest(self) -> str:
        """What tells these weights from others: sizes, headers, and samples of the numbers."""
        digest = hashlib.blake2b(digest_size=8)
        folders = (self.unet, self.vae, *self.controlnets.values(), self.images)
        files = [file for folder in folders if folder for file in sorted(folder.glob("*.safetensors"))]
        for file in [*files, *([self.ip_adapter] if self.ip_adapter else [])]:
            size = file.stat().st_size
            digest.update(str(size).encode())
            with file.open("rb") as stream:
                for start in range(0, size, max(SAMPLE, size // SAMPLES)):
                    stream.seek(start)
                    digest.update(stream.read(SAMPLE))
        return digest.hexdigest()

    def open(self) -> Networks:
        """Load the networks.

        Raises:
            InputError: weights are incomplete or do not fit.
        """
        from diffusers import ControlNetModel, UNet2DConditionModel

        unet = load_model(UNet2DConditionModel, self.unet)
        images = None if self.images is None else ImageEncoder.load(self.images)
        if images is not None:
            _attach(unet, images, self.ip_adapter)
        return Networks(
            unet=unet,
            vae=load_model(_vae_class(self.vae), self.vae),
            controlnets={k: load_model(ControlNetModel, path) for k, path in self.controlnets.items()},
            images=images,
        )


def read_schedule(file: Path) -> tuple[Schedule, Any]:
    """Noise levels of a diffusers scheduler, whichever sampler it names, and what the UNet predicts.

    Raises:
        InputError: the file is missing or asks for levels that DDIM cannot use.
    """
    config = read_json(file)
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
    return TextEncoder(tokenizer, model, read_json(words) if words.exists() else None)


def _vae_class(folder: Path) -> Any:
    import diffusers

    name = read_config(folder).get("_class_name", "AutoencoderKL")
    if name not in ("AutoencoderKL", "AutoencoderTiny"):
        raise InputError(f"{folder} is a {name}: give an AutoencoderKL or an AutoencoderTiny")
    return getattr(diffusers, name)


def _controlnet_folder(kind: str, folder: Path, given: Mapping[str, str | Path]) -> Path:
    inside = folder / f"controlnet-{kind}"
    if kind not in given and inside.is_dir():
        return inside
    return locate(CONTROLNETS[kind], given.get(kind))


def _attach(unet: Any, images: ImageEncoder, ip_adapter: Path | None) -> None:
    if ip_adapter is None:
        attach_class_embedding(unet, images.width)
        return
    width = attach_ip_adapter(unet, ip_adapter)
    if width != images.width:
        raise InputError(
            f"{ip_adapter} takes image embeddings of {width} numbers, the encoder gives {images.width}: "
            "use the encoder that came with it"
        )
