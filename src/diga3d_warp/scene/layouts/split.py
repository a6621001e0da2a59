"""Splits that transforms.json names: train_filenames, val_filenames and test_filenames of nerfstudio."""

from __future__ import annotations

import posixpath
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from diga3d_warp.errors import InputError
from diga3d_warp.scene.photographs.names import composed, listed

_LISTS = ("train_filenames", "val_filenames", "test_filenames")


@dataclass(frozen=True)
class Split:
    """Training and test split of a capture, by image names.

    Attributes:
        test: Frames that are held out; None if the capture has no split.
        left_out: Frames that are neither for training nor for testing.
        notes: What is left out or missing, one line each.
    """

    test: frozenset[str] | None = None
    left_out: frozenset[str] = frozenset()
    notes: Sequence[str] = field(default_factory=tuple)


def read_split(path: Path, contents: Mapping[str, Any], names: Sequence[str]) -> Split:
    """The split of a transforms.json: its test frames are held out, or those for validation if it has none.

    As in nerfstudio, frames that a list of training frames does not name are not trained on.

    Args:
        path: The file.
        contents: Its contents.
        names: Images of its frames, as it writes them.

    Raises:
        InputError: an entry is no list of names, or no frame is left for training.
    """
    given = {entry: contents[entry] for entry in _LISTS if contents.get(entry)}
    if not given:
        return Split()
    frames = {_plain(name): name for name in names}
    groups: dict[str, frozenset[str]] = {}
    notes = []
    for entry, listing in given.items():
        if not (isinstance(listing, list) and all(isinstance(name, str) for name in listing)):
            raise InputError(f"{path}: {entry} is not a list of file names; export it again")
        if unknown := [name for name in listing if _plain(name) not in frames]:
            notes.append(f"{path}: {entry} names {len(unknown)} images without a frame: {listed(unknown)}")
        groups[entry] = frozenset(frames[_plain(name)] for name in listing if _plain(name) in frames)
    kept_apart = groups.get("val_filenames", frozenset()) | groups.get("test_filenames", frozenset())
    train = groups.get("train_filenames", frozenset(names) - kept_apart)
    test = groups.get("test_filenames") or groups.get("val_filenames") or frozenset()
    if both := sorted(train & test):
        notes.append(
            f"{path}: {len(both)} images are for training and for testing; they are held out: {listed(both)}"
        )
        train -= test
    left_out = frozenset(names) - train - test
    if left_out:
        notes.append(
            f"{path}: {len(left_out)} frames are neither for training nor for testing and are left out: "
            f"{listed(sorted(left_out))}"
        )
    if not train:
        raise InputError(f"{path}: its lists leave no frame for training; correct train_filenames")
    return Split(test, left_out, notes)


def _plain(name: str) -> str:
    return composed(posixpath.normpath(name.replace("\\", "/")))
