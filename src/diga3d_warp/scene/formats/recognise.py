"""Is this file a splat, and in which format? The one place that decides."""

from __future__ import annotations

from pathlib import Path

from diga3d_warp.errors import InputError, cannot_read
from diga3d_warp.scene.formats.ply import Element, read_header

FORMATS = ("ply", "compressed-ply", "sog", "spz", "ksplat", "splat")
"""Names of the formats, from the most exact to the least."""

SPLAT_ENDINGS = frozenset({".ply", ".sog", ".spz", ".ksplat", ".splat"})
"""Endings of splat files, lower case. A .ply may be a point cloud or a mesh, too."""

_GAUSSIAN_PROPERTIES = frozenset({"x", "y", "z", "f_dc_0", "opacity", "scale_0", "rot_0"})
PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
"""Properties of the vertices of a compressed .ply."""


_STARTS = ((b"ply", ".ply"), (b"\x1f\x8b\x08", ".spz"), (b"NGSP", ".spz"), (b"PK\x03\x04", ".sog"))
"""First bytes of the formats that have a signature, and their endings: text, gzip, .spz 4, ZIP."""


def splat_format(path: Path) -> str | None:
    """Name of the format that a file is a splat in, one of `FORMATS`; None if it is no splat.

    The ending decides, in upper or lower case, and for a .ply its header: gaussians in the 3DGS form ("ply")
    or in PlayCanvas' compressed form ("compressed-ply"), not points or a mesh.

    Raises:
        InputError: the file ends with .ply and is none, or begins as one of another ending does.
    """
    ending = path.suffix.lower()
    if ending not in SPLAT_ENDINGS or not path.is_file():
        return None
    _check_start(path, ending)
    if ending != ".ply":
        return ending.removeprefix(".")
    vertex = read_header(path).element("vertex") or Element("vertex", 0, ())
    if vertex.names.issuperset(PACKED):
        return "compressed-ply"
    return "ply" if vertex.names >= _GAUSSIAN_PROPERTIES else None


def _check_start(path: Path, ending: str) -> None:
    """Refuse a file under the ending of another format: a .splat has no header and takes any bytes.

    Raises:
        InputError: it does, or cannot be read.
    """
    try:
        with path.open("rb") as file:
            start = file.read(4)
    except OSError as error:
        raise cannot_read(path, error) from error
    meant = next((other for begin, other in _STARTS if start.startswith(begin)), ending)
    if meant != ending:
        raise InputError(f"{path}: begins as a {meant} file does; give it that ending")


def find_splats(folder: Path) -> list[Path]:
    """The splat files in a folder, not below it, sorted by name; hidden ones are left out.

    Raises:
        InputError: as `splat_format`.
    """
    files = sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    return [path for path in files if splat_format(path) is not None]
