"""What a plane would show of an object if it were a mirror."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from diga3d_warp.config import Effects
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.gaussians.representation import Representation
from diga3d_warp.materials.painting import GAMMA
from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.composite import composite
from diga3d_warp.splatting.project import project
from diga3d_warp.splatting.shade import degree_of, shade
from diga3d_warp.surfaces.chart import Frame


@dataclass(frozen=True, eq=False)
class Reflection:
    """The mirror image of an object in one view.

    Attributes:
        color: Linear colour times `cover`, shape (H, W, 3), float32.
        cover: Part of each pixel that the mirrored object takes, shape (H, W), float32 in [0, 1].
    """

    color: np.ndarray
    cover: np.ndarray


@dataclass(frozen=True)
class Placing:
    """A place of the mirrored object: the true one, or another that chance may favour.

    Attributes:
        stretch: Its depth under the plane, against the object's height [ratio].
        shift: Its displacement along the plane, across and down [scene units].
    """

    stretch: float = 1.0
    shift: tuple[float, float] = (0.0, 0.0)


MIRROR = Placing()
"""Where a mirror shows it."""


def mirrored(gaussians: Gaussians, frame: Frame, placing: Placing = MIRROR) -> Gaussians:
    """Gaussians on the other side of a plane; their colours are still those of the object's own sides.

    Args:
        gaussians: N gaussians.
        frame: On the plane.
        placing: Where to put them.
    """
    axes, normal = (torch.from_numpy(np.ascontiguousarray(part)) for part in (frame.axes, frame.axes[2]))
    means = gaussians.means.double()
    height = (means - torch.from_numpy(frame.origin)) @ normal
    means = means - (1.0 + placing.stretch) * height[:, None] * normal
    means = means + placing.shift[0] * axes[0] + placing.shift[1] * axes[1]
    return replace(
        gaussians.detached(),
        means=means.to(gaussians.means),
        quaternions=_reflected(gaussians.quaternions, normal),
    )


def _reflected(quaternions: torch.Tensor, normal: torch.Tensor) -> torch.Tensor:
    """Rotations (w, x, y, z) of reflected gaussians.

    A reflection is a half turn about the normal and an inversion, and an inversion changes no gaussian.
    """
    w, vector = quaternions[:, :1], quaternions[:, 1:]
    n = normal.to(quaternions)
    # The quaternion (0, n) of the half turn, times the gaussian's.
    return torch.cat([-(vector @ n)[:, None], w * n + torch.linalg.cross(n.expand_as(vector), vector)], dim=1)


def reflection(
    thing: Representation, camera: Camera, frame: Frame, effects: Effects, placing: Placing = MIRROR
) -> Reflection:
    """The mirror image of an object in one view, over nothing.

    Args:
        thing: The object.
        camera: Where from.
        frame: On the plane.
        effects: With which gaussians are rendered.
        placing: Where the mirrored object is put.
    """
    # A mirror shows the sides that are seen from the mirrored camera.
    opposite = _opposite(camera, frame)
    gaussians = thing.seen_from(opposite)
    below = mirrored(gaussians, frame, placing)
    plain = replace(effects, depth=False, median_depth=False, normals=False)
    with torch.no_grad():
        projection = project(
            below.means, below.log_scales, below.quaternions, below.opacity_logits, camera, effects=plain
        )
        degree = degree_of(gaussians.sh) if effects.sh_degree is None else effects.sh_degree
        degree = min(degree, degree_of(gaussians.sh))
        colors = shade(gaussians.means, gaussians.sh, projection.extents, opposite, degree)
        linear = colors.clamp(0.0, 1.0) ** GAMMA
        blended = composite(projection, linear, camera.width, camera.height, effects=plain)
    return Reflection(blended.color.numpy(), 1.0 - blended.transmittance.numpy())


def _opposite(camera: Camera, frame: Frame) -> Camera:
    """A camera whose centre lies on the other side of the plane; it looks as the first."""
    center = camera.center
    center = center - 2.0 * frame.axes[2] * ((center - frame.origin) @ frame.axes[2])
    pose = camera.pose.copy()
    pose[:3, 3] = -pose[:3, :3] @ center
    return replace(camera, world_to_camera=torch.from_numpy(pose))
