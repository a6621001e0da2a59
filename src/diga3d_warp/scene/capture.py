"""Capture: what a reader returns, before any photograph is opened."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from diga3d_warp.errors import InputError
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.scene import Points

IMAGE_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp"})


@dataclass(frozen=True, eq=False)
class Shot:
    """One calibrated photograph that has not been read yet.

    Attributes:
        key: Path of the image below its image folder, with forward slashes and without ending.
        camera: Camera at the size for which it was calibrated, which need not be the size of the file.
        mask: File of the mask that the calibration names for it; None if it names none.
    """

    key: str
    camera: Camera
    mask: Path | None = None


@dataclass(frozen=True, eq=False)
class Capture:
    """Calibration of a scene.

    Attributes:
        kind: Layout, as in `Scene.kind`.
        shots: Calibrated photographs.
        image_folders: Folders that hold the same photographs, keyed by the factor by which they are
            smaller: {1: images, 2: images_2}.
        points: Sparse points, or None where the capture has none.
        notes: What a user should know of the reading, one line each.
        held_out: Keys of the shots that the capture itself keeps for testing.
    """

    kind: str
    shots: Sequence[Shot]
    image_folders: Mapping[int, Path]
    points: Points | None
    notes: Sequence[str] = field(default_factory=tuple)
    held_out: frozenset[str] = frozenset()


def image_key(name: str) -> str:
    """Name of an image without its ending; other dots stay ("IMG.2.jpg" and "IMG.2" are both "IMG.2")."""
    path = PurePosixPath(name)
    return str(path.with_suffix("") if path.suffix.lower() in IMAGE_SUFFIXES else path)


def image_files(folder: Path) -> dict[str, Path]:
    """Image files below a folder by key, in sorted order; hidden files are left out."""
    files = sorted(p for p in folder.rglob("*") if p.suffix.lower() in IMAGE_SUFFIXES and p.is_file())
    return {image_key(p.relative_to(folder).as_posix()): p for p in files if not p.name.startswith(".")}


def image_folders(root: Path, base: str = "images") -> dict[int, Path]:
    """Folders `base` (factor 1) and `base`_N (factor N) below `root` that hold images, by N."""
    folders = {}
    for folder in root.glob(f"{base}*"):
        factor = folder.name.removeprefix(base) or "_1"
        if folder.is_dir() and factor[0] == "_" and factor[1:].isdecimal() and int(factor[1:]) > 0:
            folders[int(factor[1:])] = folder
    return {factor: folders[factor] for factor in sorted(folders) if image_files(folders[factor])}


def inside(root: Path, name: str, source: Path) -> str:
    """A path named by a file of the scene, relative to the scene, normalised, with forward slashes.

    Links are not followed, so an `images` folder may be a link to another disk.

    Args:
        root: Scene folder.
        name: Path as written in `source`.
        source: File that names it, for the error line.

    Raises:
        InputError: the path leaves the scene.
    """
    written = Path(name.replace("\\", "/"))
    relative = os.path.relpath(root.absolute() / written, root.absolute())
    if Path(relative).parts[:1] == ("..",):
        raise InputError(f"{source}: the path {name!r} leaves the scene folder; name files inside {root}")
    return Path(relative).as_posix()
