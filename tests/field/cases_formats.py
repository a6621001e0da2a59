"""Cases of splat and point cloud files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from expectations import Reads, Refuses, case
from field_room import FieldRoom
from plyfile import PlyData, PlyElement
from scipy.spatial import cKDTree

from diga3d_warp.gaussians.initialise import initialise
from diga3d_warp.scene.colmap.reconstruction import write_colmap
from diga3d_warp.scene.formats.standard_ply import write_ply
from diga3d_warp.scene.formats.write import ENDINGS, write_splat
from diga3d_warp.scene.layouts.cameras_file import CameraSet, save_cameras
from diga3d_warp.scene.scene import Scene

SPLAT = "point_cloud.ply"


def same_colors(scene: Scene, room: FieldRoom) -> None:
    """The points have the room's colours, in whatever order they are."""
    order, own = (np.lexsort(p.positions.T.round(4)) for p in (scene.points, room.points))
    difference = np.abs(scene.points.colors[order].astype(int) - room.points.colors[own])
    assert difference.max() <= 1, difference.max()


def vertices(path: Path) -> np.ndarray:
    return np.array(PlyData.read(path)["vertex"].data)


def edited_splat(room: FieldRoom, folder: Path, edit, **form) -> Path:
    """The room's splat with its rows changed by `edit`, written by plyfile."""
    room.splat(folder)
    rows = vertices(folder / SPLAT)
    edit(rows)
    PlyData([PlyElement.describe(rows, "vertex")], **form).write(folder / SPLAT)
    return folder


def cloud(room: FieldRoom, folder: Path, kind: str | None, factor: float, prefix: str = "") -> Path:
    """nerfstudio's layout, the colours of sparse_pc.ply as numbers of `kind`, none if None."""
    room.nerfstudio(folder)
    points = room.points
    colors = [(f"{prefix}{name}", kind) for name in ("red", "green", "blue")] if kind else []
    rows = np.zeros(len(points), [*((axis, "f4") for axis in "xyz"), *colors])
    for k, axis in enumerate("xyz"):
        rows[axis] = points.positions[:, k]
    for k, (name, _) in enumerate(colors):
        rows[name] = points.colors[:, k] * float(factor)
    PlyData([PlyElement.describe(rows, "vertex")]).write(folder / "sparse_pc.ply")
    return folder


@case(Reads(also=same_colors, notes=("colours from 0 to 1",)))
def point_cloud_colors_from_0_to_1(room: FieldRoom, folder: Path) -> Path:
    return cloud(room, folder, "f4", 1 / 255)


@case(Reads(also=same_colors, notes=("colours from 0 to 255",)))
def point_cloud_float_colors_from_0_to_255(room: FieldRoom, folder: Path) -> Path:
    return cloud(room, folder, "f4", 1)


@case(Reads(also=same_colors, notes=("colours from 0 to 65535",)))
def point_cloud_colors_of_16_bits(room: FieldRoom, folder: Path) -> Path:
    return cloud(room, folder, "u2", 257)


@case(Reads(also=same_colors))
def point_cloud_with_diffuse_colors(room: FieldRoom, folder: Path) -> Path:
    return cloud(room, folder, "u1", 1, "diffuse_")


@case(Reads(notes=("no colours and start grey",)))
def point_cloud_without_colors(room: FieldRoom, folder: Path) -> Path:
    return cloud(room, folder, None, 1)


@case(Reads(notes=("600 gaussians of infinite opacity logit are opaque",)))
def splat_all_opaque(room: FieldRoom, folder: Path) -> Path:
    def edit(rows: np.ndarray) -> None:
        rows["opacity"] = np.inf

    return edited_splat(room, folder, edit)


@case(Reads(notes=("300 gaussians of zero scale are flat",)))
def splat_half_flat(room: FieldRoom, folder: Path) -> Path:
    def edit(rows: np.ndarray) -> None:
        rows["scale_2"][::2] = -np.inf

    return edited_splat(room, folder, edit)


@case(Reads())
def splat_in_text_with_a_blank_line(room: FieldRoom, folder: Path) -> Path:
    edited_splat(room, folder, lambda rows: None, text=True)
    path = folder / SPLAT
    path.write_bytes(path.read_bytes().replace(b"end_header\n", b"end_header\n\n", 1))
    return folder


@case(Reads())
def splat_in_big_endian(room: FieldRoom, folder: Path) -> Path:
    return edited_splat(room, folder, lambda rows: None, byte_order=">")


@case(Reads())
def splat_behind_another_element(room: FieldRoom, folder: Path) -> Path:
    room.splat(folder)
    first = np.array([(1.0, 2.0)], [("fx", "f4"), ("fy", "f4")])
    elements = [PlyElement.describe(first, "camera"), PlyElement.describe(vertices(folder / SPLAT), "vertex")]
    PlyData(elements).write(folder / SPLAT)
    return folder


@case(Reads())
def splat_with_dos_header(room: FieldRoom, folder: Path) -> Path:
    room.splat(folder)
    path = folder / SPLAT
    header, rows = path.read_bytes().split(b"end_header\n", 1)
    path.write_bytes(header.replace(b"\n", b"\r\n") + b"end_header\r\n" + rows)
    return folder


