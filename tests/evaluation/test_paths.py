"""Camera paths: smooth, through the views, rigid, and without a jump where the video loops."""

import numpy as np
import pytest
import torch

from diga3d_warp.evaluation.paths import fly_through
from diga3d_warp.scene.camera import Camera, Distortion, look_at


def camera(eye, target=(0.0, 0.0, 0.0)) -> Camera:
    pose = torch.from_numpy(look_at(np.asarray(eye, float), np.asarray(target, float)))
    return Camera(64, 48, 70.0, 70.0, 32.0, 24.0, pose, Distortion("brown", (0.1, 0.0, 0.0, 0.0)))


def ring(count, span=2 * np.pi):
    angles = np.arange(count) * span / count
    return [camera([3 * np.cos(a), 3 * np.sin(a), 1.0]) for a in angles]


def assert_smooth(path):
    """Rigid, and no step more than a few times the mean, the one from last to first included."""
    poses = np.stack([frame.pose for frame in path])
    rotations = poses[:, :3, :3]
    np.testing.assert_allclose(
        rotations @ rotations.transpose(0, 2, 1), np.tile(np.eye(3), (len(path), 1, 1)), atol=1e-9
    )
    np.testing.assert_allclose(np.linalg.det(rotations), 1.0, atol=1e-9)
    centers = np.stack([frame.center for frame in path])
    steps = np.linalg.norm(np.roll(centers, -1, 0) - centers, axis=1)
    assert steps.max() < 3 * steps.mean()
    turns = np.linalg.norm(np.roll(rotations, -1, 0) - rotations, axis=(1, 2))
    assert turns.max() < 3 * turns.mean() + 1e-6


def test_ring_is_a_loop():
    path = fly_through(ring(12), 120)
    assert len(path) == 120
    assert_smooth(path)
    centers = np.stack([frame.center for frame in path])
    np.testing.assert_allclose(np.linalg.norm(centers[:, :2], axis=1), 3.0, atol=0.02)
    for frame in path:
        toward = -frame.center / np.linalg.norm(frame.center)
        assert frame.forward @ toward > 0.999, "still looks at the centre between the views"


def test_arc_goes_there_and_back():
    views = ring(12, span=np.pi / 2)
    path = fly_through(views, 60)
    assert_smooth(path)
    np.testing.assert_allclose(path[0].pose, views[0].pose, atol=1e-9)
    np.testing.assert_allclose(path[30].pose, views[-1].pose, atol=1e-9)
    np.testing.assert_allclose(path[10].pose, path[50].pose, atol=1e-9)


def test_long_capture_is_thinned():
    generator = np.random.default_rng(0)
    views = [camera(view.center + generator.normal(0, 0.02, 3)) for view in ring(200)]
    assert_smooth(fly_through(views, 240))


@pytest.mark.parametrize(
    "views",
    [
        pytest.param([camera([3, 0, 1])], id="one view"),
        pytest.param([camera([3, 0, 1])] * 4, id="one view several times"),
        pytest.param([camera([3, 0, 1]), camera([3, 0, 1], (6, 0, 1.0))], id="looking back"),
        pytest.param(ring(2), id="two views"),
    ],
)
def test_degenerate_captures_still_give_cameras(views):
    path = fly_through(views, 10)
    assert len(path) == 10
    for frame in path:
        rotation = frame.pose[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
        assert (frame.width, frame.height, frame.fx, frame.distortion) == (64, 48, 70.0, None)
