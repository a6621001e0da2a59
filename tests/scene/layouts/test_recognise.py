"""Recognise: what is at a path; whole captures of each layout are in tests/field."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from test_load_scene import write_cameras_json, write_poses_bounds, write_splat, write_transforms

from diga3d_warp.errors import InputError
from diga3d_warp.scene.layouts.recognise import recognise


@pytest.fixture
def everything(colmap_scene, corner) -> Path:
    """A folder with poses of every kind."""
    write_transforms(colmap_scene, corner)
    write_poses_bounds(colmap_scene, corner)
    write_cameras_json(colmap_scene / "cameras.json", corner)
    shutil.copy(colmap_scene / "transforms.json", colmap_scene / "transforms_train.json")
    shutil.copytree(colmap_scene / "sparse", colmap_scene / "colmap" / "sparse")
    return colmap_scene


def without(root: Path, *names: str) -> Path:
    for name in names:
        path = root / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    return root


def test_the_order_of_poses(everything):
    """The capture's own come first: those that people edit, then COLMAP's, then those of other tools."""
    expected = ("transforms.json", "sparse/0", "colmap/sparse/0", "transforms_train.json", "poses_bounds.npy")
    for name in (*expected, "cameras.json"):
        found = recognise(everything)
        assert [each.relative_to(everything).as_posix() for each in found.poses] == [name]
        without(everything, "sparse" if name == "sparse/0" else "colmap" if "colmap" in name else name)
        assert len(found.notes) == (name != "cameras.json")


def test_what_is_not_used_is_noted(everything):
    (note,) = recognise(everything).notes
    assert note.endswith(
        "poses are those of transforms.json; not used: cameras.json, poses_bounds.npy, "
        "transforms_train.json, sparse/0, colmap/sparse/0"
    )


def test_a_splat_goes_with_its_cameras(everything, corner):
    write_splat(everything / "scene.ply", corner.points.positions)
    for path in (everything, everything / "scene.ply"):
        found = recognise(path)
        assert (found.kind, found.splat) == ("cameras", everything / "scene.ply")


@pytest.mark.parametrize(
    ("named", "kind", "poses"),
    [
        ("transforms.json", "nerfstudio", "transforms.json"),
        ("transforms_train.json", "nerfstudio", "transforms_train.json"),
        ("cameras.json", "cameras", "cameras.json"),
        ("poses_bounds.npy", "llff", "poses_bounds.npy"),
        ("sparse/0/images.bin", "colmap", "sparse/0"),
        ("sparse/0/points3D.bin", "colmap", "sparse/0"),
        ("colmap/sparse/0", "colmap", "colmap/sparse/0"),
        ("colmap/sparse", "colmap", "colmap/sparse/0"),
        ("sparse", "colmap", "sparse/0"),
    ],
)
def test_what_is_named_is_what_is_read(everything, named, kind, poses):
    found = recognise(everything / named)
    assert (found.root, found.kind, found.notes) == (everything, kind, ())
    assert found.poses == [everything / poses]


def test_relative_paths(everything, monkeypatch):
    monkeypatch.chdir(everything / "sparse" / "0")
    found = recognise(Path("cameras.bin"))
    assert found.root.samefile(everything) and found.kind == "colmap"
    monkeypatch.chdir(everything)
    assert recognise(Path()).kind == "nerfstudio"
    monkeypatch.chdir(everything / "images")
    assert recognise(Path()).kind == "nerfstudio"


def test_poses_above_photographs_are_noted(colmap_scene, corner):
    inner = colmap_scene / "images" / "front"
    corner.write_images(inner)
    found = recognise(inner)
    assert found.kind == "images"
    assert found.notes[0].startswith(f"{colmap_scene} holds poses, which are not used")


def test_a_run_is_no_capture_of_its_renderings(tmp_path, corner):
    """Its cameras.json names the views, and views/ holds pictures of these names."""
    from diga3d_warp.scene.load import load_scene

    corner.write_images(tmp_path / "views" / "after")
    write_cameras_json(tmp_path / "cameras.json", corner)
    write_splat(tmp_path / "point_cloud.ply", corner.points.positions)
    (tmp_path / "manifest.json").write_text("{}")
    (tmp_path / "metrics.json").write_text("{}")
    with pytest.raises(InputError, match="images holds no photographs"):
        load_scene(tmp_path)


@pytest.mark.parametrize("name", ["x" * 300, "a\0b"])
def test_names_that_no_path_has(tmp_path, name):
    with pytest.raises(InputError, match="no such file or folder"):
        recognise(tmp_path / name)
