"""write_splat: a splat file in a format that others read, checked before it is put in place."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from diga3d_warp.errors import InputError
from diga3d_warp.files import whole_file
from diga3d_warp.scene.formats import spz
from diga3d_warp.scene.formats.conversion import convert, require
from diga3d_warp.scene.formats.positions import needs_double
from diga3d_warp.scene.formats.read import read_splat
from diga3d_warp.scene.formats.rows import SplatRows
from diga3d_warp.scene.formats.sog_writer import encode_sog
from diga3d_warp.scene.formats.standard_ply import ANTIALIASED, ply_contents, write_ply
from diga3d_warp.scene.morton import morton_order

ENDINGS = {
    "ply": ".ply",
    "compressed-ply": ".compressed.ply",
    "spz": ".spz",
    "splat": ".splat",
    "sog": ".sog",
}
"""Formats that can be written, and how their files end."""


@dataclass(frozen=True)
class Range:
    """What a format can hold; what lies beyond is clipped.

    Attributes:
        log_scales: Smallest and largest logarithm of a standard deviation.
        rest: Largest absolute coefficient above degree 0; 0 if the format holds none.
        antialiased: Whether it can say that a splat is anti-aliased.
    """

    log_scales: tuple[float, float] = (-np.inf, np.inf)
    rest: float = np.inf
    antialiased: bool = True


RANGES = {
    "compressed-ply": Range(log_scales=(-20.0, 20.0), rest=4.0),
    "spz": Range(log_scales=(-10.0, 95 / 16), rest=1.0),
    "splat": Range(rest=0.0, antialiased=False),
    "sog": Range(),
}

UNFIT = 0.01
"""Share of gaussians that may lose their place or size before a format is refused. A few floaters far outside
are lost in any format that divides the whole box of a scene."""

_SPZ_BITS = 23  # of a position, beside its sign
_SPZ_FRACTION_MOST = 24


def write_splat(path: Path, rows: SplatRows, form: str, *, antialiased: bool = False) -> list[str]:
    """Write gaussians, through a temporary file that is read again, and renamed if it holds them.

    Args:
        path: The file.
        rows: What to write: finite, at least one.
        form: A name in `ENDINGS`.
        antialiased: Whether they were fitted with Mip-Splatting's 2D filter.

    Returns:
        What the format does not hold, one line each.

    Raises:
        InputError: a package is missing, the file cannot be written, or the format cannot hold the scene.
    """
    if form == "ply":
        double = needs_double(rows.means, rows.log_scales)
        write_ply(path, rows, positions="double" if double else "float", antialiased=antialiased)
        return [f"{path.name}: x, y and z are doubles, which some viewers cannot read"] if double else []
    norms = np.linalg.norm(rows.quaternions.astype(np.float64), axis=1, keepdims=True)
    unit = (rows.quaternions / norms).astype(np.float32)
    rows = replace(rows, quaternions=unit, sh=_without_zero_bands(rows.sh)).select(morton_order(rows.means))
    notes = _losses(path, rows, form, antialiased)
    encoded = _ENCODERS[form](path, rows, antialiased)
    with whole_file(path) as partial:
        partial.write_bytes(encoded)
        _check_places(path, rows, read_splat(partial, every_row=True).rows, form)
    return notes


def _losses(path: Path, rows: SplatRows, form: str, antialiased: bool) -> list[str]:
    """Notes on what a format clips or leaves out.

    Raises:
        InputError: it would clip the scales of more than `UNFIT`.
    """
    holds, notes = RANGES[form], []
    low, high = holds.log_scales
    clipped = ((rows.log_scales < low) | (rows.log_scales > high)).any(axis=1)
    if clipped.mean() > UNFIT:
        raise InputError(
            f"{path}: the format {form} holds scales from {np.exp(low):.2g} to {np.exp(high):.2g}, and "
            f"{clipped.mean():.0%} of the gaussians lie outside; use another format, or scale the scene"
        )
    if clipped.any():
        notes.append(f"{path.name}: the scales of {int(clipped.sum())} gaussians are clipped")
    rest = rows.sh[:, 1:]
    if holds.rest == 0 and rest.any():
        notes.append(f"{path.name}: the format holds no harmonics: colours no longer change with direction")
    elif (beyond := (np.abs(rest) > holds.rest).any(axis=(1, 2))).any():
        notes.append(f"{path.name}: harmonics of {int(beyond.sum())} gaussians are clipped")
    if antialiased and not holds.antialiased:
        notes.append(f"{path.name}: the format cannot say that the splat is anti-aliased")
    return notes


def _check_places(path: Path, rows: SplatRows, written: SplatRows, form: str) -> None:
    """Refuse a file whose gaussians have lost their places.

    Raises:
        InputError: more than `UNFIT` of them are not within their own width of where they were.
    """
    from scipy.spatial import cKDTree

    distances, _ = cKDTree(written.means).query(rows.means)
    lost = distances > np.exp(rows.log_scales.max(axis=1))
    if len(written) != len(rows) or lost.mean() > UNFIT:
        raise InputError(
            f"{path}: the format {form} is too coarse for this scene: {lost.mean():.0%} of the gaussians "
            "would move by more than their size; use another format"
        )


def _without_zero_bands(sh: np.ndarray) -> np.ndarray:
    """Harmonics up to the highest degree that is used, shape (N, K, 3)."""
    used = np.flatnonzero(sh.any(axis=(0, 2)))
    degree = int(np.sqrt(used[-1])) if len(used) else 0
    return sh[:, : (degree + 1) ** 2]


def _plain(rows: SplatRows) -> bytes:
    header, table = ply_contents(rows, rows.sh.shape[1] - 1)
    return header + table.tobytes()


def _gsply_data(path: Path, rows: SplatRows) -> Any:
    require("gsply", path)
    from gsply import GSData

    rest = rows.sh[:, 1:]
    return GSData.from_arrays(
        rows.means.astype(np.float32),
        np.ascontiguousarray(rows.log_scales),
        np.ascontiguousarray(rows.quaternions),
        np.ascontiguousarray(rows.opacity_logits),
        np.ascontiguousarray(rows.sh[:, 0]),
        np.ascontiguousarray(rest) if rest.shape[1] else None,
        format="ply",
    )


def _compressed_ply(path: Path, rows: SplatRows, antialiased: bool) -> bytes:
    data = _gsply_data(path, rows)
    from gsply import compress_to_bytes

    encoded = compress_to_bytes(data)
    if not antialiased:
        return encoded
    return encoded.replace(b"element chunk", f"comment {ANTIALIASED}\nelement chunk".encode("ascii"), 1)


def _spz(path: Path, rows: SplatRows, antialiased: bool) -> bytes:
    """Version 3, with as many fractional bits as the largest coordinate leaves."""
    data = _gsply_data(path, rows)
    from gsply import write_spz

    largest = max(float(np.abs(rows.means).max()), 2.0**-_SPZ_BITS)
    bits = min(max(_SPZ_BITS - math.ceil(math.log2(largest)), 1), _SPZ_FRACTION_MOST)
    with TemporaryDirectory() as folder:
        file = Path(folder) / "splat.spz"
        write_spz(file, data, fractional_bits=bits)
        encoded = file.read_bytes()
    return spz.with_antialiased(encoded) if antialiased else encoded


def _splat(path: Path, rows: SplatRows, antialiased: bool) -> bytes:
    return convert(_plain(rows), "ply", "splat", path, len(rows))


def _sog(path: Path, rows: SplatRows, antialiased: bool) -> bytes:
    return encode_sog(rows, antialiased)


_ENCODERS = {"compressed-ply": _compressed_ply, "spz": _spz, "splat": _splat, "sog": _sog}
