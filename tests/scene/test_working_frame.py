"""Working units: the same numbers inside, whatever unit and origin a capture has."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from diga3d_warp.config import SPLATTING
from diga3d_warp.scene.camera import Camera, look_at
from diga3d_warp.scene.scene import Points, Scene, View
from diga3d_warp.scene.working_frame import WorkingFrame, with_near_planes

WORLDS = {
    "UTM": (1.0, (5e5, 4.6e6, 120.0)),
    "small": (1e-5, (0.0, 0.0, 0.0)),
    "large": (3e4, (-9e5, 7e4, 0.0)),
}


def scene(scale: float = 1.0, shift=(0.0, 0.0, 0.0)) -> Scene:
    """A ring of cameras around a cloud, moved and scaled in float64."""
    views = []
    for index, angle in enumerate(np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)):
        pose = look_at(np.array([3.0 * np.cos(angle), 3.0 * np.sin(angle), 1.0]), np.zeros(3))
        pose[:3, 3] = scale * pose[:3, 3] - pose[:3, :3] @ np.array(shift)
        camera = Camera(40, 30, 35.0, 36.0, 20.5, 14.0, torch.from_numpy(pose))
        views.append(View(f"view_{index}", camera, np.zeros((30, 40, 3), np.uint8)))
    positions = np.random.default_rng(0).normal(size=(60, 3)) * scale + np.array(shift)
    return Scene(Path("room"), "colmap", views[1:], views[:1], Points(positions, np.zeros((60, 3), np.uint8)))


@pytest.mark.parametrize("world", WORLDS)
def test_cameras_and_points_are_the_same_in_any_world(world):
    here, there = (WorkingFrame.of(each).working_scene(each) for each in (scene(), scene(*WORLDS[world])))
    np.testing.assert_allclose(there.points.positions, here.points.positions, atol=1e-8)
    for mine, theirs in zip([*here.views, *here.test_views], [*there.views, *there.test_views], strict=True):
        np.testing.assert_allclose(theirs.camera.pose, mine.camera.pose, atol=1e-8)
        assert theirs.camera.near == mine.camera.near == SPLATTING.near
    assert there.extent == pytest.approx(1.0), "the unit"
    assert np.abs(there.centers.mean(axis=0)).max() < 1e-8


@pytest.mark.parametrize("world", WORLDS)
def test_there_and_back_loses_nothing(world):
    given = scene(*WORLDS[world])
    frame = WorkingFrame.of(given)
    back = frame.to_user(frame.to_working(given.points.positions))
    np.testing.assert_allclose(back, given.points.positions, rtol=1e-15, atol=1e-9 * frame.unit)


@pytest.mark.parametrize("world", WORLDS)
def test_the_near_plane_is_a_part_of_the_extent(world):
    scale, _ = WORLDS[world]
    near = [with_near_planes(each).views[0].camera.near for each in (scene(), scene(*WORLDS[world]))]
    assert near[1] == pytest.approx(scale * near[0], rel=1e-6)
    assert near[0] == pytest.approx(SPLATTING.near * scene().extent)


def test_a_camera_far_away_does_not_change_the_unit():
    given = scene()
    camera = given.views[0].camera
    pose = camera.pose.copy()
    pose[2, 3] += 5000.0
    stray = replace(given.views[0], name="stray", camera=camera.with_pose(torch.from_numpy(pose)))
    assert WorkingFrame.of(replace(given, views=[*given.views, stray])).unit == WorkingFrame.of(given).unit
