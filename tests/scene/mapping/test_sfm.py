"""Structure from motion: points from known poses and poses from photographs alone, on the drawn corner."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from corner import PLANES
from test_load_scene import write_transforms

from diga3d_warp.errors import InputError
from diga3d_warp.scene.load import load_scene
from diga3d_warp.scene.mapping import sfm
from diga3d_warp.scene.mapping.sfm import map_images, triangulate


def distance_to_planes(positions: np.ndarray) -> np.ndarray:
    return np.min(
        [np.abs(positions @ np.array(normal) - distance) for normal, distance, *_ in PLANES], axis=0
    )


def test_points_are_triangulated_where_there_are_none(tmp_path, corner):
    corner.write_images(tmp_path / "images")
    write_transforms(tmp_path, corner)
    scene = load_scene(tmp_path)
    assert len(scene.points) > 100
    assert np.median(distance_to_planes(scene.points.positions)) < 0.02
    assert scene.notes == (f"the capture has no sparse points: triangulated {len(scene.points)}",)


@pytest.fixture
def on_threads(monkeypatch):
    """Run a function with this many threads for pycolmap and torch."""
    before = torch.get_num_threads()

    def run(count: int, function, *arguments):
        extraction = sfm._extraction()
        extraction.num_threads = count
        monkeypatch.setattr(sfm, "_extraction", lambda: extraction)
        torch.set_num_threads(count)
        return function(*arguments)

    yield run
    torch.set_num_threads(before)


def test_triangulated_points_do_not_depend_on_threads(corner, on_threads):
    images = {name: corner.images[name] for name in list(corner.cameras)[:4]}
    cameras = {name: corner.cameras[name] for name in images}
    first, *others = (on_threads(count, triangulate, images, cameras, False) for count in (1, 2, 4))
    assert len(first) > 100
    for other in others:
        np.testing.assert_array_equal(other.positions, first.positions)
        np.testing.assert_array_equal(other.colors, first.colors)


def test_mapped_poses_do_not_depend_on_threads(corner, on_threads):
    images = {name: corner.images[name] for name in list(corner.cameras)[:4]}
    (cameras, points), (again, same) = (on_threads(count, map_images, images, False) for count in (1, 4))
    assert list(cameras) == list(again) and len(points) > 100
    for name, camera in cameras.items():
        np.testing.assert_array_equal(np.asarray(again[name].pose), np.asarray(camera.pose))
    np.testing.assert_array_equal(same.positions, points.positions)


def test_poses_are_recovered_from_photographs(tmp_path, corner):
    corner.write_images(tmp_path)
    scene = load_scene(tmp_path, hold_out=0)
    assert scene.kind == "images"
    assert [view.name for view in scene.views] == list(corner.cameras)
    assert len(scene.points) > 100
    assert scene.views[0].camera.fx == pytest.approx(200, rel=0.1)
    # The world is found up to a similarity: compare distances between centres.
    found, true = (
        np.stack([cameras[name].center for name in corner.cameras])
        for cameras in ({v.name: v.camera for v in scene.views}, corner.cameras)
    )
    ratios = np.linalg.norm(found[1:] - found[0], axis=1) / np.linalg.norm(true[1:] - true[0], axis=1)
    np.testing.assert_allclose(ratios / ratios.mean(), 1, atol=0.1)


def test_photographs_that_share_nothing(corner):
    blank = {name: np.full((60, 80, 3), 99, np.uint8) for name in corner.images}
    with pytest.raises(InputError, match="share too few features; take more overlapping photographs"):
        map_images(blank, progress=False)


def test_points_are_in_the_order_of_their_features_whatever_order_colmap_keeps():
    def point(number: int, *elements: tuple[int, int]) -> SimpleNamespace:
        seen = [SimpleNamespace(image_id=image, point2D_idx=feature) for image, feature in elements]
        track = SimpleNamespace(elements=seen)
        return SimpleNamespace(xyz=np.full(3, float(number)), color=np.full(3, number, np.uint8), track=track)

    points = {7: point(2, (2, 1), (1, 9)), 3: point(3, (3, 0), (2, 4)), 5: point(1, (3, 8), (1, 2))}
    images = {number: SimpleNamespace(name=f"{number}.png") for number in (1, 2, 3)}
    for numbers in ((7, 3, 5), (5, 7, 3)):
        kept = {number: points[number] for number in numbers}
        found = sfm._points(SimpleNamespace(points3D=kept, images=images))
        assert found.positions[:, 0].tolist() == [1.0, 2.0, 3.0]
        assert found.colors[:, 0].tolist() == [1, 2, 3]
        assert found.tracks == [{"1", "3"}, {"1", "2"}, {"2", "3"}]


def test_what_adds_observations_runs_on_one_thread_from_a_seed():
    """On several, the same bytes come out mostly, not always."""
    options = sfm._mapping()
    assert options.num_threads == options.mapper.num_threads == 1
    assert {options.random_seed, options.mapper.random_seed, options.triangulation.random_seed} == {0}
