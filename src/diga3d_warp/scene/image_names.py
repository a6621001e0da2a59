"""Image names: from the paths that a calibration writes to paths below the folders of the photographs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from diga3d_warp.scene.find_images import find_images
from diga3d_warp.scene.folders import image_folders, images_below, is_run, walk
from diga3d_warp.scene.names import inside, is_derived, leads_outside, listed

# Names that are looked for in each folder where `images` is not there.
_SAMPLE = 20
# Levels below the scene folder at which photographs are then looked for.
_DEPTH = 2


@dataclass(frozen=True)
class NamedImages:
    """Images of a calibration.

    Attributes:
        names: Path below the image folders, by the name as it is written.
        folders: Image folders by the factor by which they are smaller; empty if there are none.
        notes: What was guessed, one line each.
    """

    names: Mapping[str, str]
    folders: Mapping[int, Path]
    notes: Sequence[str] = field(default_factory=tuple)


def name_images(root: Path, written: Sequence[str], source: Path, *, from_root: bool = False) -> NamedImages:
    """Where the images of a calibration lie.

    Args:
        root: Scene folder.
        written: Paths as written in `source`.
        source: File that names them.
        from_root: Whether paths are relative to the scene folder, as in transforms.json, and not to `images`.

    Raises:
        InputError: a path leaves the scene.
    """
    folders = image_folders(root)
    paths = {name: PurePosixPath(inside(root, name, source, list(folders.values()))) for name in written}
    notes = []
    if outside := [name for name in written if leads_outside(name)]:
        notes.append(
            f"{source}: {len(outside)} paths lead out of the scene and are taken by their ends: "
            f"{listed([f'{name} -> {paths[name]}' for name in outside[:1]])}"
        )
    base = _base(list(paths.values()))
    if base is not None and (from_root or _is_image_folder(base, folders)):
        folders = image_folders(root / base.parent, base.name)
        paths = {name: path.relative_to(base) for name, path in paths.items()}
    elif from_root:
        folders = {1: root}
    names = {name: path.as_posix() for name, path in paths.items()}
    if not folders and not is_run(root) and (found := _search(root, list(names.values()))) is not None:
        folders = {1: found}
        if found != root:
            notes.append(f"{root}: the photographs are read from {found.relative_to(root).as_posix()}")
    return NamedImages(names, folders, notes)


def _base(paths: Sequence[PurePosixPath]) -> PurePosixPath | None:
    """The folder that all paths begin with: the innermost called `images`, else the outermost."""
    parents = [path.parent.parts for path in paths]
    common = []
    for parts in zip(*parents, strict=False):
        if len(set(parts)) > 1:
            break
        common.append(parts[0])
    if not common:
        return None
    named = [index for index, part in enumerate(common) if part.lower().split("_")[0] == "images"]
    return PurePosixPath(*common[: named[-1] + 1 if named else 1])


def _is_image_folder(base: PurePosixPath, folders: Mapping[int, Path]) -> bool:
    """Whether paths relative to the scene folder were written where they are relative to `images`."""
    return any(
        base.name.casefold() == folder.name.casefold() and not (folder / base).is_dir()
        for folder in folders.values()
    )


def _search(root: Path, names: Sequence[str]) -> Path | None:
    """The folder that holds most of the images, if any holds some; of several, the outermost."""
    some = names[:: max(len(names) // _SAMPLE, 1)]
    best: tuple[int, Path | None] = (0, None)
    for folder, _ in walk(root, _DEPTH):
        if is_derived(folder.relative_to(root).as_posix()):
            continue
        found = find_images(some, folder, images_below(folder)).files
        depths = {name: len(path.relative_to(folder).parts) for name, path in found.items()}
        count = sum(depth == len(PurePosixPath(name).parts) for name, depth in depths.items())
        if count > best[0]:
            best = (count, folder)
    return best[1]
