"""Photographs without poses: which of a folder's images they are.

Scanning apps and earlier work leave depth, masks, previews and edited copies beside photographs. Mapped
together they spoil the poses, and a copy that is held out for testing was seen in training.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from diga3d_warp.errors import InputError
from diga3d_warp.scene.photographs.copies import COPIES, are_copies, spread
from diga3d_warp.scene.photographs.decoding import decode, read_bytes
from diga3d_warp.scene.photographs.find_images import likelihood
from diga3d_warp.scene.photographs.folders import image_folders, images_below, unread_images, unread_line
from diga3d_warp.scene.photographs.names import image_key, is_derived, listed

# Folders of photographs made from others: of Polycam, of COLMAP and other undistorters, of editors.
_CHANGED = re.compile(
    "corrected|undistort|rectif|resized|scaled|small|low_?res|edited|retouch|enhanced|denois"
)
# Folders that hold the photographs, the first that is there: COLMAP and nerfstudio, 3DGS before undistortion.
_BASES = ("images", "input")


@dataclass(frozen=True)
class PhotoSet:
    """Photographs without poses.

    Attributes:
        folders: Image folders by the factor by which they are smaller, as `Capture.image_folders`.
        files: The photographs in the largest of them, in sorted order.
        notes: What was left out, one line each.
    """

    folders: Mapping[int, Path]
    files: Sequence[Path]
    notes: Sequence[str]


def find_photographs(root: Path) -> PhotoSet:
    """The photographs of a folder: in `images`, else `input`, else anywhere in it; none if it has none."""
    folders = next((found for base in _BASES if (found := image_folders(root, base))), {1: root})
    folder = folders[min(folders)]
    groups: dict[str, list[Path]] = {}
    for path in images_below(folder):
        groups.setdefault(path.parent.relative_to(folder).as_posix(), []).append(path)
    kept, dropped = _kept(groups)
    notes = []
    if dropped:
        parts = [f"{_called(group)} ({len(groups[group])}, {why})" for group, why in dropped]
        notes.append(f"{folder}: images that are not taken for photographs: {listed(parts)}")
    files, twice = _one_each([path for group in kept for path in groups[group]])
    if twice:
        notes.append(
            f"{folder}: {len(twice)} images have the name of a photograph and another ending, and are not "
            f"taken for photographs: {listed([path.name for path in twice])}"
        )
    photographed = {image_key(path.name) for path in files}
    if unread := [path for path in unread_images(folder) if image_key(path.name) not in photographed]:
        notes.append(f"{folder}: {unread_line(unread)}")
    if len(kept) == 1 and len(folders) == 1:
        folders = {1: folder / kept[0]}
    return PhotoSet(folders, files, notes)


def _one_each(files: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """The photographs, and the files that lie beside one under its name: its mask, its depth."""
    best: dict[Path, Path] = {}
    for path in sorted(files, key=lambda path: likelihood(path.name)):
        best.setdefault(path.with_name(image_key(path.name)), path)
    kept = set(best.values())
    return sorted(kept), sorted(path for path in files if path not in kept)


def _kept(groups: Mapping[str, Sequence[Path]]) -> tuple[list[str], list[tuple[str, str]]]:
    """The groups of images that are photographs; and the others, each with the reason."""
    dropped: list[tuple[str, str]] = []
    left = []
    for group in groups:
        if is_derived(group):
            dropped.append((group, "by its name"))
        else:
            left.append(group)
    below = [len(groups[group]) for group in left if group != "."]
    if "." in left and len(groups["."]) <= COPIES.strays < max(below, default=0):
        left.remove(".")
        dropped.append((".", "beside folders of photographs"))
    colored = [group for group in left if _has_colors(groups[group])]
    for group in left if colored else []:
        if group not in colored:
            dropped.append((group, "grey beside coloured ones"))
    kept: list[str] = []
    for group in sorted(colored or left, key=lambda group: _order(group, len(groups[group]))):
        changed = bool(_CHANGED.search(group.lower()))
        twin = next((other for other in kept if are_copies(groups[group], groups[other], changed)), None)
        if twin is None:
            kept.append(group)
        else:
            dropped.append((group, f"copies of those in {_called(twin)}"))
    return sorted(kept), dropped


def _order(group: str, count: int) -> tuple[int, bool, int, str]:
    """Larger groups first, then photographs before what was made from them."""
    return (-count, bool(_CHANGED.search(group.lower())), len(group), group)


def _called(group: str) -> str:
    return "the folder itself" if group == "." else group


def _has_colors(files: Sequence[Path]) -> bool:
    """Whether any of a few images of a group has three channels."""
    for path in spread(files):
        try:
            if decode(read_bytes(path), path).ndim == 3:
                return True
        except InputError:
            continue
    return False
