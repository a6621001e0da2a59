"""Differentiable view-dependent colours from spherical harmonics."""

from __future__ import annotations

import torch

from diga3d_warp.kernels import harmonics
from diga3d_warp.kernels.precision import types_of
from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.arrays import REALS, device_of, precision_of, warp_array, warp_arrays
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
        inputs = tuple(tensor.detach().contiguous() for tensor in (means, sh, eyes, extents))
        colors = torch.empty_like(inputs[0])
        real = REALS[colors.dtype]
        vec2, vec3 = types_of(real)[:2]
        flat = (inputs[0], inputs[1].view(-1), *inputs[2:])
        harmonics.shade(
            degree, len(means), sh.shape[1], warp_arrays(flat, (vec3, real, vec3, vec2)),
            [warp_array(colors, vec3)], device=device_of(means), precision=precision_of(colors),
        )  # fmt: skip
        ctx.save_for_backward(*inputs[:3], colors)
        ctx.degree = degree
        return colors

    @staticmethod
    def backward(ctx, adj_colors):
        means, sh, eyes, colors = ctx.saved_tensors
        terms = coefficient_count(ctx.degree)
        fresh = torch.empty_like if sh.shape[1] == terms else torch.zeros_like
        gradients = (torch.empty_like(means), fresh(sh), torch.zeros_like(eyes))
        real = REALS[colors.dtype]
        vec3 = types_of(real).vec3
        given = (means, sh.view(-1), eyes, colors, adj_colors.contiguous())
        wanted = (gradients[0], gradients[1].view(-1), gradients[2])
        harmonics.shade_adjoint(
            ctx.degree, len(colors), sh.shape[1], warp_arrays(given, (vec3, real, vec3, vec3, vec3)),
            warp_arrays(wanted, (vec3, real, vec3)), device=device_of(colors), precision=precision_of(colors),
        )  # fmt: skip
        return *gradients, None, None
