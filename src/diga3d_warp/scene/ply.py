"""Vertices of a .ply file, ASCII or binary, as a structured array."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from diga3d_warp.errors import InputError
from diga3d_warp.scene.scene import Points

_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float": "f4", "double": "f8", "float32": "f4", "float64": "f8",
}  # fmt: skip
_BYTE_ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}
_HEADER_LIMIT = 1 << 16  # bytes; a 3DGS header takes 2 kB
_DC_TO_COLOR = 0.28209479177387814  # value of the constant spherical harmonic, 1 / (2 sqrt(pi))


def _header(path: Path) -> tuple[int, str, list[tuple[str, int, list[tuple[str, str]]]]]:
    """Length of the header [bytes], format, and the elements as (name, count, [(property, type)])."""
    with path.open("rb") as file:
        start = file.read(_HEADER_LIMIT)
    end = start.find(b"end_header")
    newline = start.find(b"\n", end)
    if not start.startswith(b"ply") or end < 0 or newline < 0:
        raise InputError(f"{path}: not a .ply file, its header is missing; export it again")
    form = ""
    elements: list[tuple[str, int, list[tuple[str, str]]]] = []
    for line in start[:end].decode("latin-1").splitlines():
        match line.split():
            case ["format", form, *_]:
                pass
            case ["element", name, count] if count.isdecimal():
                elements.append((name, int(count), []))
            case ["property", kind, name] if elements:
                elements[-1][2].append((name, kind))
            case ["property", "list", _, _, name] if elements:
                elements[-1][2].append((name, "list"))
    if form not in _BYTE_ORDERS or not elements:
        raise InputError(f"{path}: the .ply header names no known format or no element; export it again")
    return newline + 1, form, elements


def property_names(path: Path) -> set[str]:
    """Names of the vertex properties; empty if the vertices are not the first element."""
    _, _, elements = _header(path)
    name, _, properties = elements[0]
    return {p for p, _ in properties} if name == "vertex" else set()


def read_vertices(path: Path) -> np.ndarray:
    """Vertices of a .ply file, a structured array with one field per property.

    Raises:
        InputError: the file is not a .ply, is cut short, or does not begin with vertices of plain numbers.
    """
    begin, form, elements = _header(path)
    name, count, properties = elements[0]
    if name != "vertex" or any(kind not in _TYPES for _, kind in properties):
        raise InputError(f"{path}: the first element must be vertices of plain numbers; export it again")
    if len({p for p, _ in properties}) < len(properties):
        raise InputError(f"{path}: the .ply header names a property twice; export it again")
    layout = np.dtype([(p, _BYTE_ORDERS[form] + _TYPES[kind]) for p, kind in properties])
    damaged = InputError(f"{path}: cut short or damaged: cannot read its {count} vertices; export it again")
    if form != "ascii":
        if path.stat().st_size < begin + layout.itemsize * count:
            raise damaged
        return np.fromfile(path, layout, count, offset=begin)
    lines = path.read_bytes()[begin:].split(b"\n", count)[:count]
    try:
        table = np.array([line.split() for line in lines], np.float64).reshape(count, len(properties))
    except ValueError:
        raise damaged from None
    vertices = np.empty(count, layout)
    for column, (p, _) in enumerate(properties):
        vertices[p] = table[:, column]
    return vertices


def read_points(path: Path) -> Points:
    """Points of a point cloud or of a splat .ply; grey where it has no colours.

    Points that are not finite are left out.

    Raises:
        InputError: the file is damaged or has no positions.
    """
    vertices = read_vertices(path)
    fields = set(vertices.dtype.names or ())
    if not {"x", "y", "z"} <= fields:
        raise InputError(f"{path}: the vertices have no x, y, z; export it again")
    positions = np.stack([vertices[axis] for axis in "xyz"], axis=1).astype(np.float64)
    if {"red", "green", "blue"} <= fields:
        colors = np.stack([vertices[c] for c in ("red", "green", "blue")], axis=1).astype(np.uint8)
    elif {"f_dc_0", "f_dc_1", "f_dc_2"} <= fields:
        constant = np.stack([vertices[f"f_dc_{c}"] for c in range(3)], axis=1)
        shade = np.nan_to_num(0.5 + _DC_TO_COLOR * constant)
        colors = np.rint(shade.clip(0, 1) * 255).astype(np.uint8)
    else:
        colors = np.full((len(positions), 3), 128, np.uint8)
    finite = np.isfinite(positions).all(axis=1)
    return Points(positions[finite], colors[finite])
