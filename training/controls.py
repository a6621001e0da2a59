"""ControlNets for edges and depth of a trained denoiser."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F

from diga3d_warp.priors.conditioning import ControlKind
from training.checkpoint import load_checkpoint, restore
from training.denoiser import Batch, Denoiser
from training.latents import open_latents
from training.recipe import Recipe
from training.store import Store
from training.text import open_tokenizer


def build_controlnet(recipe: Recipe) -> Any:
    """Untrained `diffusers.ControlNetModel` without attention: what it adds is zero."""
    from diffusers import ControlNetModel

    own, latents = recipe.denoiser, recipe.autoencoder.latent_channels
    model: Any = ControlNetModel(
        in_channels=latents,
        block_out_channels=own.channels,
        layers_per_block=1,
        down_block_types=("DownBlock2D",) * len(own.channels),
        mid_block_type="UNetMidBlock2D",
        cross_attention_dim=recipe.text.width,
        attention_head_dim=tuple(width // own.head for width in own.channels),
        norm_num_groups=own.groups,
        conditioning_embedding_out_channels=recipe.control.embedding,
    )
    return model.to(memory_format=torch.channels_last)


class ControlLesson:
    """Teaches one ControlNet, the denoiser held fast.

    Args:
        kind: "edges" or "depth".
        recipe: All of it.
        store: Encoded samples.
        denoiser: Trained.
        tokenizer: Of the prompts.
    """

    def __init__(
        self, kind: ControlKind, recipe: Recipe, store: Store, denoiser: Denoiser, tokenizer: Any
    ) -> None:
        torch.manual_seed(recipe.seed + 2)
        self.kind, self.recipe, self.store = kind, recipe, store
        self.denoiser, self.tokenizer = denoiser, tokenizer
        self.module = build_controlnet(recipe)

    @property
    def name(self) -> str:
        """Of the checkpoint."""
        return f"controlnet-{self.kind}"

    def refresh(self) -> int:
        """Number of encoded samples."""
        return self.store.refresh()

    def losses(
        self, rng: np.random.Generator, noise: torch.Generator, records: int, batch: int
    ) -> Mapping[str, Any]:
        """Weighted squared error of v, with the control."""
        samples = Batch(rng, noise, self.store, records, batch, self.tokenizer, self.recipe)
        shown = control_images(self.kind, self.store, samples.rows, self.recipe.data.side)
        with torch.autocast("cpu", torch.bfloat16):
            with torch.no_grad():
                words = self.denoiser.text(samples.tokens)[0]
            down, middle = self.module(
                samples.noisy.contiguous(memory_format=torch.channels_last),
                samples.levels,
                encoder_hidden_states=words,
                controlnet_cond=shown.expand(-1, 3, -1, -1),
                return_dict=False,
            )
            estimate = self.denoiser.unet(
                torch.cat([samples.noisy, samples.known], 1).contiguous(memory_format=torch.channels_last),
                samples.levels,
                words,
                down_block_additional_residuals=down,
                mid_block_additional_residual=middle,
            ).sample
        return {"loss": samples.loss(estimate)}

    def picture(self, averaged: torch.nn.Module) -> np.ndarray:
        """The controls of some samples; what they do is seen with the denoiser's own pictures."""
        rows = np.arange(min(8, len(self.store.rows)))
        shown = control_images(self.kind, self.store, rows, self.recipe.data.side)[:, 0]
        return (255 * shown).to(torch.uint8).numpy().reshape(-1, shown.shape[-1])[..., None].repeat(3, -1)


def control_images(kind: ControlKind, store: Store, rows: np.ndarray, side: int) -> torch.Tensor:
    """Controls of samples, shape (B, 1, side, side), float32 in [0, 1]."""
    if kind == "edges":
        edges = np.unpackbits(store.array("edges")[rows], axis=-1)
        return torch.from_numpy(edges).float()[:, None]
    depth = torch.from_numpy(store.array("depth")[rows].astype(np.float32))[:, None] / 255
    return F.interpolate(depth, (side, side), mode="bilinear", align_corners=False)


def open_controls(kind: ControlKind, work: Path, recipe: Recipe) -> ControlLesson:
    """The lesson of a folder of work, on the denoiser's averaged weights.

    Raises:
        InputError: the denoiser is not trained yet.
    """
    tokenizer, _ = open_tokenizer(work, recipe)
    denoiser = trained_denoiser(work, recipe, tokenizer)
    return ControlLesson(kind, recipe, open_latents(work, recipe), denoiser, tokenizer)


def trained_denoiser(work: Path, recipe: Recipe, tokenizer: Any) -> Denoiser:
    """The averaged weights of the last checkpoint, frozen.

    Raises:
        InputError: it is not trained yet, or its checkpoint is broken.
    """
    path = work / "denoiser.ckpt"
    denoiser = Denoiser(recipe, tokenizer)
    restore(denoiser, load_checkpoint(path)["averaged"], path)
    return denoiser.eval().requires_grad_(False)
