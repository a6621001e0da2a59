"""The .splat file of antimatter15's viewer: 32 bytes a gaussian, no header, no view dependence.

Position and scale as 3 float32 each, RGBA and quaternion (w x y z) as 4 bytes each.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from diga3d_warp.errors import InputError
from diga3d_warp.scene.formats.quantised import constant_harmonics, log_scales, logits
from diga3d_warp.scene.formats.rows import SplatContent, SplatRows

_ROW = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("color", "u1", 4), ("rotation", "u1", 4)])


def count_splat(path: Path) -> int:
    """Gaussians in a .splat file.

    Raises:
        InputError: its size is not that of whole rows.
    """
    size = path.stat().st_size
    if size % _ROW.itemsize:
        raise InputError(
            f"{path}: cut short or damaged: its {size} bytes are no whole rows of {_ROW.itemsize}; "
            "export it again"
        )
    return size // _ROW.itemsize


def read_splat_rows(path: Path) -> SplatContent:
    """Read a .splat file.

    Raises:
        InputError: its size is not that of whole rows, its end is empty, or it holds other things than
            gaussians.
    """
    table = np.fromfile(path, _ROW, count_splat(path))
    written = np.asarray(table.view(np.uint8).reshape(len(table), _ROW.itemsize).any(axis=1))
    if len(table) and not written[-1]:
        # No program writes a rotation of zeros: space was reserved for a download that did not end.
        empty = len(table) - 1 - int(np.flatnonzero(written).max(initial=-1))
        raise InputError(
            f"{path}: cut short: its last {empty} of {len(table)} gaussians are zeros; download it again"
        )
    if (table["scale"] < 0).any():
        raise InputError(f"{path}: no .splat file, it has negative scales; export it again")
    rows = SplatRows(
        means=table["mean"].astype(np.float64),
        log_scales=log_scales(table["scale"]),
        quaternions=(table["rotation"].astype(np.float32) - 128) / 128,
        opacity_logits=logits(table["color"][:, 3]),
        sh=constant_harmonics(table["color"][:, None, :3] / 255),
    )
    return SplatContent(rows)
