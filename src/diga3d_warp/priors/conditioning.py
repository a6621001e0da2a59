"""Conditioning of a noise estimate: prompts, the known part of the image, control images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import torch

GUIDANCE = 7.5
"""Guidance scale (paper, appendix)."""


@dataclass(frozen=True)
class Prompts:
    """The positive and the negative prompt (Tp and Tn in the paper) in the form of one prior.

    Attributes:
        positive: Text embeddings, or a set of patches.
        negative: The same of the negative prompt; of the empty prompt, if there is none.
    """

    positive: Any
    negative: Any


@dataclass(frozen=True)
class Guidance:
    """Prompts, and how strongly they guide the sampling (classifier-free guidance).

    Attributes:
        prompts: Tp and Tn, from `DiffusionPrior.encode_prompts`.
        scale: Guidance scale [1]; at 1 the negative prompt has no effect and is not evaluated.
        image_embeds: Embedding of an image that the result should look like, from
            `DiffusionPrior.embed_images`. Given to the positive half only, so that guidance also pulls
            towards it.
    """

    prompts: Prompts
    scale: float = GUIDANCE
    image_embeds: Any = None


@dataclass(frozen=True)
class Conditioning:
    """The known part of B images, as a prior is conditioned on it.

    Attributes:
        latent: The clean images as latents, shape (B, C, h, w).
        mask: 1 where to inpaint, shape (B, 1, h, w).
        channels: Further input channels of the model, shape (B, C', h, w), or None: mask and masked latents
            of a 9-channel inpainting UNet.
        prepared: What the prior computes of each image once for all timesteps, B entries on its device; None
            if nothing.
        inpainted: Whether `latent` already shows the inpainted image, as that of a finished reference does.
    """

    latent: torch.Tensor
    mask: torch.Tensor
    channels: torch.Tensor | None = None
    prepared: tuple[Any, ...] | None = None
    inpainted: bool = False

    def rows(self, rows: Sequence[int], device: torch.device) -> Conditioning:
        """The conditioning of some of the images, on a device."""
        chosen = list(rows)
        channels = None if self.channels is None else self.channels[chosen].to(device)
        prepared = None if self.prepared is None else tuple(self.prepared[row] for row in chosen)
        return Conditioning(self.latent[chosen].to(device), self.mask[chosen].to(device), channels, prepared)


ControlKind = Literal["edges", "depth"]


@dataclass(frozen=True)
class ControlScales:
    """Weights of the controls.

    Attributes:
        edges: Of the texture map [1]. Paper, appendix: 0.8.
        depth: Of the depth map [1]. Paper, appendix: 1.
    """

    edges: float = 0.8
    depth: float = 1.0


@dataclass(frozen=True)
class Control:
    """A control image (ControlNet).

    Attributes:
        kind: Edges (0 or 1), or inverse depth in [0, 1] with near bright, as ControlNet was trained.
        image: One channel for each of B images, shape (B, H, W), float32 in [0, 1].
        scale: Weight of the control [1], see `ControlScales`.
    """

    kind: ControlKind
    image: torch.Tensor
    scale: float

    def rows(self, rows: Sequence[int], device: torch.device) -> Control:
        """The control of some of the images, on a device."""
        return Control(self.kind, self.image[list(rows)].to(device), self.scale)
