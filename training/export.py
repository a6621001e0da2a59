"""The trained networks as a folder in diffusers' format, fp16, that `--prior room` reads."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import torch

from diga3d_warp.errors import InputError
from training.autoencoder import Encoder
from training.card import model_card
from training.checkpoint import load_checkpoint, restore
from training.controls import build_controlnet, trained_denoiser
from training.denoiser import SCHEDULE
from training.recipe import Recipe
from training.text import open_tokenizer, save_tokenizer

KINDS = ("edges", "depth")
"""Of ControlNets."""


def export(work: Path, recipe: Recipe, folder: Path) -> list[str]:
    """Write the averaged weights of the last checkpoints.

    Args:
        work: Folder of all work.
        recipe: Of the checkpoints.
        folder: Replaced as a whole.

    Returns:
        What is left out, one line each: ControlNets that are not trained yet.

    Raises:
        InputError: autoencoder or denoiser are not trained yet, or `folder` holds something else.
    """
    if folder.exists() and any(folder.iterdir()) and not (folder / "unet").is_dir():
        raise InputError(f"{folder} holds something else: give another folder")
    tokenizer, words = open_tokenizer(work, recipe)
    denoiser = trained_denoiser(work, recipe, tokenizer)
    part = folder.with_name(f".{folder.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    _save(denoiser.unet, part / "unet")
    _save(denoiser.text, part / "text_encoder")
    _save(Encoder.frozen(work, recipe).model, part / "vae")
    save_tokenizer(tokenizer, words, part / "tokenizer")
    _save_scheduler(part / "scheduler")
    missing = []
    for kind in KINDS:
        path = work / f"controlnet-{kind}.ckpt"
        if not path.exists():
            missing.append(f"there is no ControlNet for {kind} yet")
            continue
        net = build_controlnet(recipe)
        restore(net, load_checkpoint(path)["averaged"], path)
        _save(net, part / f"controlnet-{kind}")
    (part / "README.md").write_text(model_card(work, recipe, len(words)))
    shutil.rmtree(folder, ignore_errors=True)
    part.replace(folder)
    return missing


def _save(model: Any, folder: Path) -> None:
    model.to(memory_format=torch.contiguous_format).half().save_pretrained(folder, variant="fp16")


def _save_scheduler(folder: Path) -> None:
    from diffusers import DDIMScheduler

    betas = {"beta_start": 0.00085, "beta_end": 0.012, "beta_schedule": "scaled_linear"}
    scheduler: Any = DDIMScheduler(
        num_train_timesteps=len(SCHEDULE),
        **betas,
        clip_sample=False,
        set_alpha_to_one=False,
        steps_offset=SCHEDULE.offset,
        prediction_type="v_prediction",
    )
    scheduler.save_pretrained(folder)
