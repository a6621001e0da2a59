"""Scenes of a data folder: its subfolders, or the folder itself if it is a capture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from diga3d_warp.errors import InputError
from diga3d_warp.scene.layouts.recognise import ARCHIVES
from diga3d_warp.scene.layouts.splat import has_poses
from diga3d_warp.scene.photographs.folders import entries, image_folders, scene_folders


def find_scenes(data: Path, names: Sequence[str] = ()) -> list[Path]:
    """Folders of scenes, sorted as people count: 1, 2, 10, book.

    Nothing is read: a scene that is broken shows so when its job runs.

    Args:
        data: Folder of a data set, or of one scene.
        names: Names of the scenes to take; all if empty.

    Raises:
        InputError: there is no such folder, it holds no folders, or a name is not among them.
    """
    if not data.is_dir():
        raise InputError(f"{data} is not a folder: give the one that holds the scenes")
    data = data.resolve()
    found = [data]
    if not has_poses(data) and not image_folders(data):
        found = sorted(scene_folders(data), key=lambda path: _counted(path.name))
    if not found:
        raise InputError(f"{data} holds no folders of scenes: give the one that holds them")
    if not names:
        return found
    by_name = {path.name: path for path in found}
    unknown = [name for name in names if name not in by_name]
    if unknown:
        raise InputError(f"{data} has no scene {unknown[0]!r}: it has {', '.join(by_name)}")
    return [by_name[name] for name in dict.fromkeys(names)]


def packed_scenes(data: Path) -> list[str]:
    """Names of archives in a data folder, which hold scenes perhaps, and are not read."""
    return [path.name for path in entries(data) if path.suffix.lower() in ARCHIVES and path.is_file()]


def check_apart(out: Path, data: Path) -> None:
    """Refuse an output folder in the data: it would be taken for a scene.

    Raises:
        InputError: it is there.
    """
    place, root = out.resolve(), data.resolve()
    if place == root or root in place.parents:
        raise InputError(f"{out} lies in the data folder, {data}: choose another --out")


def _counted(name: str) -> tuple[int, int, str]:
    """Order of names: numbers by size, then words."""
    return (0, int(name), name) if name.isdecimal() else (1, 0, name)
