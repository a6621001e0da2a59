"""The autoencoder: 128 x 128 px to 16 x 16 cells of 8 numbers, and back."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from diga3d_warp.errors import InputError
from training.checkpoint import load_checkpoint, restore, save_checkpoint
from training.recipe import AutoencoderRecipe, Recipe
from training.samples import as_seen, free_form
from training.store import Store
from training.windows import open_windows


def build_autoencoder(recipe: AutoencoderRecipe) -> Any:
    """Untrained `diffusers.AutoencoderTiny`."""
    from diffusers import AutoencoderTiny

    channels, blocks = (recipe.channels,) * 4, (recipe.blocks,) * 3
    model: Any = AutoencoderTiny(
        latent_channels=recipe.latent_channels,
        encoder_block_out_channels=channels,
        decoder_block_out_channels=channels,
        num_encoder_blocks=(0, *blocks),
        num_decoder_blocks=(*blocks, 0),
    )
    return model.to(memory_format=torch.channels_last)


class AutoencoderLesson:
    """Teaches it to give back what it is shown.

    Args:
        recipe: All of it.
        windows: Images.
    """

    name = "autoencoder"

    def __init__(self, recipe: Recipe, windows: Store) -> None:
        torch.manual_seed(recipe.seed)
        self.recipe, self.windows = recipe, windows
        self.module = build_autoencoder(recipe.autoencoder)

    def refresh(self) -> int:
        """Number of images."""
        return self.windows.refresh()

    def losses(
        self, rng: np.random.Generator, noise: torch.Generator, records: int, batch: int
    ) -> Mapping[str, Any]:
        """Difference of images and of their gradients, and of the latents' spread from 1."""
        recipe = self.recipe.autoencoder
        images = self._images(rng, rng.integers(records, size=batch), recipe.crop)
        with torch.autocast("cpu", torch.bfloat16):
            latents = self.module.encoder(images)
            shaken = latents + recipe.noise * torch.randn(latents.shape, generator=noise)
            back = self.module.decoder(shaken)
        back, latents = back.float(), latents.float()
        pixels = (back - images).abs().mean()
        slopes = sum((back.diff(dim=axis) - images.diff(dim=axis)).abs().mean() for axis in (2, 3))
        spread, mean = torch.std_mean(latents, (0, 2, 3))
        even = ((spread - 1).square() + mean.square()).mean()
        squared = (0.5 * (back - images)).square().mean()
        return {
            "loss": pixels + recipe.gradients * slopes + recipe.spread * even,
            "pixels": pixels,
            "psnr": -10 * squared.log10(),
            "even": even,
        }

    @torch.no_grad()
    def picture(self, averaged: Any) -> np.ndarray:
        """Eight images above what comes back of them."""
        rng = np.random.default_rng(1)
        images = self._images(rng, rng.integers(len(self.windows.rows), size=8), self.recipe.data.side)
        back = averaged.decoder(averaged.encoder(images))
        return contact_sheet(torch.cat([images, back]), 8)

    def _images(self, rng: np.random.Generator, rows: np.ndarray, side: int) -> torch.Tensor:
        """Parts of images in [-1, 1], shape (B, 3, side, side)."""
        stored, batch = self.windows.array("image"), []
        for row in rows:
            top, left = rng.integers(stored.shape[1] - side + 1, size=2)
            image = stored[row][top : top + side, left : left + side]
            image, _ = as_seen(rng, image, self.recipe.samples)
            if rng.random() < self.recipe.autoencoder.greyed:
                image = torch.where(free_form(rng, side)[..., None], 0.5, image)
            batch.append(image)
        stacked = torch.stack(batch).permute(0, 3, 1, 2)
        return (2 * stacked - 1).contiguous(memory_format=torch.channels_last)


class DecoderLesson(AutoencoderLesson):
    """Teaches the decoder further, the encoder held fast, so that encoded samples stay what they are.

    Args:
        recipe: All of it.
        windows: Images.
        encoder: The autoencoder that a denoiser is trained with.
    """

    name = "decoder"

    def __init__(self, recipe: Recipe, windows: Store, encoder: Encoder) -> None:
        super().__init__(recipe, windows)
        self.module.load_state_dict(encoder.model.state_dict())
        self.module.encoder.requires_grad_(False)


def contact_sheet(images: torch.Tensor, columns: int) -> np.ndarray:
    """Images (N, 3, H, W) in [-1, 1] side by side, RGB, uint8."""
    count, _, height, width = images.shape
    shown = ((images.float().clamp(-1, 1) + 1) * 127.5).round().to(torch.uint8)
    rows = shown.view(count // columns, columns, 3, height, width).permute(0, 3, 1, 4, 2)
    return rows.reshape(count // columns * height, columns * width, 3).numpy()


FROZEN = "autoencoder-frozen.ckpt"
"""The autoencoder that samples are encoded with. To encode them with one that was trained further, delete
this file and the folder `latents` beside it."""


FEW = 8
"""Images that are encoded together: their features fit a processor's cache; more take twice as long each."""


class Encoder:
    """The autoencoder that a denoiser is trained with: from then on it stays as it is.

    Args:
        model: `diffusers.AutoencoderTiny`, frozen; its config holds the scale of the latents.
    """

    def __init__(self, model: Any) -> None:
        self.model = model

    @staticmethod
    def frozen(work: Path, recipe: Recipe) -> Encoder:
        """The averaged weights of the autoencoder's checkpoint of the first call, its decoder taught further.

        Raises:
            InputError: it is not trained yet, or its checkpoint is broken.
        """
        path, kept = work / "autoencoder.ckpt", work / FROZEN
        model = build_autoencoder(recipe.autoencoder)
        if not kept.exists():
            if not path.exists():
                raise InputError(f"{path} does not exist: train the autoencoder first")
            trained = load_checkpoint(path)
            restore(model, trained["averaged"], path)
            deviation = _deviation(model, open_windows(work, recipe.data))
            save_checkpoint(
                kept, {"model": model.state_dict(), "scale": 1 / deviation, "step": trained["step"]}
            )
        state = load_checkpoint(kept)
        restore(model, state["model"], kept)
        model.register_to_config(scaling_factor=state["scale"])
        taught = work / "decoder.ckpt"
        if taught.exists():
            restore(model, load_checkpoint(taught)["averaged"], taught)
        return Encoder(model.eval().requires_grad_(False))

    @torch.no_grad()
    def __call__(self, images: torch.Tensor) -> torch.Tensor:
        """Scaled latents of images (B, H, W, 3) in [0, 1], shape (B, C, h, w), float32."""
        scale, parts = self.model.config.scaling_factor, []
        for few in images.split(FEW):
            pixels = (2 * few.permute(0, 3, 1, 2) - 1).contiguous(memory_format=torch.channels_last)
            with torch.autocast("cpu", torch.bfloat16):
                parts.append(self.model.encoder(pixels).float().contiguous() * scale)
        return torch.cat(parts)


@torch.no_grad()
def _deviation(model: Any, windows: Store) -> float:
    """Deviation of the latents of some hundred images."""
    rows = np.random.default_rng(0).integers(len(windows.rows), size=256)
    images = torch.from_numpy(windows.array("image")[rows]).permute(0, 3, 1, 2) / 127.5 - 1
    return float(model.encoder(images.contiguous(memory_format=torch.channels_last)).std())
