"""Checkpoints of a fit: written whole, and read back only if they are whole and of the very same fit."""

from __future__ import annotations

import hashlib
import io
import pickle
import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import torch

from diga3d_warp.files import whole_file


class Unusable(Exception):
    """A checkpoint is damaged or of another fit; the message says which."""


def origin_of(description: object, tensors: Iterable[torch.Tensor]) -> str:
    """A digest of what a fit starts from.

    Args:
        description: Settings whose text tells them apart.
        tensors: Gaussians, and whatever else the result depends on.
    """
    digest = hashlib.blake2b(repr(description).encode(), digest_size=16)
    for tensor in tensors:
        array = tensor.detach().cpu().contiguous().numpy()
        digest.update(f"{array.dtype}{array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def write_checkpoint(path: Path, state: dict[str, Any], origin: str) -> None:
    """Write the state of a fit with the digest of its origin, whole or not at all."""
    # Through memory: on a full disk torch raises an error that does not say so.
    buffer = io.BytesIO()
    torch.save({**state, "origin": origin}, buffer)
    with whole_file(path) as partial:
        partial.write_bytes(buffer.getbuffer())


def read_checkpoint(path: Path, origin: str) -> dict[str, Any]:
    """The state of a fit.

    Raises:
        Unusable: the file cannot be read, is cut short or altered, or is of a fit with another origin.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            whole = archive.testzip() is None  # torch does not compare the checksums
        state = torch.load(path, weights_only=True) if whole else None
    except (OSError, ValueError, EOFError, KeyError, RuntimeError, NotImplementedError,
            zipfile.BadZipFile, pickle.UnpicklingError) as error:  # fmt: skip
        raise Unusable("damaged") from error
    if not isinstance(state, dict) or "origin" not in state:
        raise Unusable("damaged")
    if state["origin"] != origin:
        raise Unusable("of another fit")
    return state
