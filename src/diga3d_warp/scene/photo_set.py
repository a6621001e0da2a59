"""Photographs without poses: which of a folder's images they are.

Scanning apps and earlier work leave depth, masks, previews and edited copies beside photographs. Mapped
together they spoil the poses, and a copy that is held out for testing was seen in training.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from diga3d_warp.errors import InputError
from diga3d_warp.scene.decoding import decode, read_bytes, read_header
from diga3d_warp.scene.find_images import likelihood
from diga3d_warp.scene.folders import image_folders, images_below, unread_images, unread_line
from diga3d_warp.scene.names import image_key, is_derived, listed

# Folders of photographs made from others: of Polycam, of COLMAP and other undistorters, of editors.
_CHANGED = re.compile(
    "corrected|undistort|rectif|resized|scaled|small|low_?res|edited|retouch|enhanced|denois"
)
# Folders that hold the photographs, the first that is there: COLMAP and nerfstudio, 3DGS before undistortion.
_BASES = ("images", "input")


@dataclass(frozen=True)
class CopyCheck:
    """When two folders hold the same photographs.

    Attributes:
        names: Share of the smaller folder's images that have a namesake in the other.
        samples: Namesakes that are compared.
        side: Side of the grey thumbnails that are compared [px]: fine enough to tell neighbours apart.
        likeness: Least correlation of all thumbnails. Smaller, recompressed copies of photographs reach 0.99;
            neighbouring views of three captures reach 0.95 at most.
        strays: Up to this many images lie beside folders of photographs as a preview or cover.
    """

    names: float = 0.8
    samples: int = 3
    side: int = 32
    likeness: float = 0.96
    strays: int = 2


COPIES = CopyCheck()


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
    """The groups of images that are photographs; the others, each with what it is."""
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
        twin = next((other for other in kept if _are_copies(groups[group], groups[other], changed)), None)
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
    for path in _spread(files):
        try:
            if decode(read_bytes(path), path).ndim == 3:
                return True
        except InputError:
            continue
    return False


def _are_copies(files: Sequence[Path], others: Sequence[Path], changed: bool) -> bool:
    """Whether a group shows what the other does: it has the same names, and says so or looks the same."""
    ours, theirs = ({image_key(path.name): path for path in group} for group in (files, others))
    common = sorted(ours.keys() & theirs.keys())
    if not common or len(common) < COPIES.names * min(len(ours), len(theirs)):
        return False
    return changed or all(likeness(ours[key], theirs[key]) >= COPIES.likeness for key in _spread(common))


def likeness(first: Path, second: Path) -> float:
    """Correlation of two images as grey thumbnails, in [-1, 1]; 0 where one cannot be read or is flat."""
    small = [_thumbnail(path) for path in (first, second)]
    if small[0] is None or small[1] is None:
        return 0.0
    a, b = ((image - image.mean()).ravel() for image in small if image is not None)
    return float(a @ b / max(np.linalg.norm(a) * np.linalg.norm(b), 1e-12))


def _thumbnail(path: Path) -> np.ndarray | None:
    import cv2

    flags = {8: cv2.IMREAD_REDUCED_GRAYSCALE_8, 4: cv2.IMREAD_REDUCED_GRAYSCALE_4,
             2: cv2.IMREAD_REDUCED_GRAYSCALE_2, 1: cv2.IMREAD_GRAYSCALE}  # fmt: skip
    try:
        header = read_header(path)
    except InputError:
        return None
    reduced = min(header.width, header.height) // (2 * COPIES.side)
    flag = flags[max((factor for factor in flags if factor <= reduced), default=1)]
    pixels = cv2.imdecode(np.fromfile(path, np.uint8), flag | cv2.IMREAD_IGNORE_ORIENTATION)
    if pixels is None:
        return None
    return cv2.resize(pixels, (COPIES.side, COPIES.side), interpolation=cv2.INTER_AREA).astype(np.float32)


def _spread(items: Sequence) -> list:
    """A few of many, evenly."""
    count = min(len(items), COPIES.samples)
    return [items[i] for i in np.linspace(0, len(items) - 1, count).round().astype(int)] if count else []
