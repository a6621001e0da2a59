"""The image files that a calibration refers to: their folders, and the file of each name."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from diga3d_warp.scene.photographs.folders import image_folders, images_below, is_run, walk
from diga3d_warp.scene.photographs.names import (
    CODE_PAGES,
    composed,
    image_key,
    inside,
    is_derived,
    is_utf8,
    leads_outside,
    listed,
    name_bytes,
)

# Of several files that an image named without its ending may be: photographs are mostly JPEG, while a .png
# of the same name is more often its mask or its depth.
_ENDINGS_BY_LIKELIHOOD = (".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".bmp")
# Names that are looked for in each folder where `images` is not there.
_SAMPLE = 20
# Levels below the scene folder at which photographs are then looked for.
_DEPTH = 2


@dataclass(frozen=True)
class Found:
    """Files found for the names of a calibration.

    Attributes:
        files: File of each name that has one.
        notes: What was guessed, one line each.
    """

    files: Mapping[str, Path]
    notes: Sequence[str]


def find_images(names: Sequence[str], folder: Path, files: Sequence[Path]) -> Found:
    """Find the files of the images that a calibration names; each file is used for one name at most.

    An exact name takes precedence. Names without an exact match are matched in this order: other forms of
    accents and other code pages; upper and lower case; another ending, or none; the file name without its
    folders, if it is unique and not among masks. The latter two are noted.

    Args:
        names: Paths below `folder`, with forward slashes, with or without an ending. Bytes that are not
            UTF-8 as `surrogateescape` keeps them.
        folder: Folder of the files.
        files: Image files below it.
    """
    relative = {path.relative_to(folder).as_posix(): path for path in files}
    found = {name: relative[name] for name in names if name in relative}
    notes = []
    text, page = _readable([*names, *relative])
    if page:
        notes.append(f"{folder}: image names that are not UTF-8 are read as {page}")

    def plain(name: str) -> str:
        return composed(text.get(name, name))

    def match(spelled: Callable[[str], str]) -> dict[str, list[str]]:
        """Names left, and the files left that are spelled alike; none where two names are."""
        used = set(found.values())
        free = [name for name, path in relative.items() if path not in used]
        left = [name for name in names if name not in found]
        spellings = Counter(spelled(name) for name in dict.fromkeys(left))
        alike: dict[str, list[str]] = {}
        for name in sorted(free, key=likelihood):
            alike.setdefault(spelled(name), []).append(name)
        return {name: alike.get(spelled(name), []) for name in left if spellings[spelled(name)] == 1}

    for spelled in (plain, lambda name: plain(name).casefold()):
        found |= {name: relative[some[0]] for name, some in match(spelled).items() if len(some) == 1}
    # If images with an ending exist, none was converted: a file with another ending is a mask.
    kept = {suffix(name) for name in found} - {""}
    for spelled in (lambda name: image_key(plain(name)), lambda name: image_key(plain(name)).casefold()):
        alike = {name: some for name, some in match(spelled).items() if some and not _are_one(some, plain)}
        chosen = {name: some for name, some in alike.items() if suffix(name) not in kept}
        found |= {name: relative[some[0]] for name, some in chosen.items()}
        notes += _ending_notes(folder, chosen)

    def may_be(name: str, file: str) -> bool:
        return not is_derived(file) and (suffix(name) not in kept or suffix(file) == suffix(name))

    for spelled in (
        lambda name: PurePosixPath(plain(name)).name.casefold(),
        lambda name: PurePosixPath(image_key(plain(name))).name.casefold(),
        # 3DGS cuts names at their first dot.
        lambda name: PurePosixPath(plain(name)).name.casefold().split(".")[0],
    ):
        left = {name: [f for f in some if may_be(name, f)] for name, some in match(spelled).items()}
        only = {name: some[0] for name, some in left.items() if len(some) == 1}
        found |= {name: relative[file] for name, file in only.items()}
        if only:
            notes.append(
                f"{folder}: {len(only)} images are found by a part of their names only: {_pairs(only)}"
            )
    return Found(found, notes)


def suffix(name: str) -> str:
    """The ending of a name, in lower case."""
    return PurePosixPath(name).suffix.lower()


def _are_one(names: Sequence[str], plain: Callable[[str], str]) -> bool:
    """Whether the likeliest of several names differs from another in upper and lower case only."""
    return plain(names[0]).casefold() in {plain(name).casefold() for name in names[1:]}


def likelihood(name: str) -> tuple[int, str]:
    """Sorts files of one name by how likely they are to be the photograph."""
    order = _ENDINGS_BY_LIKELIHOOD
    return (order.index(suffix(name)) if suffix(name) in order else len(order), name)


def _pairs(pairs: Mapping[str, str]) -> str:
    return listed([f"{name} -> {file}" for name, file in list(pairs.items())[:1]]) + (
        f" and {len(pairs) - 1} more" if len(pairs) > 1 else ""
    )


def _ending_notes(folder: Path, chosen: Mapping[str, Sequence[str]]) -> list[str]:
    """Notes on images that were found under another ending, or under one of several."""
    notes = []
    other = {name: some[0] for name, some in chosen.items() if image_key(name) != composed(name)}
    several = {name: some for name, some in chosen.items() if name not in other and len(some) > 1}
    if other:
        notes.append(
            f"{folder}: {len(other)} images have another ending than the calibration says: {_pairs(other)}"
        )
    if several:
        some = next(iter(several.values()))
        notes.append(
            f"{folder}: {len(several)} images are named without an ending, and several files fit: of "
            f"{listed(some)} the first is read"
        )
    return notes


def _readable(names: Iterable[str]) -> tuple[dict[str, str], str | None]:
    """Names that are not UTF-8 in the code page in which most of them are names of the others, and which."""
    every = set(names)
    odd = {name for name in every if not is_utf8(name)}
    wanted = {image_key(name).casefold() for name in every - odd}
    best: tuple[int, dict[str, str], str | None] = (0, {}, None)
    for page in CODE_PAGES:
        try:
            decoded = {name: name_bytes(name).decode(page) for name in odd}
        except UnicodeDecodeError:
            continue
        hits = sum(image_key(text).casefold() in wanted for text in decoded.values())
        if hits > best[0]:
            best = (hits, decoded, page)
    return best[1], best[2]


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
    """Find the image folders of a calibration, and the paths of its images below them.

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
