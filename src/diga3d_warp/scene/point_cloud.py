"""Coloured points of a .ply file: positions and 8-bit colours, from any numeric type."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from diga3d_warp.errors import InputError
from diga3d_warp.scene.formats.ply import read_vertices
from diga3d_warp.scene.scene import Points

_COLOR_NAMES = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))
"""Properties that hold colours: those of MeshLab and CloudCompare, of older exporters, and of Polycam."""

UNIT_MOST = 2.0
"""Largest colour that is taken as one of 0 to 1: some exceed 1 by rounding or by exposure, and in 0 to 255
nothing is that dark."""

GREY = 128
"""Colour of points that have none."""


def read_points(path: Path) -> tuple[Points, list[str]]:
    """Points of a point cloud .ply, grey where it has no colours.

    Points that are not finite are left out. Colours are taken as 0 to 255, 0 to 1 or 0 to 65535, whichever
    fits the type and the largest value.

    Returns:
        The points, and a note for each thing that was guessed or left out.

    Raises:
        InputError: the file is damaged or has no positions.
    """
    vertices = read_vertices(path)
    fields = {name.lower(): name for name in vertices.dtype.names or ()}
    if not {"x", "y", "z"} <= fields.keys():
        raise InputError(f"{path}: the vertices have no x, y, z; export it again")
    with np.errstate(invalid="ignore"):  # values that are not finite are handled below
        positions = np.stack([vertices[fields[axis]] for axis in "xyz"], axis=1).astype(np.float64)
    notes = []
    names = next((names for names in _COLOR_NAMES if fields.keys() >= set(names)), None)
    if names is None:
        colors = np.full((len(positions), 3), GREY, np.uint8)
        notes.append(f"{path.name}: the points have no colours and start grey")
    else:
        colors, note = eight_bit(np.stack([vertices[fields[name]] for name in names], axis=1))
        notes += [f"{path.name}: {note}"] if note else []
    finite = np.isfinite(positions).all(axis=1)
    if not finite.all():
        notes.append(f"{path.name}: left out {int((~finite).sum())} points with NaN or infinite positions")
    return Points(positions[finite], colors[finite]), notes


def eight_bit(values: np.ndarray) -> tuple[np.ndarray, str | None]:
    """Colours as uint8, and what was guessed of their range; None where there was nothing to guess."""
    if values.dtype == np.uint8:
        return values, None
    with np.errstate(invalid="ignore"):
        shades = np.nan_to_num(values.astype(np.float64), nan=0.0, posinf=0.0, neginf=0.0)
    largest = float(shades.max(initial=0.0))
    if values.dtype.kind == "f" and largest <= UNIT_MOST:
        scale, said = 255.0, "colours from 0 to 1"
    elif largest < 256.0:
        scale, said = 1.0, "colours from 0 to 255"
    else:
        scale, said = 255.0 / 65535.0, "colours from 0 to 65535"
    note = f"{said}, as their type {values.dtype.name} and their largest value {largest:g} suggest"
    return np.rint((shades * scale).clip(0, 255)).astype(np.uint8), note
