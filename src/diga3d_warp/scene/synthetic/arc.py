"""Where the cameras of a synthetic capture stand: an arc around the object, all looking at it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from diga3d_warp.scene.camera import Camera, look_at


@dataclass(frozen=True)
class Arc:
    """The arc.

    Attributes:
        half_angle: Largest turn to either side [degrees]; further, the open front would come into view.
        distance: From the object's axis [m]; makes the object 5 to 12 % of the image.
        height: Of the middle of the arc [m], eye height of a crouching person.
        distance_swing, height_swing: How far cameras leave the middle of the arc [m], so that what stands
            behind the object is seen over and beside it.
        jitter: Random displacement of eye and target [m], deviation.
        target: What the cameras look at [m]: the upper half of the object, a little behind it.
        field_of_view: Horizontal [degrees], that of a phone camera.
    """

    half_angle: float = 48.0
    distance: float = 2.05
    height: float = 1.2
    distance_swing: float = 0.15
    height_swing: float = 0.4
    jitter: float = 0.02
    target: tuple[float, float, float] = (0.0, 0.12, 0.46)
    field_of_view: float = 64.0


ARC = Arc()


def arc_cameras(width: int, height: int, views: int, seed: int) -> dict[str, Camera]:
    """Pinhole cameras by view name, from the left end of the arc to the right.

    Args:
        width, height: Image size [px].
        views: Number of cameras.
        seed: Of the jitter.
    """
    rng = np.random.default_rng([seed, 2])
    focal = 0.5 * width / np.tan(np.radians(ARC.field_of_view / 2))
    cameras = {}
    for number, share in enumerate(np.linspace(-1, 1, views)):
        angle = np.radians(ARC.half_angle) * share
        # Two frequencies that never meet: neighbours on the arc differ in height and distance.
        distance = ARC.distance + ARC.distance_swing * np.sin(1.7 * number)
        rise = ARC.height + ARC.height_swing * np.sin(2.4 * number)
        eye = np.array([distance * np.sin(angle), -distance * np.cos(angle), rise])
        shake = ARC.jitter * rng.standard_normal((2, 3))
        pose = look_at(eye + shake[0], np.array(ARC.target) + shake[1])
        camera = Camera(width, height, focal, focal, width / 2, height / 2, torch.from_numpy(pose))
        cameras[f"view_{number:03d}"] = camera
    return cameras
