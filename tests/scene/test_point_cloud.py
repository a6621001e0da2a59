"""Point clouds: positions, and colours in whatever numbers a .ply holds them."""

from __future__ import annotations

import numpy as np
import pytest
from plyfile import PlyData, PlyElement

from diga3d_warp.errors import InputError
from diga3d_warp.scene.point_cloud import read_points

COLORS = np.array([[0, 128, 255], [255, 51, 0], [17, 204, 90]], np.uint8)
POSITIONS = np.array([[0.0, 1.0, 2.0], [-1.0, 0.5, 3.0], [5e5, 4.6e6, 1.0]])


def write(path, kind, values, names=("red", "green", "blue"), positions=POSITIONS):
    rows = np.zeros(len(positions), [*((axis, "f8") for axis in "xyz"), *((name, kind) for name in names)])
    for k, axis in enumerate("xyz"):
        rows[axis] = positions[:, k]
    for k, name in enumerate(names):
        rows[name] = values[:, k]
    PlyData([PlyElement.describe(rows, "vertex")]).write(path)
    return path


@pytest.mark.parametrize(
    ("kind", "factor", "said"),
    [
        ("u1", 1, None),
        ("f4", 1 / 255, "colours from 0 to 1"),
        ("f8", 1 / 255, "colours from 0 to 1"),
        ("f4", 1.0001 / 255, "colours from 0 to 1"),
        ("f4", 1, "colours from 0 to 255"),
        ("u2", 257, "colours from 0 to 65535"),
        ("u2", 1, "colours from 0 to 255"),
        ("i4", 1, "colours from 0 to 255"),
    ],
)
@pytest.mark.parametrize(
    "names", [("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("R", "G", "B")]
)
def test_colours_of_any_type(tmp_path, kind, factor, said, names):
    points, notes = read_points(write(tmp_path / "cloud.ply", kind, COLORS * float(factor), names))
    np.testing.assert_array_equal(points.colors, COLORS)
    np.testing.assert_array_equal(points.positions, POSITIONS)
    assert len(notes) == (said is not None) and all(said in note and "cloud.ply" in note for note in notes)


def test_points_without_colours_are_grey_with_a_note(tmp_path):
    points, notes = read_points(write(tmp_path / "cloud.ply", "f4", COLORS, names=("nx", "ny", "nz")))
    assert (points.colors == 128).all() and points.colors.dtype == np.uint8
    assert notes == ["cloud.ply: the points have no colours and start grey"]


def test_points_that_are_not_finite_are_counted(tmp_path):
    positions = POSITIONS.copy()
    positions[1, 2] = np.nan
    points, notes = read_points(write(tmp_path / "cloud.ply", "u1", COLORS, positions=positions))
    np.testing.assert_array_equal(points.colors, COLORS[[0, 2]])
    assert notes == ["cloud.ply: left out 1 points with NaN or infinite positions"]


def test_points_without_positions_are_one_line(tmp_path):
    rows = np.zeros(3, [("x", "f4"), ("y", "f4")])
    PlyData([PlyElement.describe(rows, "vertex")]).write(tmp_path / "cloud.ply")
    with pytest.raises(InputError, match=r"cloud\.ply: the vertices have no x, y, z"):
        read_points(tmp_path / "cloud.ply")
