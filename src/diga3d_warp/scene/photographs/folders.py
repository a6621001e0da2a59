"""Folders of a capture: which files in them are images, and which of them hold the photographs."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from diga3d_warp.scene.photographs.names import IMAGE_SUFFIXES, UNREAD_IMAGES, composed, image_key, listed

# Folders that systems and archives leave beside files; hidden ones are skipped as well.
_LEFT_BY_SYSTEMS = frozenset({"__MACOSX", "@eaDir", "$RECYCLE.BIN", "System Volume Information"})


def is_run(folder: Path) -> bool:
    """Whether a folder holds a run of this program, 3DGS or nerfstudio: its pictures are renderings."""
    ours = (folder / "stages").is_dir() or (folder / "metrics.json").is_file()
    if (folder / "manifest.json").is_file() and ours:
        return True
    return (folder / "cfg_args").is_file() or (folder / "nerfstudio_models").is_dir()


def entries(folder: Path) -> list[Path]:
    """Entries of a folder, sorted; empty if it is no folder or cannot be listed."""
    try:
        return sorted(folder.iterdir())
    except OSError:
        return []


def entry(folder: Path, name: str) -> Path | None:
    """The file or folder of a name, or else the one whose name differs in upper and lower case only."""
    if (folder / name).exists():
        return folder / name
    wanted = composed(name).casefold()
    return next((path for path in entries(folder) if composed(path.name).casefold() == wanted), None)


def walk(folder: Path, depth: int | None = None) -> Iterator[tuple[Path, list[Path]]]:
    """Folders at and below `folder` with their files, in sorted order.

    Links to folders are followed, each folder once. Hidden files and folders and those of runs are left out.

    Args:
        folder: Where to begin; it may itself be hidden or a run.
        depth: Levels to go down; None for all.
    """
    seen = set()
    for name, folders, files in os.walk(folder, followlinks=True):
        here = Path(name)
        real = os.path.realpath(name)
        level = len(here.relative_to(folder).parts)
        if real in seen or (depth is not None and level > depth):
            folders.clear()
            continue
        seen.add(real)
        folders[:] = sorted(
            f for f in folders if not f.startswith(".") and f not in _LEFT_BY_SYSTEMS and not is_run(here / f)
        )
        yield here, [here / file for file in sorted(files) if not file.startswith(".")]


def scene_folders(folder: Path) -> list[Path]:
    """Folders in a folder but for hidden ones, those of systems and of runs, in sorted order.

    A link that leads nowhere counts: whoever opens it says what is wrong.
    """
    return [
        path
        for path in entries(folder)
        if (path.is_dir() or (path.is_symlink() and not path.exists()))
        and not path.name.startswith(".")
        and path.name not in _LEFT_BY_SYSTEMS
        and not is_run(path)
    ]


def images_below(folder: Path) -> list[Path]:
    """Image files below a folder, in sorted order of their paths."""
    return sorted(
        path
        for _, files in walk(folder)
        for path in files
        if path.suffix.lower() in IMAGE_SUFFIXES and path.is_file()
    )


def image_siblings(path: Path) -> list[Path]:
    """Image files in the folder of a path, in sorted order."""
    return [each for each in entries(path.parent) if each.suffix.lower() in IMAGE_SUFFIXES and each.is_file()]


def image_files(folder: Path) -> dict[str, Path]:
    """Image files below a folder by key, in sorted order; of two with one key, the last."""
    return {image_key(p.relative_to(folder).as_posix()): p for p in images_below(folder)}


def image_folders(root: Path, base: str = "images") -> dict[int, Path]:
    """Folders `base` (factor 1) and `base`_N (factor N) below `root` that hold images, by N.

    Upper and lower case make no difference; the name as it is written comes first.
    """
    folders: dict[int, Path] = {}
    for folder in entries(root):
        head, tail = folder.name[: len(base)], folder.name[len(base) :] or "_1"
        if head.casefold() != base.casefold() or not (tail[0] == "_" and tail[1:].isdecimal()):
            continue
        factor = int(tail[1:])
        if factor > 0 and folder.is_dir() and (factor not in folders or head == base):
            folders[factor] = folder
    return {factor: folders[factor] for factor in sorted(folders) if has_images(folders[factor])}


def has_images(folder: Path) -> bool:
    """Whether any image file lies below a folder."""
    return any(path.suffix.lower() in IMAGE_SUFFIXES for _, files in walk(folder) for path in files)


def unread_images(folder: Path) -> list[Path]:
    """Images below a folder that are of a kind that is not read."""
    return [path for _, files in walk(folder) for path in files if path.suffix.lower() in UNREAD_IMAGES]


def unread_line(images: Sequence[Path]) -> str:
    """A note on images in formats that are not read, with the remedy."""
    kinds = sorted({UNREAD_IMAGES[path.suffix.lower()] for path in images})
    return (
        f"{len(images)} are {' and '.join(kinds)} images, which are not read "
        f"({listed([path.name for path in images[:1]])}): convert them to .jpg or .png"
    )
