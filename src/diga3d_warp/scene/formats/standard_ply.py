"""The .ply file of 3DGS: what SuperSplat, the original viewer and most engines open.

One vertex a gaussian: x y z, nx ny nz (zeros), f_dc_0..2, f_rest_0..44, opacity (logit), scale_0..2 (log),
rot_0..3 (w x y z), all float32, little-endian. f_rest runs over coefficients first and channels second:
15 values of red, then green, then blue.

A comment says that a splat was fitted with Mip-Splatting's 2D filter: `SplatRenderMode: mip`, which Brush
writes and splat-transform follows; Postshot's `antialiased 1` is read, too.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Literal

import numpy as np

from diga3d_warp.errors import InputError
from diga3d_warp.files import whole_file
from diga3d_warp.scene.formats.ply import Header, read_elements
from diga3d_warp.scene.formats.rows import SplatContent, SplatRows

REST = 15
"""Coefficients above degree 0 in a file. The original viewer wants all 15 of degree 3; lower degrees are
filled up with zeros."""

REST_COUNTS = {0: 0, 9: 3, 24: 8, 45: 15, 72: 24}
"""Number of properties f_rest_*, and of coefficients per channel, for degrees 0 to 4."""

ANTIALIASED = "SplatRenderMode: mip"

SURROUND = "SurroundRows:"
"""How many rows at the end are the shell behind everything, `gaussians.surround`; our own comment."""


def antialiased_by(comments: Iterable[str]) -> bool:
    """Whether header comments call a splat anti-aliased; the last that says anything decides."""
    found = False
    for comment in comments:
        match comment.lower().replace(":", " ").split():
            case ["splatrendermode", mode, *_]:
                found = mode == "mip"
            case ["antialiased", flag, *_]:
                found = flag in ("1", "true")
    return found


def surround_by(comments: Iterable[str], count: int) -> int:
    """How many of the rows header comments call a surround; 0 where the number makes no sense."""
    for comment in comments:
        name, _, number = comment.strip().partition(" ")
        if name == SURROUND and number.isascii() and number.isdigit():
            return int(number) if int(number) < count else 0
    return 0


def write_ply(
    path: Path,
    rows: SplatRows,
    *,
    positions: Literal["float", "double"] = "float",
    antialiased: bool = False,
    surround: int = 0,
) -> None:
    """Write gaussians as a standard 3DGS .ply, through a temporary file that is renamed at the end.

    Args:
        path: The file.
        rows: What to write.
        positions: Type of x, y, z. As "double" they keep coordinates far from the origin, such as UTM's, but
            some viewers read "float" only.
        antialiased: Say in a comment that the splat was fitted with Mip-Splatting's 2D filter.
        surround: Say in a comment that so many rows at the end are a surround.

    Raises:
        InputError: the file cannot be written.
    """
    header, table = ply_contents(rows, REST, positions=positions, antialiased=antialiased, surround=surround)
    with whole_file(path) as partial, partial.open("wb") as file:
        file.write(header)
        file.write(table.tobytes())  # unlike `tofile`, it says why if the disk is full


def ply_contents(
    rows: SplatRows,
    rest_count: int,
    *,
    positions: Literal["float", "double"] = "float",
    antialiased: bool = False,
    surround: int = 0,
) -> tuple[bytes, np.ndarray]:
    """Header and rows of a 3DGS .ply with so many coefficients above degree 0; else as `write_ply`."""
    count = len(rows)
    rest = np.zeros((count, rest_count, 3), np.float32)
    rest[:, : rows.sh.shape[1] - 1] = rows.sh[:, 1:]
    blocks = {
        "x y z": rows.means,
        "nx ny nz": np.zeros((count, 3), np.float32),
        "f_dc_0 f_dc_1 f_dc_2": rows.sh[:, 0],
        " ".join(f"f_rest_{k}" for k in range(3 * rest_count)): rest.transpose(0, 2, 1),
        "opacity": rows.opacity_logits[:, None],
        "scale_0 scale_1 scale_2": rows.log_scales,
        "rot_0 rot_1 rot_2 rot_3": rows.quaternions,
    }
    kinds = {names: positions if names == "x y z" else "float" for names in blocks}
    types = {"float": "<f4", "double": "<f8"}
    blocks = {names: block.reshape(count, len(names.split())) for names, block in blocks.items() if names}
    layout = [(names, types[kinds[names]], (block.shape[1],)) for names, block in blocks.items()]
    table = np.empty(count, layout)
    for names, block in blocks.items():
        table[names] = block
    header = ["ply", "format binary_little_endian 1.0"]
    header += [f"comment {ANTIALIASED}"] if antialiased else []
    header += [f"comment {SURROUND} {surround}"] if surround else []
    header.append(f"element vertex {count}")
    header += [f"property {kind} {name}" for names, kind in kinds.items() for name in names.split()]
    return "\n".join([*header, "end_header", ""]).encode("ascii"), table


def read_standard_ply(path: Path, header: Header) -> SplatContent:
    """Read a 3DGS .ply with properties of any type and order and harmonics of degree 0 to 3.

    Harmonics of degree 4 are left out. A 2DGS .ply, which has no scale_2, is read as flat gaussians.

    Raises:
        InputError: the file is cut short or lacks a property.
    """
    vertices = read_elements(path, header, {"vertex"})["vertex"]
    names = set(vertices.dtype.names or ())
    rest_count = sum(name.startswith("f_rest_") for name in names)
    if rest_count not in REST_COUNTS:
        raise InputError(
            f"{path}: {rest_count} properties f_rest_* fit no degree; 0, 9, 24 or 45 are expected"
        )
    surfels = "scale_1" in names and "scale_2" not in names
    numbered = {"f_dc": 3, "f_rest": rest_count, "scale": 2 if surfels else 3, "rot": 4}
    needed = ["x", "y", "z", "opacity"]
    needed += [f"{name}_{k}" for name, number in numbered.items() for k in range(number)]
    missing = [name for name in needed if name not in names]
    if missing:
        raise InputError(f"{path}: holds no gaussians, property {missing[0]} is missing")

    def block(*columns: str, kind: type = np.float32) -> np.ndarray:
        return np.stack([vertices[name] for name in columns], axis=1).astype(kind)

    notes = []
    per_channel = REST_COUNTS[rest_count]
    rest = [
        block(*(f"f_rest_{per_channel * channel + k}" for channel in range(3)))
        for k in range(min(per_channel, REST))
    ]
    if per_channel > REST:
        notes.append(f"{path.name}: harmonics of degree 4 are left out, degree 3 is kept")
    scales = [block(f"scale_{k}") for k in range(2 if surfels else 3)]
    if surfels:
        scales.append(np.full_like(scales[0], -np.inf))
        notes.append(f"{path.name}: a splat of 2DGS, drawn as flat gaussians")
    rows = SplatRows(
        means=block("x", "y", "z", kind=np.float64),
        log_scales=np.concatenate(scales, axis=1),
        quaternions=block(*(f"rot_{k}" for k in range(4))),
        opacity_logits=block("opacity")[:, 0],
        sh=np.stack([block("f_dc_0", "f_dc_1", "f_dc_2"), *rest], axis=1),
    )
    surround = surround_by(header.comments, len(rows))
    return SplatContent(rows, antialiased_by(header.comments), notes, surround)
