"""read_splat: a splat file of any format."""

from __future__ import annotations

from pathlib import Path

import psutil

from diga3d_warp.errors import InputError
from diga3d_warp.scene.formats.recognise import splat_format
from diga3d_warp.scene.formats.rows import SplatContent
from diga3d_warp.scene.formats.standard_ply import read_standard_ply
from diga3d_warp.scene.formats.usable import usable_rows
from diga3d_warp.scene.ply import Header, read_header
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
            that is usable.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file; give the path of a splat, such as a 3DGS .ply")
    if splat_format(path) is None:
        raise InputError(f"{path}: holds no gaussians; give a splat, such as a 3DGS .ply")
    header = read_header(path)
    check_count(path, count_rows(path, header))
    content = read_standard_ply(path, header)
    if every_row:
        return content
    rows, notes = usable_rows(content.rows, path.name)
    if not len(rows):
        raise InputError(
            f"{path}: none of its {len(content.rows)} gaussians is usable; export the splat again"
        )
    return SplatContent(rows, content.antialiased, [*content.notes, *notes])


def read_splat_points(path: Path) -> tuple[Points, list[str]]:
    """Centres and base colours of a splat's gaussians, and the notes of `read_splat`.

    Raises:
        InputError: as `read_splat`.
    """
    content = read_splat(path)
    return Points(content.rows.means, content.rows.colors), content.notes


def count_rows(path: Path, header: Header) -> int:
    """Vertices that a .ply can hold: as many as it announces, but no more than its size allows."""
    vertex = header.element("vertex")
    if vertex is None:
        return 0
    return min(vertex.count, path.stat().st_size // max(1, vertex.row_size(header.form)))


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
