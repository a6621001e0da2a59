"""The record of a finished stage, with a digest of every product.

The record is written last, just before the folder gets its final name, so that both become final together.
Products that no longer match it are refused: later stages would take them for what the stage made.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TypedDict

from diga3d_warp.errors import InputError, cannot_read
from diga3d_warp.files import put_in_place, sync, write_json
from diga3d_warp.state import compute_again, read_state

RECORD = "stage.json"

BLOCK = 1 << 20
"""Bytes of a product that are read at once."""


class Timing(TypedDict):
    """Time and memory of a stage.

    Attributes:
        seconds: Time spent by the process that finished it [s].
        peak_mib: Largest resident memory of that process meanwhile [MiB].
        resumed: Whether it continued from the files of an interrupted process.
    """

    seconds: float
    peak_mib: int
    resumed: bool


class Finished(Timing):
    """The record of a finished stage.

    Attributes:
        files: Digest of each product, by its path in the stage's folder.
    """

    files: dict[str, str]


def finish(partial: Path, done: Path, timing: Timing) -> None:
    """Write the record of a stage and give its folder the final name."""
    products = sorted(path for path in partial.rglob("*") if path.is_file() and path != partial / RECORD)
    files = {path.relative_to(partial).as_posix(): _digest(path) for path in products}
    write_json(partial / RECORD, {**timing, "files": files})
    sync(partial)
    put_in_place(partial, done)
    sync(done.parent)


def take_up(done: Path) -> Timing:
    """Check the products of a stage that an earlier process finished, and return its timing.

    Raises:
        InputError: the record or a product is missing or damaged.
    """
    record = read_state(done / RECORD, Finished)
    for name, digest in record["files"].items():
        path = done / name
        try:
            same = _digest(path) == digest
        except OSError as error:
            raise cannot_read(path, error, compute_again(path)) from error
        if not same:
            raise InputError(f"{path} is damaged (not what the stage wrote): {compute_again(path)}")
    return Timing(seconds=record["seconds"], peak_mib=record["peak_mib"], resumed=record["resumed"])


def _digest(path: Path) -> str:
    digest = hashlib.blake2b(digest_size=16)
    with path.open("rb") as stream:
        while block := stream.read(BLOCK):
            digest.update(block)
    return digest.hexdigest()
