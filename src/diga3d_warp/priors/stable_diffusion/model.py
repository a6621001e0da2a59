"""Stable Diffusion behind `DiffusionPrior`: latents, known part, controls and noise estimates."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import torch
import torch.nn.functional as F

from diga3d_warp.errors import InputError
from diga3d_warp.priors.attention import AttentionBank
from diga3d_warp.priors.conditioning import (
    GUIDANCE,
    Conditioning,
    Control,
    ControlKind,
    Guidance,
    Prompts,
)
from diga3d_warp.priors.protocol import Task
from diga3d_warp.priors.schedule import Schedule
from diga3d_warp.priors.settings import SamplingSettings
from diga3d_warp.priors.stable_diffusion import processor
from diga3d_warp.priors.stable_diffusion.image_embedding import ImageEncoder
from diga3d_warp.priors.stable_diffusion.text import TextEncoder, plain_prompts
from diga3d_warp.priors.views import fill_one

Prediction = Literal["epsilon", "v_prediction", "sample"]


@dataclass(frozen=True, eq=False)
class Networks:
    """The networks of one Stable Diffusion, frozen, in evaluation mode.

    Attributes:
        unet: `diffusers.UNet2DConditionModel`, whose input is a latent, and for inpainting also a mask and
            the latent of the known part.
        vae: `diffusers.AutoencoderKL` or `AutoencoderTiny`.
        controlnets: `diffusers.ControlNetModel` for each kind of control.
        images: CLIP's vision model, where image embeddings are wanted.
    """

    unet: Any
    vae: Any
    controlnets: Mapping[ControlKind, Any] = field(default_factory=dict)
    images: ImageEncoder | None = None


@dataclass(frozen=True, eq=False)
class Parts:
    """One Stable Diffusion: what prompts and checks need, and the networks, which are opened when used.

    Attributes:
        text: Tokenizer and text model.
        schedule: Noise levels that the UNet was trained with.
        mask_aware: Whether the UNet is given mask and known part (an inpainting UNet).
        open: Loads the networks.
        prediction: What the UNet estimates.
        control_kinds: Kinds of control for which `open` loads a ControlNet.
    """

    text: TextEncoder
    schedule: Schedule
    mask_aware: bool
    open: Callable[[], Networks]
    prediction: Prediction = "epsilon"
    control_kinds: tuple[ControlKind, ...] = ()


class StableDiffusionPrior:
    """A UNet of the Stable Diffusion family; see `DiffusionPrior` for what its methods promise.

    The networks are opened when one of them is first asked, so that a fit that comes before has their memory.

    UNet and ControlNets run in float16 on CUDA, in float32 elsewhere. The autoencoder stays in float32: score
    distillation sends small gradients through it. It encodes to the mean of its distribution, not to a draw.

    Args:
        name: Name on the command line.
        parts: The models.
        device: Where to put them.
        prompting: Makes `Prompts` of both prompts and the task.
        positive: Prompt of `guidance`, under which `fill` works, too.
        negative: Its negative prompt.
        task: Its task.
        sampling: Of views, and of `fill`.
        scale: Guidance scale of both [1].
        weights: Digest of the weights, which a run that is resumed holds to.
    """

    learned = True

    def __init__(
        self,
        name: str,
        parts: Parts,
        device: torch.device | str = "cpu",
        *,
        prompting: Callable[[TextEncoder, str, str, Task], Prompts] = plain_prompts,
        positive: str = "",
        negative: str = "",
        task: Task = "remove",
        sampling: SamplingSettings | None = None,
        scale: float = GUIDANCE,
        weights: str = "",
    ) -> None:
        self.name = name
        self.weights = weights
        self.parts = parts
        self.device = torch.device(device)
        self.dtype = torch.float16 if self.device.type == "cuda" else torch.float32
        self.schedule = parts.schedule
        self.mask_aware = parts.mask_aware
        self.control_kinds = parts.control_kinds
        self.prompting = prompting
        self.sampling = sampling or SamplingSettings()
        self._own_processors: dict[str, Any] | None = None
        parts.text.model.to(self.device)
        self.guidance = Guidance(self.encode_prompts(positive, negative, task), scale)

    @cached_property
    def networks(self) -> Networks:
        """The networks, on their device."""
        networks = self.parts.open()
        for model in (networks.unet, *networks.controlnets.values()):
            model.to(self.device, self.dtype)
        networks.vae.to(self.device)
        if networks.images is not None:
            networks.images.model.to(self.device)
        return networks

    @cached_property
    def replicas(self) -> Sequence[StableDiffusionPrior]:
        """The same prior on every further GPU that this process sees; its networks are opened when used."""
        if self.device != torch.device("cuda"):  # a GPU that was named is the only one wanted
            return ()
        return [self.on(torch.device("cuda", index)) for index in range(1, torch.cuda.device_count())]

    def on(self, device: torch.device) -> StableDiffusionPrior:
        """The same prior with networks of its own on another device; it has no replicas."""
        other = copy(self)
        other.__dict__.pop("networks", None)
        other.device, other.replicas, other._own_processors = device, (), None
        return other

    @cached_property
    def cell(self) -> int:
        """Side of a latent cell [px]."""
        return 2 ** (len(self.networks.vae.config.block_out_channels) - 1)

    def fill(
        self, image: torch.Tensor, mask: torch.Tensor, *, seed: int = 0, depth: torch.Tensor | None = None
    ) -> torch.Tensor:
        """Fill the masked pixels under `guidance`; see `Prior.fill`. The depth is not used."""
        return fill_one(self, image, mask, self.guidance, self.sampling, seed=seed)

    def native_size(self, height: int, width: int) -> tuple[int, int]:
        """Short side as in training (512 px for version 1.5), long side rounded down to whole cells.

        The paper's 512 x 904 for photographs of 567 x 1008.
        """
        short = self.networks.unet.config.sample_size * self.cell
        scale = short / min(height, width)
        tall, wide = (int(length * scale + 1e-6) // self.cell * self.cell for length in (height, width))
        return tall, wide

    def encode_image(self, images: torch.Tensor) -> torch.Tensor:
        """Latents of images; see `DiffusionPrior.encode_image`."""
        vae = self.networks.vae
        encoded = vae.encode(images.to(self.device).permute(0, 3, 1, 2) * 2.0 - 1.0)
        latents = encoded.latent_dist.mode() if hasattr(encoded, "latent_dist") else encoded.latents
        return latents * vae.config.scaling_factor

    def decode_latent(self, z: torch.Tensor) -> torch.Tensor:
        """Images of latents; see `DiffusionPrior.decode_latent`."""
        pixels = self.networks.vae.decode(z / self.networks.vae.config.scaling_factor).sample
        return ((pixels + 1.0) / 2.0).clamp(0.0, 1.0).permute(0, 2, 3, 1)

    def encode_prompts(self, positive: str, negative: str, task: Task) -> Prompts:
        """Text embeddings of both prompts.

        Raises:
            InputError: a prompt is too long, or missing where the task needs one.
        """
        if task != "remove" and not positive.strip():
            raise InputError(f"{task} needs a prompt that says what shall be there, such as 'a wooden cube'")
        return self.prompting(self.parts.text, positive, negative, task)

    def conditioning(self, images: torch.Tensor, masks: torch.Tensor) -> Conditioning:
        """Latents, mask, and for a 9-channel UNet mask and latents of the image greyed out where masked.

        A cell with any masked pixel is masked. Diffusers looks at its first pixel only, and leaves the rim of
        the removed object standing.
        """
        images, masks = images.to(self.device), masks.to(self.device)
        mask = F.max_pool2d(masks[:, None].float(), self.cell)
        latent = self.encode_image(images)
        if not self.mask_aware:
            return Conditioning(latent, mask)
        known = self.encode_image(torch.where(masks[..., None], 0.5, images))
        return Conditioning(latent, mask, torch.cat([mask, known], 1))

    def embed_images(self, images: torch.Tensor) -> torch.Tensor | None:
        """CLIP embedding of the image that others should look like, shape (1, width), or None."""
        return None if self.networks.images is None else self.networks.images.embed(images)

    @torch.no_grad()
    def predict_noise(
        self,
        z: torch.Tensor,
        t: int,
        text: torch.Tensor,
        cond: Conditioning | None = None,
        controls: Sequence[Control] = (),
        image_embeds: torch.Tensor | None = None,
    ) -> torch.Tensor:
        """Noise that `z` holds; see `DiffusionPrior.predict_noise`. Carries no gradient.

        Raises:
            InputError: a control of a kind for which there is no ControlNet.
        """
        sample = z.to(self.device, self.dtype)
        hidden = text.to(self.device, self.dtype).expand(len(z), -1, -1)
        inputs = [sample]
        if self.mask_aware:
            if cond is None or cond.channels is None:
                raise ValueError("an inpainting UNet has to be told the known part: give cond")
            inputs.append(cond.channels.to(sample))
        output = self.networks.unet(
            torch.cat(inputs, 1),
            t,
            encoder_hidden_states=hidden,
            **self._residuals(sample, t, hidden, controls),
            **self._embedding(len(z), image_embeds),
        ).sample.float()
        return self._noise(z.to(self.device), output, t)

    def install_attention(self, bank: AttentionBank | None) -> None:
        """Let the UNet's self-attentions pass through a bank; see `DiffusionPrior.install_attention`."""
        if self._own_processors is not None:
            processor.restore(self.networks.unet, self._own_processors)
            self._own_processors = None
        if bank is not None:
            self._own_processors = processor.install(self.networks.unet, bank)

    def _residuals(
        self, sample: torch.Tensor, t: int, hidden: torch.Tensor, controls: Sequence[Control]
    ) -> dict[str, Any]:
        """What the ControlNets add to the UNet's skip connections, summed over them."""
        down: list[torch.Tensor] | None = None
        middle: torch.Tensor | None = None
        for control in controls:
            if control.kind not in self.networks.controlnets:
                raise InputError(f"prior {self.name} has no ControlNet for {control.kind}: load it with one")
            added, at_middle = self.networks.controlnets[control.kind](
                sample,
                t,
                encoder_hidden_states=hidden,
                controlnet_cond=control.image[:, None].to(sample).expand(-1, 3, -1, -1),
                conditioning_scale=control.scale,
                return_dict=False,
            )
            down = list(added) if down is None else [a + b for a, b in zip(down, added, strict=True)]
            middle = at_middle if middle is None else middle + at_middle
        if down is None:
            return {}
        return {"down_block_additional_residuals": down, "mid_block_additional_residual": middle}

    def _embedding(self, count: int, image_embeds: torch.Tensor | None) -> dict[str, Any]:
        """The image embedding as the UNet takes it; zeros stand for no image, as in IP-Adapter's training."""
        if self.networks.images is None:
            return {}
        width = self.networks.images.width
        if image_embeds is None:
            image_embeds = torch.zeros(1, width)
        rows = image_embeds.to(self.device, self.dtype).expand(count, width)
        if self.networks.unet.class_embedding is not None:
            return {"class_labels": rows}
        return {"added_cond_kwargs": {"image_embeds": [rows[:, None]]}}

    def _noise(self, z: torch.Tensor, output: torch.Tensor, t: int) -> torch.Tensor:
        """Noise, from whatever the UNet predicts."""
        alpha = self.schedule.alpha(t)
        if self.parts.prediction == "epsilon":
            return output
        if self.parts.prediction == "v_prediction":
            return alpha**0.5 * output + (1.0 - alpha) ** 0.5 * z
        return self.schedule.noise_between(z, output, t)
