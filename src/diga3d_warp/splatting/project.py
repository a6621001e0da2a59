"""Differentiable EWA projection of gaussians into a camera."""

from __future__ import annotations

from typing import NamedTuple

import torch
import warp as wp

from diga3d_warp.config import POSE_GROUP
from diga3d_warp.kernels import projection
from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.arrays import like, warp_array
from diga3d_warp.splatting.optics import Optics, optics_of

_INPUTS = (wp.vec3, wp.vec3, wp.vec4, wp.float32, wp.mat44, wp.vec4)
_OUTPUTS = (wp.vec2, wp.float32, wp.vec3, wp.vec2, wp.float32)


class Projection(NamedTuple):
    """Gaussians in the image plane; rows of culled gaussians are exact zeros.

    Attributes:
        centers: Pixel positions, shape (N, 2).
        depths: z along the camera axis [scene units], shape (N,).
        conics: Inverse covariance (xx, xy, yy) [px^-2], shape (N, 3).
        extents: Half width and height of the box in which alpha reaches 1/255 [px], shape (N, 2). Carries no
            gradient; (0, 0) marks a culled gaussian.
        opacities: Peak opacity, shape (N,).
    """

    centers: torch.Tensor
    depths: torch.Tensor
    conics: torch.Tensor
    extents: torch.Tensor
    opacities: torch.Tensor


def project(
    means: torch.Tensor,
    log_scales: torch.Tensor,
    quaternions: torch.Tensor,
    opacity_logits: torch.Tensor,
    camera: Camera,
) -> Projection:
    """Project gaussians into a camera (Zwicker et al. 2001, EWA splatting; 3DGS's conventions).

    Gradients reach means, scales, quaternions, opacities and `camera.world_to_camera`.

    Args:
        means: World positions [scene units], shape (N, 3), float32.
        log_scales: Logarithms of the standard deviations, shape (N, 3).
        quaternions: Rotations (w, x, y, z), any length above 1e-4, shape (N, 4).
        opacity_logits: shape (N,).
        camera: With or without lens distortion.
    """
    return Projection(
        *_Project.apply(
            means, log_scales, quaternions, opacity_logits, *camera_rows(camera, means), optics_of(camera)
        )
    )


def camera_rows(camera: Camera, means: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Pose (G, 4, 4) and intrinsics (G, 4), one row for each group of gaussians.

    Rows are equal; torch adds up their gradients.
    """
    groups = max(1, -(-len(means) // POSE_GROUP))
    pose = camera.world_to_camera.to(means)
    intrinsics = means.new_tensor([camera.fx, camera.fy, camera.cx, camera.cy])
    return pose.expand(groups, 4, 4), intrinsics.expand(groups, 4)


class _Project(torch.autograd.Function):
    @staticmethod
    def forward(ctx, means, log_scales, quaternions, opacity_logits, poses, intrinsics, optics: Optics):
        inputs = tuple(
            tensor.detach().contiguous()
            for tensor in (means, log_scales, quaternions, opacity_logits, poses, intrinsics)
        )
        count = len(means)
        outputs = tuple(means.new_zeros((count, *tail)) for tail in ((2,), (), (3,), (2,), ()))
        projection.project(
            optics.lens_kind,
            count,
            _arguments(inputs, optics),
            _arrays(outputs, _OUTPUTS),
            device=_device(means),
        )
        ctx.save_for_backward(*inputs, *outputs)
        ctx.optics = optics
        ctx.mark_non_differentiable(outputs[3])
        return outputs

    @staticmethod
    def backward(ctx, adj_centers, adj_depths, adj_conics, adj_extents, adj_opacities):
        inputs, outputs = ctx.saved_tensors[:6], ctx.saved_tensors[6:]
        adj_inputs = tuple(torch.zeros_like(tensor) for tensor in inputs)
        given = (adj_centers, adj_depths, adj_conics, None, adj_opacities)
        adj_outputs = tuple(like(grad, output) for grad, output in zip(given, outputs, strict=True))
        projection.project_adjoint(
            ctx.optics.lens_kind,
            len(inputs[0]),
            _arguments(inputs, ctx.optics),
            _arrays(outputs, _OUTPUTS),
            [*_arrays(adj_inputs, _INPUTS), wp.vec4(), wp.vec2(), wp.vec2(), 0.0],
            _arrays(adj_outputs, _OUTPUTS),
            device=_device(inputs[0]),
        )
        return *adj_inputs, None


def _arrays(tensors, dtypes) -> list[wp.array]:
    return [warp_array(tensor, dtype) for tensor, dtype in zip(tensors, dtypes, strict=True)]


def _arguments(inputs: tuple[torch.Tensor, ...], optics: Optics) -> list:
    return [
        *_arrays(inputs, _INPUTS),
        wp.vec4(*optics.coefficients),
        wp.vec2(*optics.lower),
        wp.vec2(*optics.upper),
        optics.radius_max,
    ]


def _device(tensor: torch.Tensor) -> wp.Device:
    return wp.device_from_torch(tensor.device)
