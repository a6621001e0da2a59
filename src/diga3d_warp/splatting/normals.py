"""Differentiable normals of gaussians."""

from __future__ import annotations

import torch

from diga3d_warp.kernels import normals
from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.arrays import vector_arrays
from diga3d_warp.splatting.project import camera_rows


def orient(
    means: torch.Tensor,
    log_scales: torch.Tensor,
    quaternions: torch.Tensor,
    extents: torch.Tensor,
    camera: Camera,
) -> torch.Tensor:
    """Normals of gaussians in camera space, turned to the camera, shape (N, 3).

    The normal is the shortest axis, of unit length; culled gaussians get zeros. Gradients reach quaternions
    and `camera.world_to_camera`. Computed in the precision of the extents.

    Args:
        means: World positions, shape (N, 3).
        log_scales: Logarithms of the standard deviations, shape (N, 3).
        quaternions: Rotations (w, x, y, z), shape (N, 4).
        extents: From `project`, shape (N, 2), float32 or float64.
        camera: Where the gaussians are seen from.
    """
    means = means.to(extents)
    poses, _ = camera_rows(camera, means)
    return _Orient.apply(means, log_scales.to(extents), quaternions.to(extents), poses, extents)


class _Orient(torch.autograd.Function):
    @staticmethod
    def forward(ctx, means, log_scales, quaternions, poses, extents):
        inputs = tuple(t.detach().contiguous() for t in (means, log_scales, quaternions, poses, extents))
        directions = torch.empty_like(inputs[0])
        normals.orient(*vector_arrays([*inputs, directions]))
        ctx.save_for_backward(*inputs)
        return directions

    @staticmethod
    def backward(ctx, adj_directions):
        inputs = ctx.saved_tensors
        adj_quaternions, adj_poses = torch.empty_like(inputs[2]), torch.zeros_like(inputs[3])
        normals.orient_adjoint(
            *vector_arrays([*inputs, adj_directions.contiguous(), adj_quaternions, adj_poses])
        )
        return None, None, adj_quaternions, adj_poses, None
