"""Held-out views: nothing of them goes into what is fitted, and what may have seen them is said."""

from __future__ import annotations

import numpy as np
import pytest
from corner import HEIGHT, WIDTH, Corner
from test_load_scene import write_poses_bounds, write_transforms

from diga3d_warp.gaussians.initialise import initialise
from diga3d_warp.scene import load
from diga3d_warp.scene.layouts.cameras_file import CameraSet, save_cameras
from diga3d_warp.scene.load import load_scene
from diga3d_warp.scene.scene import Points

POINTS = Points(np.zeros((3, 3)), np.full((3, 3), 9, np.uint8))


@pytest.fixture
def triangulated(monkeypatch) -> list[np.ndarray]:
    """Photographs that points were triangulated from."""
    seen: list[np.ndarray] = []

    def triangulate(images, cameras, progress) -> Points:
        seen.extend(images.values())
        return POINTS

    monkeypatch.setattr(load, "triangulate", triangulate)
    return seen


def names(seen: list[np.ndarray], corner: Corner) -> list[str]:
    return [name for name, own in corner.images.items() if any((own == each).all() for each in seen)]


def test_points_come_from_training_views(tmp_path, corner, triangulated):
    corner.write_images(tmp_path / "images")
    write_transforms(tmp_path, corner)
    scene = load_scene(tmp_path, hold_out=3)
    assert [view.name for view in scene.test_views] == ["view_00", "view_03"]
    assert names(triangulated, corner) == ["view_01", "view_02", "view_04", "view_05"]


def test_views_without_the_object_give_no_points(tmp_path, corner, triangulated):
    """SPIn-NeRF's test views show what lies behind the object."""
    corner.write_images(tmp_path / "images_4")
    write_poses_bounds(tmp_path, corner)
    corner.write_masks(tmp_path / "images_4" / "label", [f"view_{index:02d}" for index in range(2, 6)])
    corner.write_masks(tmp_path / "images_4" / "test_label", ["view_00", "view_01"])
    scene = load_scene(tmp_path)
    assert scene.ground_truth and [view.name for view in scene.test_views] == ["view_00", "view_01"]
    assert names(triangulated, corner) == ["view_02", "view_03", "view_04", "view_05"]


def test_mapped_points_are_those_that_training_views_show(tmp_path, corner, monkeypatch):
    """Points that only a held-out view adds to another one are left out, and it is said."""
    tracks = [
        frozenset({"000000", "000001"}),
        frozenset({"000001", "000002", "000000"}),
        frozenset({"000004"}),
    ]

    def map_images(images, progress):
        return dict(zip(images, corner.cameras.values(), strict=True)), Points(
            np.eye(3), np.zeros((3, 3), np.uint8), tracks
        )

    monkeypatch.setattr(load, "map_images", map_images)
    corner.write_images(tmp_path)
    scene = load_scene(tmp_path, hold_out=3)
    np.testing.assert_array_equal(scene.points.positions, [[0.0, 1.0, 0.0]])
    assert "2 of 3 points that only they add are left out" in scene.notes[-1]
    assert len(load_scene(tmp_path, hold_out=0).points) == 3


def given_splat(folder, corner: Corner, *, split: bool):
    corner.write_images(folder / "images")
    initialise(corner.points).save_ply(folder / "point_cloud.ply")
    cameras = dict(corner.cameras)
    test = {"view_04": cameras.pop("view_04")}
    save_cameras(folder / "cameras.json", CameraSet(cameras, test))
    if not split:
        text = (folder / "cameras.json").read_text()
        for part in ("train", "test"):
            text = text.replace(f',\n    "split": "{part}"', "")
        (folder / "cameras.json").write_text(text)


def test_the_split_of_a_given_splat_is_kept(tmp_path, corner):
    given_splat(tmp_path, corner, split=True)
    scene = load_scene(tmp_path, hold_out=2)
    assert [view.name for view in scene.test_views] == ["view_04"]
    assert not scene.may_be_seen and scene.notes == ()


def test_a_given_splat_without_a_split_may_have_seen_all(tmp_path, corner):
    given_splat(tmp_path, corner, split=False)
    scene = load_scene(tmp_path, hold_out=3)
    assert [view.name for view in scene.test_views] == ["view_00", "view_03"]
    assert scene.may_be_seen
    assert scene.notes == ("the held-out views may be among those that the given splat was trained on",)
    assert not load_scene(tmp_path, hold_out=0).may_be_seen
    assert scene.views[0].pixels.shape == (HEIGHT, WIDTH, 3)
