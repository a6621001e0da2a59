"""Protocols of priors: `Prior` fills one image, `DiffusionPrior` also estimates noise."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, Protocol, runtime_checkable

import torch

from diga3d_warp.errors import InputError
from diga3d_warp.priors.attention import AttentionBank
from diga3d_warp.priors.conditioning import Conditioning, Control, ControlKind, Guidance, Prompts
from diga3d_warp.priors.schedule import Schedule
from diga3d_warp.priors.settings import SamplingSettings

Task = Literal["remove", "retexture", "replace"]
"""Task of the prompts. Priors whose prompts do not depend on the task ignore it."""


class Prior(Protocol):
    """Fills image regions that no photograph shows.

    The classical prior and LaMa have `fill` only. `DiffusionPrior` adds noise estimates, which attention
    propagation and score distillation need.
    """

    @property
    def name(self) -> str:
        """Name on the command line."""
        ...

    def fill(
        self, image: torch.Tensor, mask: torch.Tensor, *, seed: int = 0, depth: torch.Tensor | None = None
    ) -> torch.Tensor:
        """Fill the masked pixels so that they continue the others.

        Args:
            image: RGB in [0, 1], shape (H, W, 3), float32. Masked pixels are not read.
            mask: True where to fill, shape (H, W), bool. May be empty.
            seed: The same image, mask and seed give the same bytes.
            depth: z of the surface to be seen at each pixel, also behind the mask [scene units], positive,
                shape (H, W), float32. Says which surroundings continue behind the mask; a prior may ignore
                it.

        Returns:
            Filled image, shape (H, W, 3), float32 in [0, 1]; unmasked pixels are exactly those of `image`.

        Raises:
            InputError: the mask covers everything, or the shapes do not fit.
        """
        ...


@runtime_checkable
class DiffusionPrior(Prior, Protocol):
    """A prior that estimates noise in latents.

    For a prior that works on pixels the latent is the image in [-1, 1], shape (B, 3, H, W). Sampling,
    guidance, inversion and score distillation use only what is listed here, so they are written once.
    """

    @property
    def schedule(self) -> Schedule:
        """Noise levels of the prior."""
        ...

    @property
    def device(self) -> torch.device:
        """Device of the latents."""
        ...

    @property
    def mask_aware(self) -> bool:
        """Whether `predict_noise` is conditioned on the known part itself.

        If not, sampling puts the known part, as noisy as the rest, back after each step.
        """
        ...

    @property
    def guidance(self) -> Guidance:
        """The prompts that the prior was loaded with, and its guidance scale."""
        ...

    @property
    def sampling(self) -> SamplingSettings:
        """Default sampling settings of the prior."""
        ...

    @property
    def learned(self) -> bool:
        """Whether the prior has trained weights, rather than only the patches of the images at hand."""
        ...

    @property
    def control_kinds(self) -> Sequence[ControlKind]:
        """Kinds of control that `predict_noise` can follow."""
        ...

    def native_size(self, height: int, width: int) -> tuple[int, int]:
        """Height and width [px] at which to give the prior an image of this size; latents need no padding."""
        ...

    def encode_image(self, images: torch.Tensor) -> torch.Tensor:
        """Latents of images of a native size.

        Args:
            images: RGB in [0, 1], shape (B, H, W, 3). Carries gradient.

        Returns:
            Latents, shape (B, C, h, w), scaled to about unit variance.
        """
        ...

    def decode_latent(self, z: torch.Tensor) -> torch.Tensor:
        """Images in [0, 1], shape (B, H, W, 3), of latents, shape (B, C, h, w), which carry gradient."""
        ...

    def encode_prompts(self, positive: str, negative: str, task: Task) -> Prompts:
        """Encode prompts in the form of this prior.

        Raises:
            InputError: a prompt that the prior does not understand.
        """
        ...

    def conditioning(self, images: torch.Tensor, masks: torch.Tensor) -> Conditioning:
        """Condition on the known part of images.

        Args:
            images: RGB in [0, 1], shape (B, H, W, 3), of a native size.
            masks: True where to inpaint, shape (B, H, W), bool.
        """
        ...

    def embed_images(self, images: torch.Tensor) -> Any:
        """`image_embeds` for `predict_noise` from images (B, H, W, 3); None without an image encoder."""
        ...

    def predict_noise(
        self,
        z: torch.Tensor,
        t: int,
        text: Any,
        cond: Conditioning | None = None,
        controls: Sequence[Control] = (),
        image_embeds: Any = None,
    ) -> torch.Tensor:
        """Estimate the noise in `z`, whatever parametrisation the model itself predicts.

        Args:
            z: Noisy latents, shape (B, C, h, w).
            t: Timestep of `schedule`.
            text: `Prompts.positive` or `Prompts.negative`, for all B images. The two halves of
                classifier-free guidance come in two calls, so that attention banks keep them apart.
            cond: Known part, B rows. None only for a prior that is not `mask_aware`.
            controls: Control images, B rows each.
            image_embeds: From `embed_images`, for all B images: the image that they should look like.

        Returns:
            Noise, shape (B, C, h, w): z = sqrt(abar_t) x + sqrt(1 - abar_t) noise.
        """
        ...

    def install_attention(self, bank: AttentionBank | None) -> None:
        """Let every self-attention pass through `bank.attend`; None takes the last bank out again."""
        ...


@runtime_checkable
class Replicated(Protocol):
    """A prior that is on several devices."""

    @property
    def replicas(self) -> Sequence[DiffusionPrior]:
        """The same prior on each further device."""
        ...


def check_shapes(image: torch.Tensor, mask: torch.Tensor) -> None:
    """Refuse an image and a mask that are not of one size.

    Raises:
        InputError: the shapes do not fit.
    """
    if image.ndim != 3 or image.shape[2] != 3 or mask.shape != image.shape[:2]:
        raise InputError(
            f"image {tuple(image.shape)} and mask {tuple(mask.shape)} do not fit: give (H, W, 3) and (H, W)"
        )


def check_fill(image: torch.Tensor, mask: torch.Tensor) -> None:
    """Refuse an image and a mask that no prior can fill.

    Raises:
        InputError: the mask covers everything, or the shapes do not fit.
    """
    check_shapes(image, mask)
    if bool(mask.all()):
        raise InputError(
            "the mask covers the whole image, which leaves nothing to continue from: give a smaller mask"
        )
