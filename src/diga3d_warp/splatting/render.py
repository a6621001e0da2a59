"""Render gaussians: project, shade, composite."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import torch

from diga3d_warp.config import Accuracy, Effects
from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.composite import composite
from diga3d_warp.splatting.normals import orient
from diga3d_warp.splatting.project import Projection, project
from diga3d_warp.splatting.shade import degree_of, shade

if TYPE_CHECKING:
    from diga3d_warp.gaussians.representation import Representation


class Rendering(NamedTuple):
    """A rendered view.

    Attributes:
        color: RGB over the background, shape (H, W, 3). Can exceed 1 where colours do.
        alpha: Opacity of each pixel in [0, 1], shape (H, W).
        depth: Expected z along the camera axis [scene units], shape (H, W); 0 where nothing was drawn.
        projection: Gaussians in the image plane; `projection.visible` tells which it may show.
        median_depth: Depth of the gaussian at which transmittance falls below a half [scene units], 0 where
            it never does, shape (H, W); None where the effect is off.
        normals: Mean of the gaussians' normals by weight, in camera space, shape (H, W, 3); shorter than 1
            where they differ, 0 where nothing was drawn. None where the effect is off.
    """

    color: torch.Tensor
    alpha: torch.Tensor
    depth: torch.Tensor
    projection: Projection
    median_depth: torch.Tensor | None = None
    normals: torch.Tensor | None = None


def render(
    scene: Representation,
    camera: Camera,
    *,
    effects: Effects = Effects(),
    accuracy: Accuracy = Accuracy.STANDARD,
    background: Sequence[float] | torch.Tensor = (0.0, 0.0, 0.0),
) -> Rendering:
    """Render gaussians, or anchors that decode to gaussians, from a camera.

    Gradients reach every parameter of the gaussians, the background, `camera.world_to_camera` and
    `camera.intrinsics`. Results are in the accuracy's precision.

    Kernels hold positions as float32. Means in float64, as `Gaussians.load_ply` returns them for coordinates
    that float32 cannot hold, are taken relative to the camera first, in float64. Float32 means far from the
    origin were rounded before: shift such a scene to the origin.

    Args:
        scene: N gaussians, on CPU or CUDA, or anchors. The projection's rows are the gaussians of
            `scene.seen_from(camera)`.
        camera: Pinhole or with lens distortion, which is applied inside the projection.
        effects: Effects to simulate; those that are off cost nothing. Without depth, `depth` is zero.
        accuracy: Accuracy settings. Images have the gaussians' type, whatever the kernels' precision.
        background: RGB behind all gaussians, three numbers or a tensor of shape (3,); not read where the
            effect is off.

    Raises:
        ValueError: the coefficients' shape is not one of degree 0 to 3.
    """
    gaussians = scene.seen_from(camera)
    degree = degree_of(gaussians.sh)
    if effects.sh_degree is not None:
        degree = min(degree, effects.sh_degree)
    means, camera = near_origin(gaussians.means, camera, accuracy)
    projection = project(
        means, gaussians.log_scales, gaussians.quaternions, gaussians.opacity_logits, camera,
        accuracy=accuracy, effects=effects,
    )  # fmt: skip
    colors = shade(means, gaussians.sh, projection.extents, camera, degree)
    facing = None
    if effects.normals:
        facing = orient(means, gaussians.log_scales, gaussians.quaternions, projection.extents, camera)
    blended = composite(
        projection, colors, camera.width, camera.height, accuracy=accuracy, effects=effects,
        normals=facing, median_depth=effects.median_depth,
    )  # fmt: skip
    color = blended.color
    if effects.background:
        behind = torch.as_tensor(background, dtype=color.dtype, device=color.device)
        color = color + blended.transmittance[..., None] * behind
    alpha = 1.0 - blended.transmittance
    # alpha is 0 or at least alpha_min: the floor only replaces a division of 0 by 0.
    weight = alpha.clamp_min(0.5 * accuracy.alpha_min)
    depth = blended.depth_sum / weight
    normals = None if blended.normal_sum is None else blended.normal_sum / weight[..., None]
    own = gaussians.sh.dtype
    median_depth = blended.median_depth
    return Rendering(
        color.to(own), alpha.to(own), depth.to(own), projection,
        None if median_depth is None else median_depth.to(own), None if normals is None else normals.to(own),
    )  # fmt: skip


def near_origin(means: torch.Tensor, camera: Camera, accuracy: Accuracy) -> tuple[torch.Tensor, Camera]:
    """Means and camera as float32 kernels take them: float64 means relative to the camera's centre.

    Args:
        means: World positions [scene units], shape (N, 3).
        camera: Where they are seen from.
        accuracy: Kernels in float64 take everything as it is.
    """
    if means.dtype != torch.float64 or accuracy.precision == "float64":
        return means, camera
    center = camera.center
    return means - torch.from_numpy(center).to(means), camera.relative_to(center)
