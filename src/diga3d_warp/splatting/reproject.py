"""Differentiable depth-image-based reprojection of an image from one camera into another (paper Eq. 5)."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch
import warp as wp

from diga3d_warp.config import Accuracy
from diga3d_warp.errors import InputError
from diga3d_warp.kernels import reprojection
from diga3d_warp.kernels.cameras import lens_model, pixel_rays_kernel
from diga3d_warp.kernels.launch import launch
from diga3d_warp.kernels.reprojection import Motion, ReprojectionLimits
from diga3d_warp.scene.camera import Camera, Distortion
from diga3d_warp.splatting.arrays import REALS, warp_array
from diga3d_warp.splatting.optics import optics_of


class Warp(NamedTuple):
    """The source image warped to the target camera.

    Attributes:
        image: RGB, shape (h, w, 3); 0 where nothing is visible.
        depth: z in the target camera [scene units], shape (h, w); 0 where nothing is visible.
        visible: True where a surface of the source is seen, shape (h, w), bool.
    """

    image: torch.Tensor
    depth: torch.Tensor
    visible: torch.Tensor


def reproject(
    image: torch.Tensor,
    depth: torch.Tensor,
    source: Camera,
    target: Camera,
    *,
    accuracy: Accuracy = Accuracy.STANDARD,
) -> Warp:
    """Warp an image by its depth into another camera; the nearest surface is visible.

    Differentiable in image and depth. The gradient holds fixed which surface is in front; it does not see
    pixels appear or vanish. Source pixels with a depth that is zero, negative or not finite are left out, and
    so are those on the far side of a depth step (see `kernels.reprojection.ReprojectionLimits`).

    Args:
        image: RGB of the source, shape (H, W, 3), float32 or float64.
        depth: z along the source camera's axis [scene units], shape (H, W), the same type.
        source, target: The two cameras, of any lens.
        accuracy: With `sampling` "bilinear" the source is a mesh, without cracks; with "nearest" points, each
            in one pixel. `supersampling` is the number of samples per side of a target pixel: colour is the
            mean of the visible ones, depth that of the nearest surface; a pixel is visible where a quarter of
            its samples is, as much as the mesh covers of a pixel in its corner.

    Raises:
        InputError: the shapes or types do not fit each other and the source camera.
    """
    size = (source.height, source.width)
    if image.shape != (*size, 3) or depth.shape != size:
        raise InputError(
            f"image {tuple(image.shape)} and depth {tuple(depth.shape)} do not fit a source camera of "
            f"{source.width} x {source.height} px: give (H, W, 3) and (H, W)"
        )
    if image.dtype not in REALS or depth.dtype != image.dtype:
        raise InputError(f"image ({image.dtype}) and depth ({depth.dtype}) must both be float32 or float64")
    times = accuracy.supersampling
    if times < 1:
        raise InputError(f"supersampling of {times} takes no sample: give 1 or more")
    finer = target if times == 1 else target.resized(times * target.width, times * target.height)
    warp = Warp(
        *_Reproject.apply(image, depth, motion_between(source, finer, depth.device), accuracy.sampling)
    )
    return warp if times == 1 else _averaged(warp, times)


def _averaged(warp: Warp, times: int) -> Warp:
    """One pixel from each square of `times` x `times` samples."""

    def squares(samples: torch.Tensor) -> torch.Tensor:
        height, width = samples.shape[0] // times, samples.shape[1] // times
        split = samples.view(height, times, width, times, *samples.shape[2:])
        return split.transpose(1, 2).flatten(2, 3)

    image, depth, visible = (squares(samples) for samples in warp)
    seen = 4 * visible.sum(2) >= times**2
    near = torch.where(visible, depth, torch.inf).amin(2, keepdim=True)
    front = visible & (depth <= near * (1.0 + ReprojectionLimits.depth_step))
    shares = visible.to(image) / visible.sum(2, keepdim=True).clamp_min(1)
    front_shares = front.to(depth) / front.sum(2, keepdim=True).clamp_min(1)
    return Warp(
        torch.where(seen[..., None], (shares[..., None] * image).sum(2), 0.0),
        torch.where(seen, (front_shares * depth).sum(2), 0.0),
        seen,
    )


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
        coefficients=lens_model(optics.lens_kind, wp.float64).vector(*optics.coefficients),
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
    coefficients = lens_model(optics.lens_kind, wp.float64).vector(*optics.coefficients)
    rays = wp.empty(width * height, dtype=wp.vec2d, device=wp.device_from_torch(device))
    launch(
        pixel_rays_kernel(optics.lens_kind, wp.float64),
        width * height,
        [width, wp.vec4d(fx, fy, cx, cy), coefficients, optics.radius_max],
        [rays],
        device=rays.device,
    )
    return rays


class _Reproject(torch.autograd.Function):
    @staticmethod
    def forward(ctx, image, depth, motion: Motion, sampling: str):
        image, depth = image.detach().contiguous(), depth.detach().contiguous()
        size = (motion.target_height, motion.target_width)
        outputs = (
            image.new_zeros((*size, 3)),
            depth.new_zeros(size),
            torch.zeros(size, dtype=torch.bool, device=depth.device),
        )
        ctx.buffers = reprojection.reproject(
            _colors(image), _depths(depth), motion, _outputs(*outputs), sampling
        )
        ctx.motion, ctx.sampling = motion, sampling
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
            ctx.sampling,
        )
        return adj_image, adj_depth, None, None


def _colors(image: torch.Tensor) -> wp.array:
    return warp_array(image.view(-1, 3), wp.types.vector(length=3, dtype=REALS[image.dtype]))


def _depths(depth: torch.Tensor) -> wp.array:
    return warp_array(depth.view(-1), REALS[depth.dtype])


def _outputs(image: torch.Tensor, depth: torch.Tensor, visible: torch.Tensor) -> list[wp.array]:
    return [_colors(image), _depths(depth), warp_array(visible.view(-1), wp.bool)]
