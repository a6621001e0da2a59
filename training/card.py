"""The model card of an exported prior: what it was trained on, for how long, and what it is not."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from training.autoencoder import FROZEN
from training.checkpoint import load_checkpoint
from training.latents import open_latents
from training.recipe import VERSION, Recipe
from training.windows import open_windows

NETWORKS: Mapping[str, str] = {
    "autoencoder": "autoencoder (crops)",
    "decoder": "its decoder, further",
    "denoiser": "UNet and text encoder",
    "controlnet-edges": "ControlNet, edges",
    "controlnet-depth": "ControlNet, depth",
}
"""Trainings by the name of their curve."""

INTRODUCTION = """# Room prior

A small latent diffusion network that inpaints synthetic rooms and gardens, in the format of Stable
Diffusion's inpainting checkpoints: AutoencoderTiny with {channels} latent channels, a UNet that is given
noisy latents, mask and known latents, a CLIP text encoder of few words, and those ControlNets that are in the
table. It predicts v. Windows have {side} px, 16 x 16 latent cells. `diga3d ... --prior room` reads it.

It was trained from nothing by `python -m training`, version {version} of the recipe, on images that this
repository's generator renders.

**What it is not.** It has seen no photograph. It knows the generator's rooms, objects and {words} words
(`tokenizer/words.json`); a prompt with any other word is refused. Outside such rooms its fills mean nothing.
It shows that the method works on trained weights; to edit photographs, use Stable Diffusion weights.
"""


def model_card(work: Path, recipe: Recipe, words: int) -> str:
    """Markdown of the card.

    Args:
        work: Folder of data, checkpoints and curves.
        recipe: Of the training.
        words: How many the network knows.
    """
    windows = open_windows(work, recipe.data)
    first = recipe.data.first_seed
    rooms = len({row["seed"] for row in windows.rows})
    lines = [
        INTRODUCTION.format(
            channels=recipe.autoencoder.latent_channels,
            side=recipe.data.side,
            version=VERSION,
            words=words,
        ),
        "## Training",
        "",
        f"{len(windows.rows)} images of {rooms} rooms (seeds from {first}; held out are "
        f"{recipe.data.held_out_seed} to {recipe.data.held_out_seed + recipe.data.held_out_rooms - 1}), "
        f"encoded as {len(open_latents(work, recipe).rows)} samples with masks.",
        "",
        "| network | samples | hours | loss at first | loss at last |",
        "|---|---|---|---|---|",
    ]
    frozen = load_checkpoint(work / FROZEN)["step"]
    for name, said in NETWORKS.items():
        curve = read_curve(work / f"{name}.jsonl")
        if name == "autoencoder":  # it may have been trained further since
            curve = [line for line in curve if line["step"] <= frozen]
        if curve:
            last = curve[-1]
            lines.append(
                f"| {said} | {last['samples']} | {last['seconds'] / 3600:.1f} "
                f"| {curve[0]['loss']:.3f} | {last['loss']:.3f} |"
            )
    lines += ["", "Hours are those of the training process, on a processor that was shared with other work."]
    return "\n".join(lines) + "\n"


def read_curve(path: Path) -> list[dict[str, Any]]:
    """Lines of a training, without those that a later run repeated; none if it did not start."""
    if not path.exists():
        return []
    curve: list[dict[str, Any]] = []
    for text in path.read_text().splitlines():
        line = json.loads(text)
        curve = [before for before in curve if before["step"] < line["step"]] + [line]
    return curve
