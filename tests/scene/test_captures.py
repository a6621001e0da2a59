"""Real captures: sparse points, projected into the views, must meet pixels of their own colour.

That fails at once if an axis, a principal point, a scale or the frame of the points is wrong: moved by two
pixels, the agreement drops, and moved by any axis it is lowest where nothing is moved.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from test_colmap import project

from diga3d_warp.scene.load import load_scene
from diga3d_warp.scene.scene import Scene

CAPTURES = Path(os.environ.get("DIGA3D_CAPTURES", "no captures named"))
pytestmark = [
    pytest.mark.captures,
    pytest.mark.skipif(not CAPTURES.is_dir(), reason="the real captures are not here"),
]


def color_agreement(scene: Scene, shift: tuple[float, float] = (0.0, 0.0)) -> float:
    """Share of projected points whose pixel differs by less than 20 of 255 in the mean over channels."""
    differences = []
    for view in scene.views[::4]:
        pose, (height, width) = view.camera.pose, view.pixels.shape[:2]
        positions = scene.points.positions @ pose[:3, :3].T + pose[:3, 3]
        ahead = positions[:, 2] > 0.1
        pixels = np.floor(project(view.camera, positions[ahead]) + shift).astype(int)
        inside = ((pixels >= 0) & (pixels < (width, height))).all(axis=1)
        x, y = pixels[inside].T
        seen = view.pixels[y, x].astype(float)
        differences.append(np.abs(seen - scene.points.colors[ahead][inside]).mean(axis=1))
    return float((np.concatenate(differences) < 20).mean())


@pytest.mark.parametrize(
    ("name", "kind", "views", "size", "least"),
    [
        ("statue", "llff", 29, (378, 504), 0.75),
        # Points behind the bear and the can are hidden in many views and still projected.
        ("bear", "nerfstudio", 96, (512, 512), 0.42),
        ("can", "colmap", 71, (1280, 720), 0.5),
    ],
)
def test_points_meet_their_colors(name, kind, views, size, least):
    scene = load_scene(CAPTURES / name)
    assert scene.kind == kind and scene.notes == ()
    assert len(scene.views) + len(scene.test_views) == views
    assert all(view.pixels.shape[:2] == size for view in scene.views)
    agreement = color_agreement(scene)
    assert agreement > least
    for shift in ((-2, 0), (2, 0), (0, -2), (0, 2)):
        assert color_agreement(scene, shift) < agreement - 0.02


def test_masks_of_the_statue():
    scene = load_scene(CAPTURES / "statue", image_scale=0.5)
    assert scene.views[0].pixels.shape == (189, 252, 3)
    assert all(0.02 < view.mask.mean() < 0.3 for view in [*scene.views, *scene.test_views])
