"""The same capture in other units and far from the origin gives the same splat, in the user's own frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

import diga3d_warp as d3
from diga3d_warp.evaluation.record import CAMERAS, RESULT
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.scene.layouts.cameras_file import load_cameras
from diga3d_warp.scene.load import load_scene
from diga3d_warp.scene.scene import Points, Scene
from diga3d_warp.splatting.render import render

WORLDS = {
    "UTM": (1.0, (5e5, 4.6e6, 120.0)),
    "small": (1e-5, (0.0, 0.0, 0.0)),
    "large": (1e4, (3e5, 0.0, 0.0)),
}


def moved(scene: Scene, scale: float, shift: np.ndarray) -> Scene:
    """A capture in another world: x becomes scale x + shift."""

    def change(camera):
        pose = camera.pose.copy()
        pose[:3, 3] = scale * pose[:3, 3] - pose[:3, :3] @ shift
        return camera.with_pose(torch.from_numpy(pose)).with_near(scale * camera.near)

    points = Points(scene.points.positions * scale + shift, scene.points.colors)
    return replace(scene.with_cameras(change), points=points)


@pytest.fixture(scope="module")
def fitted(room, tmp_path_factory):
    """A short fit of the capture as it is."""
    scene = load_scene(room)
    return scene, d3.fit(scene, out=tmp_path_factory.mktemp("fitted") / "run", iterations=12)


@pytest.mark.parametrize("world", WORLDS)
def test_a_fit_is_the_same_in_any_world(fitted, tmp_path, world):
    scene, here = fitted
    scale, shift = WORLDS[world][0], np.array(WORLDS[world][1])
    other = moved(scene, scale, shift)
    there = d3.fit(other, out=tmp_path / "run", iterations=12)
    read = Gaussians.load_ply(there.run.folder / RESULT)
    assert len(read) == len(here.gaussians)
    places = here.gaussians.means.double().numpy() * scale + shift
    sizes = scale * here.gaussians.scales.max(dim=1).values.double().numpy()
    away = np.linalg.norm(read.means.double().numpy() - places, axis=1)
    assert (away < 0.2 * sizes).mean() > 0.98, "but for the rounding of the inputs"
    cameras = load_cameras(there.run.folder / CAMERAS)
    for view in other.views:
        written = {**cameras.train, **cameras.test}[view.name]
        np.testing.assert_allclose(written.pose[:3, 3], view.camera.pose[:3, 3], rtol=1e-6, atol=1e-6 * scale)
    with torch.no_grad():
        images = [
            render(each.gaussians, view.camera).color
            for each, view in ((here, scene.views[3]), (there, other.views[3]))
        ]
    assert images[0].std() > 0.05
    assert (images[0] - images[1]).abs().mean() < 2e-3
