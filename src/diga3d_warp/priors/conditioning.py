"""What a noise estimate is given beside the latents: prompts, the known part of the image, controls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import torch

GUIDANCE = 7.5
"""Guidance scale (paper, appendix)."""


@dataclass(frozen=True)
class Prompts:
    """What the positive and the negative prompt (Tp and Tn in the paper) mean to one prior.

    Attributes:
        positive: What to go towards, in the prior's own form: text embeddings, or a set of patches.
        negative: What to go away from, in the same form; without a negative prompt, the empty prompt.
    """

    positive: Any
    negative: Any


@dataclass(frozen=True)
class Guidance:
    """What an image shall show, and how strongly.

    Attributes:
        prompts: Tp and Tn, from `DiffusionPrior.encode_prompts`.
        scale: Guidance scale [1]; at 1 the negative prompt does nothing and costs nothing.
        image_embeds: The image that the result should look like, from `DiffusionPrior.embed_images`. Only the
            positive half sees it, so that guidance also pulls towards it.
    """

    prompts: Prompts
    scale: float = GUIDANCE
    image_embeds: Any = None


@dataclass(frozen=True)
class Conditioning:
    """What a prior is told about the known part of B images.

    Attributes:
        latent: The clean images as latents, shape (B, C, h, w).
        mask: 1 where to invent, shape (B, 1, h, w).
        channels: What else the model is given for each cell, shape (B, C', h, w), or None. For a 9-channel
            inpainting UNet mask and masked latents; what another prior puts here is its own affair.
        prepared: What the prior has worked out of each image once, for all timesteps, B entries on its
            device; None if it works out nothing.
        settled: Whether `latent` shows what was to be invented already, as of a reference that is filled.
    """

    latent: torch.Tensor
    mask: torch.Tensor
    channels: torch.Tensor | None = None
    prepared: tuple[Any, ...] | None = None
    settled: bool = False

    def rows(self, rows: Sequence[int], device: torch.device) -> Conditioning:
        """The conditioning of some of the images, on a device."""
        chosen = list(rows)
        channels = None if self.channels is None else self.channels[chosen].to(device)
        prepared = None if self.prepared is None else tuple(self.prepared[row] for row in chosen)
        return Conditioning(self.latent[chosen].to(device), self.mask[chosen].to(device), channels, prepared)


ControlKind = Literal["edges", "depth"]

EDGES_SCALE = 0.8
DEPTH_SCALE = 1.0
"""Condition scales of texture and depth (paper, appendix)."""


@dataclass(frozen=True)
class Control:
    """An image that the generated one has to follow (ControlNet).

    Attributes:
        kind: Edges (0 or 1), or inverse depth in [0, 1] with near bright, as ControlNet was trained.
        image: One channel for each of B images, shape (B, H, W), float32 in [0, 1].
        scale: Weight of the control [1]: `EDGES_SCALE` or `DEPTH_SCALE`.
    """

    kind: ControlKind
    image: torch.Tensor
    scale: float

    def rows(self, rows: Sequence[int], device: torch.device) -> Control:
        """The control of some of the images, on a device."""
        return Control(self.kind, self.image[list(rows)].to(device), self.scale)
