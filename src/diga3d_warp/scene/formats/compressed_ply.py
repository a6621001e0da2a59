"""The compressed .ply file of PlayCanvas and SuperSplat: 16 bytes a gaussian, in chunks of 256 with bounds.

Three elements: chunk (smallest and largest position, log scale and, in newer files, colour of 256 gaussians),
vertex (position, rotation, scale and colour, packed into 32 bits each), and sh (a byte for each coefficient
above degree 0), which files without view dependence lack.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from diga3d_warp.errors import InputError
from diga3d_warp.scene.formats.ply import Header, read_elements
from diga3d_warp.scene.formats.quantised import OTHERS, constant_harmonics, logits
from diga3d_warp.scene.formats.recognise import PACKED
from diga3d_warp.scene.formats.rows import SplatContent, SplatRows
from diga3d_warp.scene.formats.standard_ply import REST, REST_COUNTS, antialiased_by

CHUNK = 256
"""Gaussians that share bounds."""

SH_RANGE = 8.0
"""A coefficient's byte spans -4 to 4."""

_BITS = {"x y z": (11, 10, 11), "scale_x scale_y scale_z": (11, 10, 11), "r g b": (8, 8, 8)}
_ENDS = ("min", "max")
_NEEDED = {f"{end}_{each}{axis}" for each in ("", "scale_") for end in _ENDS for axis in "xyz"}
_COLORS = {f"{end}_{channel}" for end in _ENDS for channel in "rgb"}


def read_compressed_ply(path: Path, header: Header) -> SplatContent:
    """Read a compressed .ply.

    Raises:
        InputError: the file is cut short, or elements or properties are missing.
    """
    elements = read_elements(path, header, {"chunk", "vertex", "sh"})
    vertex = elements["vertex"]
    count = len(vertex)
    chunk = elements.get("chunk", np.empty(0, []))
    bounds = set(chunk.dtype.names or ())
    missing = sorted((_NEEDED | (_COLORS if bounds & _COLORS else set())) - bounds)
    if missing:
        raise InputError(f"{path}: a compressed .ply whose chunks lack {missing[0]}; export it again")
    if len(chunk) * CHUNK < count:
        raise InputError(
            f"{path}: {len(chunk)} chunks are too few for {count} gaussians of a compressed .ply; "
            "export it again"
        )
    if any(vertex[name].dtype.kind not in "ui" or vertex[name].dtype.itemsize != 4 for name in PACKED):
        raise InputError(f"{path}: the packed properties of a compressed .ply are no uint; export it again")
    position, rotation, scale, color = (vertex[name].astype(np.uint32) for name in PACKED)
    which = np.arange(count) // CHUNK

    def within(packed: np.ndarray, names: str, shifts: tuple[int, int, int]) -> np.ndarray:
        """Numbers between the bounds of their chunk, shape (N, 3)."""
        columns = []
        for name, bits, shift in zip(names.split(), _BITS[names], shifts, strict=True):
            share = ((packed >> shift) & ((1 << bits) - 1)) / ((1 << bits) - 1)
            if f"min_{name}" in bounds:
                low, high = (chunk[f"{end}_{name}"].astype(np.float64)[which] for end in _ENDS)
                share = low * (1 - share) + high * share
            columns.append(share)
        return np.stack(columns, axis=1)

    rows = SplatRows(
        means=within(position, "x y z", (21, 11, 0)),
        log_scales=within(scale, "scale_x scale_y scale_z", (21, 11, 0)).astype(np.float32),
        quaternions=_unpacked_rotations(rotation),
        opacity_logits=logits(color & 0xFF),
        sh=np.concatenate(
            [constant_harmonics(within(color, "r g b", (24, 16, 8)))[:, None], _rest(path, elements, count)],
            axis=1,
        ),
    )
    return SplatContent(rows, antialiased_by(header.comments))


def _unpacked_rotations(packed: np.ndarray) -> np.ndarray:
    """Quaternions (w, x, y, z) of which the three smallest components are stored, shape (N, 4), float32."""
    stored = np.stack([(packed >> shift) & 0x3FF for shift in (20, 10, 0)], axis=1) / 0x3FF
    smallest = (stored - 0.5) * np.sqrt(2)
    largest = np.sqrt(np.maximum(0.0, 1.0 - (smallest**2).sum(axis=1)))
    place = (packed >> 30).astype(np.intp)
    quaternions = np.empty((len(packed), 4), np.float32)
    np.put_along_axis(quaternions, OTHERS[place], smallest.astype(np.float32), axis=1)
    np.put_along_axis(quaternions, place[:, None], largest.astype(np.float32)[:, None], axis=1)
    return quaternions


def _rest(path: Path, elements: dict[str, np.ndarray], count: int) -> np.ndarray:
    """Coefficients above degree 0, shape (N, K - 1, 3), float32."""
    if "sh" not in elements:
        return np.zeros((count, 0, 3), np.float32)
    table = elements["sh"]
    names = [f"f_rest_{k}" for k in range(len(table.dtype.names or ()))]
    known = (
        len(names) in REST_COUNTS and len(names) <= 3 * REST and set(names) == set(table.dtype.names or ())
    )
    if not known or len(table) != count:
        raise InputError(
            f"{path}: the element sh of a compressed .ply has {len(table)} rows of {len(names)} "
            f"coefficients, which fit no degree of {count} gaussians; export it again"
        )
    per_channel = REST_COUNTS[len(names)]
    levels = (np.arange(256) + 0.5) / 256
    levels[[0, 255]] = 0.0, 1.0
    values = ((levels - 0.5) * SH_RANGE).astype(np.float32)
    rest = np.empty((count, per_channel, 3), np.float32)
    for k in range(per_channel):
        for channel in range(3):
            rest[:, k, channel] = values[table[f"f_rest_{per_channel * channel + k}"]]
    return rest
