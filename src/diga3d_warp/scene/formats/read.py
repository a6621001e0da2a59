"""read_splat: a splat file of any format."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import psutil

from diga3d_warp.errors import InputError
from diga3d_warp.scene.formats.compressed_ply import read_compressed_ply
from diga3d_warp.scene.formats.conversion import convert
from diga3d_warp.scene.formats.ksplat import count_ksplat, read_ksplat
from diga3d_warp.scene.formats.ply import Header, read_header
from diga3d_warp.scene.formats.quantised import logits
from diga3d_warp.scene.formats.recognise import splat_format
from diga3d_warp.scene.formats.rows import SplatContent
from diga3d_warp.scene.formats.sog import read_sog_header
from diga3d_warp.scene.formats.splat import count_splat, read_splat_rows
from diga3d_warp.scene.formats.spz import read_spz_header
from diga3d_warp.scene.formats.standard_ply import read_standard_ply
from diga3d_warp.scene.formats.usable import usable_rows
from diga3d_warp.scene.scene import Points

BYTES_PER_GAUSSIAN = 1000
"""Memory while a file is read [bytes]: the file, its rows and tensors of them, each some 250."""


def read_splat(path: Path, *, every_row: bool = False) -> SplatContent:
    """Read a splat file.

    Rows that cannot be drawn are mended or left out, with a note; see `usable.usable_rows`.

    Args:
        path: The file.
        every_row: Give all rows as they were written, so that arrays by row still fit.

    Raises:
        InputError: the file is missing, damaged, larger than memory permits, no splat, or holds no gaussian
            that is usable; or its format needs a package that is not installed.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file; give the path of a splat, such as a 3DGS .ply")
    form = splat_format(path)
    if form is None:
        raise InputError(f"{path}: holds no gaussians; give a splat, such as a 3DGS .ply")
    count, read = _READERS[form]
    check_count(path, count(path))
    with np.errstate(all="ignore"):  # what is not finite is looked for below
        content = read(path)
        if every_row:
            return content
        rows, notes = usable_rows(content.rows, path.name)
    if not len(rows):
        raise InputError(
            f"{path}: none of its {len(content.rows)} gaussians is usable; export the splat again"
        )
    surround = min(content.surround, len(rows) - 1)
    return SplatContent(rows, content.antialiased, [*content.notes, *notes], surround)


def read_splat_points(path: Path) -> tuple[Points, list[str]]:
    """Centres and base colours of a splat's gaussians, and the notes of `read_splat`.

    Raises:
        InputError: as `read_splat`.
    """
    content = read_splat(path)
    return Points(content.scene.means, content.scene.colors), content.notes


def check_count(path: Path, count: int) -> None:
    """Refuse a file that announces no gaussians, or more than fit into memory.

    Raises:
        InputError: it does.
    """
    if count == 0:
        raise InputError(f"{path}: holds no gaussians, it has 0 rows; export the splat again")
    needed, free = count * BYTES_PER_GAUSSIAN, psutil.virtual_memory().available
    if needed > free:
        raise InputError(
            f"{path}: {count} gaussians need {needed / 2**30:.1f} GiB of memory, and only "
            f"{free / 2**30:.1f} GiB are free; give a splat with fewer"
        )


class _Reader(NamedTuple):
    """How a format is read: what a file announces, and its content."""

    count: Callable[[Path], int]
    read: Callable[[Path], SplatContent]


def _count_ply(path: Path) -> int:
    """Vertices that a .ply can hold: as many as it announces, but no more than its size allows."""
    header = read_header(path)
    vertex = header.element("vertex")
    if vertex is None:
        return 0
    return min(vertex.count, path.stat().st_size // max(1, vertex.row_size(header.form)))


def _ply(read: Callable[[Path, Header], SplatContent]) -> _Reader:
    return _Reader(_count_ply, lambda path: read(path, read_header(path)))


def _converted(path: Path, source: str, count: int, antialiased: bool) -> SplatContent:
    """A file that GaussForge turns into a standard .ply."""
    data = convert(path.read_bytes(), source, "ply", path, count)
    with tempfile.TemporaryDirectory() as folder:
        converted = Path(folder) / f"{path.stem}.ply"
        converted.write_bytes(data)
        try:
            rows = read_standard_ply(converted, read_header(converted)).rows
        except InputError as error:
            raise InputError(f"{path}: cut short or damaged; export it again") from error
    if len(rows) != count:
        raise InputError(
            f"{path}: cut short or damaged: {len(rows)} of its {count} gaussians can be read; export it again"
        )
    # Opacities of 0 and 255 come as infinite logits.
    ends = logits(np.array([0, 255]))
    return SplatContent(replace(rows, opacity_logits=rows.opacity_logits.clip(*ends)), antialiased)


def _spz(path: Path) -> SplatContent:
    header = read_spz_header(path)
    return _converted(path, "spz", header.count, header.antialiased)


def _sog(path: Path) -> SplatContent:
    header = read_sog_header(path)
    return _converted(path, "sog", header.count, header.antialiased)


_READERS = {
    "ply": _ply(read_standard_ply),
    "compressed-ply": _ply(read_compressed_ply),
    "splat": _Reader(count_splat, read_splat_rows),
    "ksplat": _Reader(count_ksplat, read_ksplat),
    "spz": _Reader(lambda path: read_spz_header(path).count, _spz),
    "sog": _Reader(lambda path: read_sog_header(path).count, _sog),
}