@case(Reads())
def splat_of_degree_0_in_doubles(room: FieldRoom, folder: Path) -> Path:
    """No normals, properties in another order, all of them doubles."""
    room.splat(folder)
    rows = vertices(folder / SPLAT)
    unwanted = ("f_rest_", "n")
    names = [name for name in reversed(rows.dtype.names) if not name.startswith(unwanted)]
    wide = np.empty(len(rows), [(name, "f8") for name in names])
    for name in names:
        wide[name] = rows[name]
    PlyData([PlyElement.describe(wide, "vertex")]).write(folder / SPLAT)
    return folder


@case(Reads(points=False, notes=("left out 7 gaussians with NaN or infinite values",)))
def splat_with_broken_rows(room: FieldRoom, folder: Path) -> Path:
    def edit(rows: np.ndarray) -> None:
        rows["y"][:7] = np.nan

    return edited_splat(room, folder, edit)


@case(Refuses((SPLAT, "cannot read its 1000000000000 rows of vertex")))
def splat_that_announces_too_many_rows(room: FieldRoom, folder: Path) -> Path:
    room.splat(folder)
    path = folder / SPLAT
    path.write_bytes(path.read_bytes().replace(b"vertex 600", b"vertex 1000000000000", 1))
    return folder


@case(Reads())
def splat_in_upper_case(room: FieldRoom, folder: Path) -> Path:
    room.splat(folder)
    return (folder / SPLAT).rename(folder / "SCENE.PLY")


@case(Reads())
def splat_as_the_point_cloud_of_nerfstudio(room: FieldRoom, folder: Path) -> Path:
    """Named by transforms.json, so it gives the points; it is a splat with poses, too."""
    room.nerfstudio(folder)
    initialise(room.points).save_ply(folder / "sparse_pc.ply")
    return folder


@case(Reads())
def splat_with_far_cameras_file(room: FieldRoom, folder: Path) -> Path:
    """As 3DGS trains: cameras.json and images at the top, the splat two folders below."""
    room.write_images(folder / "images")
    save_cameras(folder / "cameras.json", CameraSet(room.cameras))
    path = folder / "point_cloud" / "iteration_30000" / SPLAT
    write_ply(path, initialise(room.points).rows(), positions="double")
    return path


def as_format(room: FieldRoom, folder: Path, form: str) -> Path:
    """The room's splat in another format; the folder has no .ply."""
    pytest.importorskip("gsply")
    pytest.importorskip("gaussforge")
    room.splat(folder)
    path = folder / f"point_cloud{ENDINGS[form]}"
    write_splat(path, initialise(room.points).rows(), form)
    if path.name != SPLAT:
        (folder / SPLAT).unlink()
    return folder


def near_points(scene: Scene, room: FieldRoom) -> None:
    """The points are those of the room, as near as the format stores them."""
    distances, nearest = cKDTree(scene.points.positions).query(room.points.positions)
    assert len(scene.points) == len(room.points) and distances.max() < 0.01, distances.max()
    difference = np.abs(scene.points.colors[nearest].astype(int) - room.points.colors)
    assert np.median(difference) <= 4


@case(Reads(points=False, also=near_points))
def splat_as_compressed_ply(room: FieldRoom, folder: Path) -> Path:
    return as_format(room, folder, "compressed-ply")


@case(Reads(points=False, also=near_points))
def splat_as_compressed_ply_beside_colmap(room: FieldRoom, folder: Path) -> Path:
    as_format(room, folder, "compressed-ply")
    (folder / "cameras.json").unlink()
    write_colmap(folder, room.cameras, room.points, suffix=".jpg")
    return folder


@case(Reads(points=False, also=near_points))
def splat_as_spz(room: FieldRoom, folder: Path) -> Path:
    return as_format(room, folder, "spz")


@case(Reads(points=False, also=near_points))
def splat_as_sog(room: FieldRoom, folder: Path) -> Path:
    return as_format(room, folder, "sog")


@case(Reads(points=False, also=near_points))
def splat_as_splat(room: FieldRoom, folder: Path) -> Path:
    return as_format(room, folder, "splat") / "point_cloud.splat"


@case(Refuses(("point_cloud.splat: cut short: its last 240 of 600 gaussians are zeros",)))
def splat_whose_download_did_not_end(room: FieldRoom, folder: Path) -> Path:
    """The browser reserved the space of the whole file."""
    path = as_format(room, folder, "splat") / "point_cloud.splat"
    path.write_bytes(path.read_bytes()[: 360 * 32] + bytes(240 * 32))
    return folder


@case(Reads(notes=("point_cloud.ply is read, not point_cloud.splat",)))
def splat_in_two_formats(room: FieldRoom, folder: Path) -> Path:
    as_format(room, folder, "splat")
    initialise(room.points).save_ply(folder / SPLAT)
    return folder


@case(Refuses(("several splats (a.ply, b.splat)", "give the path of one")))
def two_splats(room: FieldRoom, folder: Path) -> Path:
    as_format(room, folder, "splat")
    (folder / "point_cloud.splat").rename(folder / "b.splat")
    initialise(room.points).save_ply(folder / "a.ply")
    return folder


@case(Refuses(("point_cloud.spz", "cut short or damaged")))
def splat_as_half_an_spz(room: FieldRoom, folder: Path) -> Path:
    path = as_format(room, folder, "spz") / "point_cloud.spz"
    path.write_bytes(path.read_bytes()[:3000])
    return folder


@case(Refuses(("point_cloud.spz", "no cameras file")))
def splat_without_cameras(room: FieldRoom, folder: Path) -> Path:
    as_format(room, folder, "spz")
    (folder / "cameras.json").unlink()
    return folder
