"""Differentiable view-dependent colours from spherical harmonics."""

from __future__ import annotations

import torch
import warp as wp

from diga3d_warp.kernels import harmonics
from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.arrays import like, warp_array
from diga3d_warp.splatting.project import camera_rows

MAX_DEGREE = 3


def degree_of(sh: torch.Tensor) -> int:
    """Degree of coefficients of shape (N, K, 3): K is 1, 4, 9 or 16.

    Raises:
        ValueError: K is none of these.
    """
    degrees = {(degree + 1) ** 2: degree for degree in range(MAX_DEGREE + 1)}
    if sh.ndim != 3 or sh.shape[2] != 3 or sh.shape[1] not in degrees:
        raise ValueError(f"spherical harmonics must have shape (N, 1 | 4 | 9 | 16, 3), not {tuple(sh.shape)}")
    return degrees[sh.shape[1]]


def shade(
    means: torch.Tensor, sh: torch.Tensor, extents: torch.Tensor, camera: Camera, degree: int
) -> torch.Tensor:
    """Colours max(0, 0.5 + SH(direction)) of gaussians seen from a camera, shape (N, 3).

    Gradients reach means, coefficients and `camera.world_to_camera`. Culled gaussians get zeros.

    Args:
        means: World positions, shape (N, 3).
        sh: Coefficients, shape (N, K, 3), in the order of the 3DGS .ply.
        extents: From `project`, shape (N, 2).
        camera: Where the gaussians are seen from.
        degree: Highest degree to evaluate, at most that of `sh`.
    """
    poses, _ = camera_rows(camera, means)
    eyes = -(poses[:, :3, :3].transpose(1, 2) @ poses[:, :3, 3:])[..., 0]
    return _Shade.apply(means, sh, eyes, extents, degree)


class _Shade(torch.autograd.Function):
    @staticmethod
    def forward(ctx, means, sh, eyes, extents, degree: int):
        inputs = tuple(tensor.detach().contiguous() for tensor in (means, sh, eyes, extents))
        colors = torch.zeros_like(inputs[0])
        harmonics.shade(
            degree, len(means), _arrays(inputs), [warp_array(colors, wp.vec3)], device=_device(means)
        )
        ctx.save_for_backward(*inputs, colors)
        ctx.degree = degree
        return colors

    @staticmethod
    def backward(ctx, adj_colors):
        *inputs, colors = ctx.saved_tensors
        adj_means, adj_sh, adj_eyes = (torch.zeros_like(tensor) for tensor in inputs[:3])
        harmonics.shade_adjoint(
            ctx.degree,
            len(colors),
            _arrays(inputs),
            [warp_array(colors, wp.vec3)],
            [
                warp_array(adj_means, wp.vec3),
                warp_array(adj_sh, wp.vec3),
                warp_array(adj_eyes, wp.vec3),
                None,
            ],
            [warp_array(like(adj_colors, colors), wp.vec3)],
            device=_device(colors),
        )
        return adj_means, adj_sh, adj_eyes, None, None


def _arrays(inputs) -> list[wp.array]:
    dtypes = (wp.vec3, wp.vec3, wp.vec3, wp.vec2)
    return [warp_array(tensor, dtype) for tensor, dtype in zip(inputs, dtypes, strict=True)]


def _device(tensor: torch.Tensor) -> wp.Device:
    return wp.device_from_torch(tensor.device)
