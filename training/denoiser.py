"""The inpainting UNet with its text encoder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from diga3d_warp.priors.schedule import Schedule
from training.autoencoder import Encoder, contact_sheet
from training.captions import prompt_of
from training.latents import open_latents
from training.recipe import Recipe
from training.sheet import sample_sheet
from training.store import Store
from training.text import build_text_encoder, open_tokenizer
from training.windows import open_windows

SCHEDULE = Schedule.scaled_linear()
"""Noise levels: Stable Diffusion's."""


def build_unet(recipe: Recipe) -> Any:
    """Untrained `diffusers.UNet2DConditionModel` that takes noisy latents, mask and known latents."""
    from diffusers import UNet2DConditionModel

    own, latents = recipe.denoiser, recipe.autoencoder.latent_channels
    down = tuple("CrossAttnDownBlock2D" if attends else "DownBlock2D" for attends in own.attention)
    up = tuple("CrossAttnUpBlock2D" if attends else "UpBlock2D" for attends in reversed(own.attention))
    model: Any = UNet2DConditionModel(
        sample_size=recipe.data.side // 2**3,
        in_channels=2 * latents + 1,
        out_channels=latents,
        block_out_channels=own.channels,
        layers_per_block=1,
        down_block_types=down,
        up_block_types=up,
        cross_attention_dim=recipe.text.width,
        attention_head_dim=tuple(width // own.head for width in own.channels),
        norm_num_groups=own.groups,
    )
    return model.to(memory_format=torch.channels_last)


class Denoiser(torch.nn.Module):
    """UNet and text encoder, trained together.

    Args:
        recipe: Their sizes.
        tokenizer: Of the prompts.
    """

    def __init__(self, recipe: Recipe, tokenizer: Any) -> None:
        from diffusers.models.attention_processor import AttnProcessor

        super().__init__()
        self.unet = build_unet(recipe)
        # Torch's fused attention takes a third of a step on a CPU, going back; plain products do not.
        self.unet.set_attn_processor(AttnProcessor())
        self.text = build_text_encoder(tokenizer, recipe.text)


class Batch:
    """Samples of a step.

    Args:
        rng: Chooses samples and prompts.
        noise: Draws noise and noise levels.
        store: Encoded samples.
        records: Number of them to choose from.
        batch: How many to choose.
        tokenizer: Of the prompts.
        recipe: Shares and sizes.

    Attributes:
        rows: Indices of the samples.
        noisy: Noisy latents, shape (B, C, h, w).
        known: Mask and known latents, shape (B, 1 + C, h, w).
        target: v of each sample, shape (B, C, h, w).
        weights: Of each cell in the loss, shape (B, 1, h, w).
        levels: Timesteps, shape (B,).
        tokens: Of the prompts, shape (B, T).
    """

    def __init__(
        self,
        rng: np.random.Generator,
        noise: torch.Generator,
        store: Store,
        records: int,
        batch: int,
        tokenizer: Any,
        recipe: Recipe,
    ) -> None:
        self.rows = np.sort(rng.integers(records, size=batch))
        clean = torch.from_numpy(store.array("latent")[self.rows].astype(np.float32))
        mask = torch.from_numpy(np.unpackbits(store.array("mask")[self.rows], axis=-1)).float()[:, None]
        known = torch.from_numpy(store.array("known")[self.rows].astype(np.float32))
        self.levels = torch.randint(len(SCHEDULE), (len(clean),), generator=noise)
        drawn = torch.randn(clean.shape, generator=noise)
        alpha = SCHEDULE.alphas_cumprod[self.levels].float().view(-1, 1, 1, 1)
        self.noisy = alpha.sqrt() * clean + (1 - alpha).sqrt() * drawn
        self.target = alpha.sqrt() * drawn - (1 - alpha).sqrt() * clean
        self.known = torch.cat([mask, known], 1)
        snr = alpha / (1 - alpha)
        each = (snr.clamp(max=recipe.denoiser.snr) + 1) / (snr + 1)
        self.weights = each * torch.where(mask > 0, 1.0, recipe.denoiser.known)
        prompts = [prompt_of(rng, store.rows[row], recipe.prompts) for row in self.rows]
        self.tokens = tokenizer(
            prompts, padding="max_length", max_length=recipe.text.tokens, truncation=True, return_tensors="pt"
        ).input_ids

    def loss(self, estimate: torch.Tensor) -> torch.Tensor:
        """Weighted squared error of an estimate of v."""
        squared = (estimate.float() - self.target).square().mean(1, keepdim=True)
        return (self.weights * squared).sum() / self.weights.sum()


class DenoiserLesson:
    """Teaches UNet and text encoder.

    Args:
        recipe: All of it.
        store: Encoded samples.
        tokenizer: Of the prompts.
        encoder: Frozen autoencoder, for pictures.
        shown: Windows of held-out rooms, for pictures.
    """

    name = "denoiser"

    def __init__(self, recipe: Recipe, store: Store, tokenizer: Any, encoder: Encoder, shown: Store) -> None:
        torch.manual_seed(recipe.seed + 1)
        self.recipe, self.store, self.tokenizer = recipe, store, tokenizer
        self.encoder, self.shown = encoder, shown
        self.module = Denoiser(recipe, tokenizer)

    def refresh(self) -> int:
        """Number of encoded samples."""
        return self.store.refresh()

    def losses(
        self, rng: np.random.Generator, noise: torch.Generator, records: int, batch: int
    ) -> Mapping[str, Any]:
        """Weighted squared error of v."""
        samples = Batch(rng, noise, self.store, records, batch, self.tokenizer, self.recipe)
        with torch.autocast("cpu", torch.bfloat16):
            words = self.module.text(samples.tokens)[0]
            given = torch.cat([samples.noisy, samples.known], 1).contiguous(memory_format=torch.channels_last)
            estimate = self.module.unet(given, samples.levels, words).sample
        return {"loss": samples.loss(estimate)}

    def picture(self, averaged: torch.nn.Module) -> np.ndarray:
        """Held-out windows: what is given, filled without prompt, and with the object's prompt; the truth."""
        tiles = sample_sheet(averaged, self.tokenizer, self.encoder, self.shown, SCHEDULE)
        return contact_sheet(torch.cat(tiles), len(tiles[0]))


def open_denoiser(work: Path, recipe: Recipe) -> DenoiserLesson:
    """The lesson of a folder of work.

    Raises:
        InputError: the autoencoder is not trained yet.
    """
    tokenizer, _ = open_tokenizer(work, recipe)
    encoder = Encoder.frozen(work, recipe)
    return DenoiserLesson(
        recipe, open_latents(work, recipe), tokenizer, encoder, open_windows(work, recipe.data, "held_out")
    )
