"""Cameras whose numbers the renderer could not multiply are refused in one line."""

import pytest
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.scene.camera import Camera, Distortion

GOOD = {"width": 40, "height": 30, "fx": 35.0, "fy": 35.0, "cx": 20.0, "cy": 15.0}


def pose(z: float = 0.0) -> torch.Tensor:
    matrix = torch.eye(4, dtype=torch.float64)
    matrix[2, 3] = z
    return matrix


@pytest.mark.parametrize(
    "changes,why",
    [
        ({"fx": float("nan")}, "not finite"),
        ({"cy": float("inf")}, "not finite"),
        ({"width": 0}, "sees nothing"),
        ({"height": 10**30}, "no image has"),
        ({"fy": -35.0}, "sees nothing"),
        ({"fx": 1e7}, "within 1e\\+06 px"),
        ({"fy": 1e-7}, "above 1e-06 px"),
        ({"cx": -1e7}, "within 1e\\+06 px"),
        ({"world_to_camera": pose(float("nan"))}, "not finite"),
        ({"world_to_camera": pose(1e15)}, "scale the scene down"),
        ({"world_to_camera": torch.eye(3)}, r"shape \(4, 4\)"),
    ],
)
def test_absurd_cameras_are_refused(changes, why):
    camera = Camera(**{**GOOD, "world_to_camera": pose(9e14)})
    assert camera.pose[2, 3] == 9e14
    with pytest.raises(InputError, match=why) as caught:
        Camera(**{**GOOD, "world_to_camera": pose(), **changes})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("coefficients", [(0.1, 0.2, 0.3), (101.0, 0, 0, 0), (0, 0, float("nan"), 0)])
def test_absurd_lenses_are_refused(coefficients):
    with pytest.raises(InputError, match="brown lens must be 4 numbers up to 100"):
        Distortion("brown", coefficients)
    with pytest.raises(InputError, match="brown5 lens must be 5 numbers up to 100"):
        Distortion("brown5", coefficients)


def test_the_shortest_brown_lens_is_taken():
    assert Distortion.brown(0.0, 0.0, 0.0, 0.0) is None
    assert Distortion.brown(0.1, 0.0, 0.0, 0.2) == Distortion("brown", (0.1, 0.0, 0.0, 0.2))
    assert Distortion.brown(0.1, 0.2, 0.0, 0.0, 0.3) == Distortion("brown5", (0.1, 0.2, 0.0, 0.0, 0.3))


def test_intrinsics_keep_their_gradient_through_other_changes():
    intrinsics = torch.tensor([35.0, 36.0, 20.0, 15.0], requires_grad=True)
    camera = Camera(**GOOD, world_to_camera=pose(), distortion=Distortion("brown", (0.1, 0.0, 0.0, 0.0)))
    changed = camera.with_intrinsics(intrinsics).with_pose(pose(2.0)).without_lens().resized(20, 60)
    assert (changed.fx, changed.fy, changed.cx, changed.cy) == (17.5, 72.0, 10.0, 30.0)
    assert changed.pose[2, 3] == 2.0 and changed.distortion is None
    changed.intrinsics.sum().backward()
    assert torch.equal(intrinsics.grad, torch.tensor([0.5, 2.0, 0.5, 2.0]))
    assert camera.intrinsics.tolist() == [35.0, 35.0, 20.0, 15.0]


@pytest.mark.parametrize(
    "intrinsics,why",
    [([35.0, 35.0, 20.0], r"not of shape \(3,\)"), ([35.0, -1.0, 20.0, 15.0], "sees nothing"),
     ([float("nan"), 35.0, 20.0, 15.0], "not finite")],
)  # fmt: skip
def test_absurd_intrinsics_are_refused(intrinsics, why):
    with pytest.raises(InputError, match=why):
        Camera(**GOOD, world_to_camera=pose()).with_intrinsics(torch.tensor(intrinsics))


@pytest.mark.parametrize(("side", "size"), [(1000, (640, 480)), (160, (160, 120)), (1, (1, 1))])
def test_a_camera_for_smaller_images_keeps_its_field_of_view(side, size):
    camera = Camera(640, 480, 500.0, 500.0, 320.0, 240.0, torch.eye(4))
    small = camera.within(side)
    assert (small.width, small.height) == size
    assert small.fx / small.width == pytest.approx(500.0 / 640.0)
