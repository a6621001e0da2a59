"""Cases of layouts and names: which file is read."""

from __future__ import annotations

from pathlib import Path

from expectations import Reads, Refuses, case
from field_room import FieldRoom


@case(Reads())
def colmap_binary(room: FieldRoom, folder: Path) -> Path:
    return room.colmap(folder)


@case(Reads())
def colmap_text(room: FieldRoom, folder: Path) -> Path:
    return room.colmap_text(folder)


@case(Reads())
def nerfstudio(room: FieldRoom, folder: Path) -> Path:
    return room.nerfstudio(folder)


@case(Reads(points=False))
def splat_with_cameras(room: FieldRoom, folder: Path) -> Path:
    return room.splat(folder)


@case(Refuses(("no such file",)))
def missing_folder(room: FieldRoom, folder: Path) -> Path:
    return folder / "absent"
