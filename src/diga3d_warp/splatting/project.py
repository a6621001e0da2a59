"""Differentiable projection of gaussians into a camera."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch

from diga3d_warp.config import POSE_GROUP, SPLATTING, Accuracy, Effects
from diga3d_warp.kernels import projection
from diga3d_warp.kernels.footprint import Projecting
from diga3d_warp.kernels.splats import Splats
from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.arrays import vector_arrays
from diga3d_warp.splatting.optics import Optics, optics_of


class Projection(NamedTuple):
    """Gaussians in the image plane; rows of gaussians that no pixel shows are exact zeros.

    Attributes:
        centers: Pixel positions, shape (N, 2).
        depths: z along the camera axis [scene units], shape (N,).
        factors: Cholesky factors L of the inverse covariances L L^T, lower triangular, as (l11, l21, l22)
            [px^-1], shape (N, 3).
        extents: Half width and height of the box to draw [px], shape (N, 2). Carries no gradient; (0, 0)
            for a culled gaussian.
        opacities: Peak opacity, shape (N,).
        depth_slopes: Change of depth over the image [scene units / px], shape (N, 2), where asked for:
            on the ray of a pixel, the gaussian's response is largest at depth
            `depths + depth_slopes . (pixel - centers)`.
    """

    centers: torch.Tensor
    depths: torch.Tensor
    factors: torch.Tensor
    extents: torch.Tensor
    opacities: torch.Tensor
    depth_slopes: torch.Tensor | None = None

    @property
    def visible(self) -> torch.Tensor:
        """Which gaussians the image may show, shape (N,), bool; all others are culled.

        A visible gaussian lies in front of the camera and its box touches the image. It may still be hidden
        behind others.
        """
        return self.extents[:, 0] > 0.0

    @property
    def tensors(self) -> list[torch.Tensor]:
        """All of them in order, without slopes where there are none."""
        return [tensor for tensor in self if tensor is not None]


def project(
    means: torch.Tensor,
    log_scales: torch.Tensor,
    quaternions: torch.Tensor,
    opacity_logits: torch.Tensor,
    camera: Camera,
    *,
    accuracy: Accuracy = Accuracy.STANDARD,
    effects: Effects = Effects(),
) -> Projection:
    """Project gaussians into a camera (Zwicker et al. 2001, EWA splatting; 3DGS's conventions).

    Gradients reach means, scales, quaternions, opacities, `camera.world_to_camera` and `camera.intrinsics`.
    All results are in the accuracy's precision. Gaussians behind the camera, outside the image or with broken
    numbers are culled.

    The slope of depth is cov(z, pixel) Sigma'^-1: the affine camera makes (pixel, z) jointly gaussian, and
    the largest response along a ray is at the mean of z given the pixel.

    Kernels draw from depth `Splatting.near` on. A camera with another near plane projects in a world that is
    scaled by the ratio of the two; only depths differ there.

    Args:
        means: World positions [scene units], shape (N, 3).
        log_scales: Logarithms of the standard deviations, shape (N, 3).
        quaternions: Rotations (w, x, y, z), any length above 1e-4, shape (N, 4).
        opacity_logits: shape (N,).
        camera: With or without lens distortion.
        accuracy: Decides `alpha_min`, `extent`, `footprint`, `precision` and, by `pixel_order`, whether there
            are slopes of depth.
        effects: `lens` off makes the camera a pinhole; `antialias` scales opacity by what the low-pass
            widens; `pixel_order` as in the accuracy.
    """
    if not effects.lens:
        camera = camera.without_lens()
    optics = optics_of(camera)
    kind = Projecting.of(optics.lens_kind, accuracy, effects)
    dtype = getattr(torch, accuracy.precision)
    parameters = [tensor.to(dtype) for tensor in (means, log_scales, quaternions, opacity_logits)]
    unit = camera.near / SPLATTING.near
    poses, intrinsics = camera_rows(camera, parameters[0], unit)
    projection = Projection(*_Project.apply(*parameters, poses, intrinsics, optics, kind))
    return projection if unit == 1.0 else _with_depth_unit(projection, unit)


def camera_rows(camera: Camera, means: torch.Tensor, unit: float = 1.0) -> tuple[torch.Tensor, torch.Tensor]:
    """Pose (G, 4, 4) and intrinsics (G, 4), one row for each group of gaussians, in the type of `means`.

    Rows are equal; torch adds up their gradients. Camera space is measured in `unit` [scene units].
    """
    groups = group_count(means)
    pose, intrinsics = camera.world_to_camera, camera.intrinsics.to(means)
    if unit != 1.0:
        pose = pose / pose.new_tensor([[unit], [unit], [unit], [1.0]])
    pose = pose.to(means)
    return pose.expand(groups, 4, 4), intrinsics.expand(groups, 4)


def _with_depth_unit(projection: Projection, unit: float) -> Projection:
    """The projection with depths in scene units, from depths in `unit` of them."""
    slopes = projection.depth_slopes
    return projection._replace(
        depths=projection.depths * unit, depth_slopes=None if slopes is None else slopes * unit
    )


def group_count(means: torch.Tensor) -> int:
    """Rows of the camera that N gaussians (N, 3) need."""
    return max(1, -(-len(means) // POSE_GROUP))


class _Project(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx, means, log_scales, quaternions, opacity_logits, poses, intrinsics, optics: Optics,
        kind: Projecting,
    ):  # fmt: skip
        inputs = tuple(
            tensor.detach().contiguous()
            for tensor in (means, log_scales, quaternions, opacity_logits, poses, intrinsics)
        )
        tails = [(2,), (), (3,), (2,), (), *([(2,)] if kind.slopes else [])]
        outputs = Projection(*(means.new_empty((len(means), *tail)) for tail in tails))
        projection.project(kind, _parameters(inputs), optics, Splats(*vector_arrays(outputs.tensors)))
        ctx.save_for_backward(*inputs, outputs.extents)
        ctx.optics, ctx.kind = optics, kind
        ctx.mark_non_differentiable(outputs.extents)
        return tuple(outputs.tensors)

    @staticmethod
    def backward(ctx, *adj_outputs):
        *inputs, extents = ctx.saved_tensors
        of_gaussians, of_camera = inputs[:4], inputs[4:]
        adj_inputs = (*map(torch.empty_like, of_gaussians), *map(torch.zeros_like, of_camera))
        adj_projection = Projection(*(gradient.contiguous() for gradient in adj_outputs))
        (of_extents,) = vector_arrays([extents])
        projection.project_adjoint(
            ctx.kind, _parameters(inputs), ctx.optics, of_extents,
            Splats(*vector_arrays(adj_projection.tensors)), _parameters(adj_inputs),
        )  # fmt: skip
        return *adj_inputs, None, None


def _parameters(tensors: Sequence[torch.Tensor]) -> projection.Parameters:
    return projection.Parameters(*vector_arrays(tensors))
