"""Differentiable depth-image-based reprojection of an image from one camera into another (paper Eq. 5)."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import torch
import warp as wp

from diga3d_warp.errors import InputError
from diga3d_warp.kernels import reprojection
from diga3d_warp.kernels.cameras import pixel_rays_kernel
from diga3d_warp.kernels.launch import launch
from diga3d_warp.kernels.reprojection import Motion
from diga3d_warp.scene.camera import Camera, Distortion
from diga3d_warp.splatting.arrays import warp_array
from diga3d_warp.splatting.optics import optics_of


class Warp(NamedTuple):
    """What the target camera sees of the source image.

    Attributes:
        image: RGB, shape (h, w, 3); 0 where nothing is visible.
        depth: z in the target camera [scene units], shape (h, w); 0 where nothing is visible.
        visible: True where a surface of the source is seen, shape (h, w), bool.
    """

    image: torch.Tensor
    depth: torch.Tensor
    visible: torch.Tensor


def reproject(image: torch.Tensor, depth: torch.Tensor, source: Camera, target: Camera) -> Warp:
    """Carry an image along its depth into another camera, nearest surface first.

    Differentiable in image and depth. The gradient holds fixed which surface is in front; it does not see
    pixels appear or vanish. Source pixels with a depth that is zero, negative or not finite are left out, and
    so are those on the far side of a depth step (see `kernels.reprojection.ReprojectionLimits`).

    Args:
        image: RGB of the source, shape (H, W, 3), float32 or float64.
        depth: z along the source camera's axis [scene units], shape (H, W), the same type.
        source, target: The two cameras, of any lens.

    Raises:
        InputError: the shapes or types do not fit each other and the source camera.
    """
    size = (source.height, source.width)
    if image.shape != (*size, 3) or depth.shape != size:
        raise InputError(
            f"image {tuple(image.shape)} and depth {tuple(depth.shape)} do not fit a source camera of "
            f"{source.width} x {source.height} px: give (H, W, 3) and (H, W)"
        )
    if image.dtype not in _SCALARS or depth.dtype != image.dtype:
        raise InputError(f"image ({image.dtype}) and depth ({depth.dtype}) must both be float32 or float64")
    return Warp(*_Reproject.apply(image, depth, motion_between(source, target, depth.device)))


def motion_between(source: Camera, target: Camera, device: torch.device) -> Motion:
    """The kernel's description of the way from one camera to another."""
    relative = target.pose @ np.linalg.inv(source.pose)
    optics = optics_of(target)
    return Motion(
        width=source.width,
        height=source.height,
        rays=_rays(
            source.width, source.height, source.fx, source.fy, source.cx, source.cy, source.distortion,
            str(device),
        ),
        rotation=wp.mat33d(*relative[:3, :3].ravel().tolist()),
        translation=wp.vec3d(*relative[:3, 3].tolist()),
        target_width=target.width,
        target_height=target.height,
        lens_kind=optics.lens_kind,
        intrinsics=wp.vec4d(target.fx, target.fy, target.cx, target.cy),
        coefficients=wp.vec4d(*optics.coefficients),
        radius_max=optics.radius_max,
    )  # fmt: skip


@lru_cache(maxsize=16)
def _rays(
    width: int,
    height: int,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    distortion: Distortion | None,
    device: str,
) -> wp.array:
    camera = Camera(width, height, fx, fy, cx, cy, torch.eye(4), distortion)
    optics = optics_of(camera)
    rays = wp.empty(width * height, dtype=wp.vec2d, device=wp.device_from_torch(device))
    launch(
        pixel_rays_kernel(optics.lens_kind, wp.float64),
        width * height,
        [width, wp.vec4d(fx, fy, cx, cy), wp.vec4d(*optics.coefficients), optics.radius_max],
        [rays],
        device=rays.device,
    )
    return rays


_SCALARS: dict[torch.dtype, Any] = {torch.float32: wp.float32, torch.float64: wp.float64}


class _Reproject(torch.autograd.Function):
    @staticmethod
    def forward(ctx, image, depth, motion: Motion):
        image, depth = image.detach().contiguous(), depth.detach().contiguous()
        size = (motion.target_height, motion.target_width)
        outputs = (
            image.new_zeros((*size, 3)),
            depth.new_zeros(size),
            torch.zeros(size, dtype=torch.bool, device=depth.device),
        )
        ctx.buffers = reprojection.reproject(_colors(image), _depths(depth), motion, _outputs(*outputs))
        ctx.motion = motion
        ctx.save_for_backward(image, depth, *outputs)
        ctx.mark_non_differentiable(outputs[2])
        return outputs

    @staticmethod
    def backward(ctx, adj_image_out, adj_depth_out, _):
        image, depth, *outputs = ctx.saved_tensors
        adj_image, adj_depth = torch.zeros_like(image), torch.zeros_like(depth)
        positions, front = ctx.buffers
        reprojection.reproject_adjoint(
            _colors(image),
            _depths(depth),
            ctx.motion,
            _outputs(*outputs),
            positions,
            front,
            [_colors(adj_image_out.contiguous()), _depths(adj_depth_out.contiguous())],
            _colors(adj_image),
            _depths(adj_depth),
        )
        return adj_image, adj_depth, None


def _colors(image: torch.Tensor) -> wp.array:
    return warp_array(image.view(-1, 3), wp.types.vector(length=3, dtype=_SCALARS[image.dtype]))


def _depths(depth: torch.Tensor) -> wp.array:
    return warp_array(depth.view(-1), _SCALARS[depth.dtype])


def _outputs(image: torch.Tensor, depth: torch.Tensor, visible: torch.Tensor) -> list[wp.array]:
    return [_colors(image), _depths(depth), warp_array(visible.view(-1), wp.bool)]
