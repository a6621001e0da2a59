"""Differentiable view-dependent colours from spherical harmonics."""

from __future__ import annotations

import torch

from diga3d_warp.kernels import harmonics
from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.arrays import vector_arrays
from diga3d_warp.splatting.project import group_count

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


def coefficient_count(degree: int | None) -> int:
    """Coefficients per channel of harmonics up to a degree, 3 if None."""
    return ((MAX_DEGREE if degree is None else degree) + 1) ** 2


def shade(
    means: torch.Tensor, sh: torch.Tensor, extents: torch.Tensor, camera: Camera, degree: int
) -> torch.Tensor:
    """Colours max(0, 0.5 + SH(direction)) of gaussians seen from a camera, shape (N, 3).

    Gradients reach means, coefficients and `camera.world_to_camera`, the first and the last through the
    direction too. Culled gaussians get zeros. Computed in the precision of the extents.

    Args:
        means: World positions, shape (N, 3).
        sh: Coefficients, shape (N, K, 3), in the order of the 3DGS .ply.
        extents: From `project`, shape (N, 2), float32 or float64.
        camera: Where the gaussians are seen from.
        degree: Highest degree to evaluate, at most that of `sh`.
    """
    pose = camera.world_to_camera
    eye = (-pose[:3, :3].T @ pose[:3, 3]).to(extents)
    eyes = eye.expand(group_count(means), 3)
    return _Shade.apply(means.to(extents), sh.to(extents), eyes, extents, degree)


class _Shade(torch.autograd.Function):
    @staticmethod
    def forward(ctx, means, sh, eyes, extents, degree: int):
        means, sh, eyes, extents = (t.detach().contiguous() for t in (means, sh, eyes, extents))
        colors = torch.empty_like(means)
        of_means, flat, of_eyes, of_extents, of_colors = vector_arrays(
            [means, sh.view(-1), eyes, extents, colors]
        )
        harmonics.shade(degree, of_means, flat, sh.shape[1], of_eyes, of_extents, of_colors)
        ctx.save_for_backward(means, sh, eyes, colors)
        ctx.degree = degree
        return colors

    @staticmethod
    def backward(ctx, adj_colors):
        means, sh, eyes, colors = ctx.saved_tensors
        # Coefficients above the degree are not written.
        fresh = torch.empty_like if sh.shape[1] == coefficient_count(ctx.degree) else torch.zeros_like
        adj_means, adj_sh, adj_eyes = torch.empty_like(means), fresh(sh), torch.zeros_like(eyes)
        of_means, flat, *others = vector_arrays(
            [
                means, sh.view(-1), eyes, colors, adj_colors.contiguous(), adj_means, adj_sh.view(-1),
                adj_eyes,
            ]
        )  # fmt: skip
        harmonics.shade_adjoint(ctx.degree, of_means, flat, sh.shape[1], *others)
        return adj_means, adj_sh, adj_eyes, None, None
