"""Samples of a denoiser in held-out rooms, as pictures."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from diga3d_warp.priors.conditioning import Guidance
from diga3d_warp.priors.schedule import Schedule
from diga3d_warp.priors.settings import SamplingSettings
from diga3d_warp.priors.stable_diffusion.model import Networks, Parts, StableDiffusionPrior
from diga3d_warp.priors.stable_diffusion.text import TextEncoder
from diga3d_warp.priors.views import inpaint_views
from training.autoencoder import Encoder
from training.captions import caption_of
from training.samples import grown
from training.store import Store

COLUMNS = 6
"""Windows on a sheet."""

STEPS = 12
"""DDIM steps of a sheet."""

GROWN = 4
"""Pixels by which silhouettes are grown."""


def as_prior(denoiser: Any, tokenizer: Any, encoder: Encoder, schedule: Schedule, **options: Any) -> Any:
    """A trained denoiser as `diga3d` uses it.

    Args:
        denoiser: UNet and text encoder.
        tokenizer, encoder, schedule: Those that it was trained with.
        options: Of `Networks`.
    """
    networks = Networks(unet=denoiser.unet, vae=encoder.model, **options)
    parts = Parts(
        text=TextEncoder(tokenizer, denoiser.text),
        schedule=schedule,
        mask_aware=True,
        open=lambda: networks,
        prediction="v_prediction",
        control_kinds=tuple(networks.controlnets),
    )
    return StableDiffusionPrior("room", parts)


@torch.no_grad()
def sample_sheet(
    denoiser: Any, tokenizer: Any, encoder: Encoder, windows: Store, schedule: Schedule
) -> list[torch.Tensor]:
    """Rows of images in [-1, 1], shape (COLUMNS, 3, H, W) each.

    What is given; filled without prompt; the truth without object; filled with the object's caption; the
    truth of that.
    """
    training = denoiser.training
    prior = as_prior(denoiser.eval(), tokenizer, encoder, schedule)
    rows = np.linspace(0, len(windows.rows) - 1, COLUMNS).astype(int)
    tiles: list[list[torch.Tensor]] = [[] for _ in range(5)]
    for row in rows:
        thing, alone = _pair(windows, int(row))
        place = windows.rows[thing]["thing"]
        bits = np.unpackbits(windows.array("mask")[thing][place], axis=-1).astype(bool)
        mask = grown(torch.from_numpy(bits), GROWN)
        with_object, without = (
            torch.from_numpy(windows.array("image")[i].copy()).float() / 255 for i in (thing, alone)
        )
        said = caption_of(windows.rows[thing])
        filled = []
        for prompt, scale in (("", 1.0), (said, 5.0)):
            guidance = Guidance(prior.encode_prompts(prompt, "", "remove"), scale)
            views = inpaint_views(prior, [with_object], [mask], guidance, SamplingSettings(steps=STEPS))
            filled.append(next(views))
        given = torch.where(mask[..., None], 0.5, with_object)
        for tile, image in zip(tiles, (given, filled[0], without, filled[1], with_object), strict=True):
            tile.append(2 * image.permute(2, 0, 1) - 1)
    denoiser.train(training)
    return [torch.stack(tile) for tile in tiles]


def _pair(windows: Store, row: int) -> tuple[int, int]:
    """The first image with an object from a row on, or the last one, and the one of its window without."""
    things = [i for i, described in enumerate(windows.rows) if described["thing"] is not None]
    thing = next((i for i in things if i >= row), things[-1])
    alone = next(i for i in range(thing, -1, -1) if windows.rows[i]["thing"] is None)
    return thing, alone
