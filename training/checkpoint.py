"""Checkpoints: all that a training needs to go on with the same losses, replaced as a whole."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from diga3d_warp.errors import InputError
from training.recipe import VERSION


def save_checkpoint(path: Path, state: Mapping[str, Any]) -> None:
    """Write a checkpoint; whoever is killed meanwhile leaves the one before."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    with part.open("wb") as file:
        torch.save({"version": VERSION, **state}, file)
        file.flush()
        os.fsync(file.fileno())
    part.replace(path)


def load_checkpoint(path: Path) -> dict[str, Any]:
    """Read a checkpoint.

    Raises:
        InputError: it is cut short, of another version of the recipe, or holds numbers that are not finite.
    """
    again = "delete it to train from the start, or bring back an older copy"
    try:
        state: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises several kinds for files that are cut short
        raise InputError(f"{path} cannot be read as a checkpoint: {again}") from error
    if not isinstance(state, dict) or state.get("version") != VERSION:
        found = state.get("version") if isinstance(state, dict) else None
        raise InputError(
            f"{path} was trained with version {found} of the recipe, this is version {VERSION}: {again}"
        )
    wrong = _not_finite(state)
    if wrong is not None:
        raise InputError(f"{path} holds numbers that are not finite ({wrong}): {again}")
    return state


def restore(module: torch.nn.Module, weights: Mapping[str, torch.Tensor], path: Path) -> None:
    """Give a network the weights of a checkpoint.

    Raises:
        InputError: they are those of a network of another size.
    """
    try:
        module.load_state_dict(weights)
    except RuntimeError as error:
        raise InputError(
            f"{path} holds a network of another size: delete it, or give another --work folder"
        ) from error


def _not_finite(part: Any, name: str = "") -> str | None:
    """Name of the first tensor that is not finite."""
    if isinstance(part, torch.Tensor):
        return None if bool(torch.isfinite(part).all()) else name
    if isinstance(part, Mapping):
        found = (_not_finite(value, f"{name}/{key}" if name else str(key)) for key, value in part.items())
        return next((wrong for wrong in found if wrong is not None), None)
    return None
