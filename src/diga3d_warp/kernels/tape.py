"""The renderer on a `wp.Tape`: the same operations for Warp programs without torch.

Each function runs forward at once and records its adjoint on the tape, together with the kernels that the
caller records:

    with wp.Tape() as tape:
        splats = project(tape, lens, means, log_scales, quaternions, opacity_logits, poses, intrinsics)
        colors = shade(tape, 3, means, sh, eyes, splats.extents)
        images = composite(tape, splats, colors, width, height)
        wp.launch(my_loss, ...)
    tape.backward(loss)

Invariants
- Adjoints add to `.grad` of the inputs that have one. For the others a gradient is computed and dropped.
- Adjoints clear `.grad` of their outputs, as recorded kernels do, so that a second backward pass is right.
- Launches inside use all threads and are not recorded themselves.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from typing import Any

import warp as wp

from diga3d_warp.config import Accuracy, Effects
from diga3d_warp.kernels import (
    compositing,
    compositing_adjoint,
    harmonics,
    projection,
    reprojection,
)
from diga3d_warp.kernels import normals as facing
from diga3d_warp.kernels import ssim as similarity
from diga3d_warp.kernels.binning import bin_gaussians
from diga3d_warp.kernels.blending import Blending
from diga3d_warp.kernels.footprint import Projecting
from diga3d_warp.kernels.launch import OPTIONS, launch
from diga3d_warp.kernels.precision import types_of
from diga3d_warp.kernels.projection import Lens, Parameters
from diga3d_warp.kernels.splats import BlendGradients, Images, Splats

STANDARD = Blending()


def project(
    tape: wp.Tape, lens: Lens, means: wp.array, log_scales: wp.array, quaternions: wp.array,
    opacity_logits: wp.array, poses: wp.array, intrinsics: wp.array, *,
    accuracy: Accuracy = Accuracy.STANDARD, effects: Effects = Effects(),
) -> Splats:  # fmt: skip
    """Project N gaussians into a camera.

    Arrays are of the accuracy's precision: for float64 vec3d instead of vec3, and so on.

    Args:
        tape: Records the adjoint.
        lens: Of the camera.
        means, log_scales: shape (N,), vec3.
        quaternions: (w, x, y, z), shape (N,), vec4.
        opacity_logits: shape (N,), float.
        poses: World to camera, one equal row for each `POSE_GROUP` gaussians, shape (G,), mat44. The gradient
            of the pose is the sum of the rows'.
        intrinsics: (fx, fy, cx, cy) [px], rows likewise, shape (G,), vec4. Carries gradient as the poses do.
        accuracy, effects: As in `splatting.project.project`; `lens` decides in place of `effects.lens`.
    """
    device, count = means.device, means.size
    kind = Projecting.of(lens.lens_kind, accuracy, effects)
    parameters = Parameters(means, log_scales, quaternions, opacity_logits, poses, intrinsics)
    vec2, vec3, *_ = types_of(kind.real)
    dtypes = [vec2, kind.real, vec3, vec2, kind.real]
    if kind.slopes:
        dtypes.append(vec2)
    splats = Splats(*(wp.zeros(count, dtype=dtype, device=device, requires_grad=True) for dtype in dtypes))
    projection.project(kind, parameters, lens, splats)
    made = [array for array in splats if array is not None]

    def adjoint() -> None:
        adj_splats = Splats(*(array.grad for array in made))
        with _added_to(parameters) as gradients:
            projection.project_adjoint(
                kind, parameters, lens, splats.extents, adj_splats, Parameters(*gradients)
            )
        _clear(made)

    _record(tape, adjoint, [*parameters, *made])
    return splats


def shade(
    tape: wp.Tape, degree: int, means: wp.array, sh: wp.array, eyes: wp.array, extents: wp.array
) -> wp.array:
    """Colours of N gaussians, shape (N,), vec3, in the precision of the arrays.

    Args:
        tape: Records the adjoint.
        degree: Highest degree of harmonics to evaluate, 0 to 3.
        means: shape (N,), vec3.
        sh: Coefficients, shape (N, K), vec3.
        eyes: Camera centre, one equal row for each `POSE_GROUP` gaussians, shape (G,), vec3.
        extents: From `project`.
    """
    colors = wp.zeros(means.size, dtype=means.dtype, device=means.device, requires_grad=True)
    harmonics.shade(degree, means, _flat(sh), sh.shape[1], eyes, extents, colors)

    def adjoint() -> None:
        with _added_to([means, sh, eyes]) as (of_means, of_sh, of_eyes):
            harmonics.shade_adjoint(
                degree, means, _flat(sh), sh.shape[1], eyes, colors, colors.grad, of_means,
                None if of_sh is None else _flat(of_sh), of_eyes,
            )  # fmt: skip
        _clear([colors])

    _record(tape, adjoint, [means, sh, eyes, colors])
    return colors


def orient(
    tape: wp.Tape, means: wp.array, log_scales: wp.array, quaternions: wp.array, poses: wp.array,
    extents: wp.array,
) -> wp.array:  # fmt: skip
    """Normals of N gaussians in camera space, shape (N,), vec3; see `splatting.normals.orient`.

    Args:
        tape: Records the adjoint, which reaches quaternions and poses.
        means, log_scales, quaternions, poses: As in `project`.
        extents: From `project`.
    """
    directions = wp.zeros(means.size, dtype=means.dtype, device=means.device, requires_grad=True)
    inputs = (means, log_scales, quaternions, poses, extents)
    facing.orient(*inputs, directions)

    def adjoint() -> None:
        with _added_to([quaternions, poses]) as (of_quaternions, of_poses):
            facing.orient_adjoint(*inputs, directions.grad, of_quaternions, of_poses)
        _clear([directions])

    _record(tape, adjoint, [quaternions, poses, directions])
    return directions


def composite(
    tape: wp.Tape, splats: Splats, colors: wp.array, width: int, height: int, *,
    blending: Blending = STANDARD, normals: wp.array | None = None,
) -> Images:  # fmt: skip
    """Blend splats into an image.

    Args:
        tape: Records the adjoint.
        splats: From `project`.
        colors: shape (N,), vec3.
        width, height: Image size [px].
        blending: Cut-offs, and what to blend; its precision is that of the arrays.
        normals: shape (N,), vec3, where `blending` asks for them.

    Raises:
        ValueError: normals are asked for but not given, or the other way round.
    """
    if blending.normals != (normals is not None):
        raise ValueError("normals are blended if and only if `blending.normals` is on: give both or neither")
    device, real = colors.device, blending.real
    vec3 = types_of(real).vec3
    normals = wp.zeros(0, dtype=vec3, device=device) if normals is None else normals
    bins = bin_gaussians(splats.centers, splats.depths, splats.extents, width, height)
    images = Images(*(
        wp.zeros(width * height if asked else 0, dtype=dtype, device=device, requires_grad=True)
        for dtype, asked in (
            (vec3, True), (real, True), (real, True), (vec3, blending.normals), (real, blending.median)
        )
    ))  # fmt: skip
    changes = compositing.composite(bins, width, height, splats, colors, normals, images, blending)
    blended = [splats.centers, splats.factors, splats.opacities, colors, splats.depths, normals]

    def adjoint() -> None:
        compositing_adjoint.composite_adjoint(
            bins, width, height, splats, colors, normals, images, changes,
            Images(*(array.grad for array in images)), BlendGradients(*map(_gradient, blended)), blending,
        )  # fmt: skip
        _clear(images)

    _record(tape, adjoint, [*blended, *images])
    return images


def reproject(
    tape: wp.Tape, image: wp.array, depth: wp.array, motion: reprojection.Motion, *,
    sampling: str = "bilinear",
) -> tuple[wp.array, wp.array, wp.array]:  # fmt: skip
    """Warp an image by its depth into another camera.

    Args:
        tape: Records the adjoint.
        image: RGB of the source, shape (H * W,), 3-vectors of float32 or float64.
        depth: Depth of the source [scene units], shape (H * W,), the same scalar type.
        motion: From source to target.
        sampling: "bilinear" draws a mesh, "nearest" points.

    Returns:
        Image, depth and visibility (bool) in the target, shape (h * w,).
    """
    pixels = motion.target_width * motion.target_height
    warped = wp.zeros(pixels, dtype=image.dtype, device=image.device, requires_grad=True)
    far = wp.zeros(pixels, dtype=depth.dtype, device=image.device, requires_grad=True)
    visible = wp.zeros(pixels, dtype=wp.bool, device=image.device)
    outputs = [warped, far, visible]
    positions, front = reprojection.reproject(image, depth, motion, outputs, sampling)

    def adjoint() -> None:
        reprojection.reproject_adjoint(
            image, depth, motion, outputs, positions, front, [warped.grad, far.grad],
            _gradient(image), _gradient(depth), sampling,
        )  # fmt: skip

    _record(tape, adjoint, [image, depth, warped, far])
    return warped, far, visible


def ssim(tape: wp.Tape, image: wp.array, target: wp.array, width: int, height: int) -> wp.array:
    """Structural similarity of each pixel and channel, shape (H * W,), vec3.

    Args:
        tape: Records the adjoint, which reaches `image` alone.
        image, target: RGB in [0, 1], shape (H * W,), vec3, contiguous.
        width, height: Image size [px].
    """
    result = wp.empty(image.size, dtype=wp.vec3, device=image.device, requires_grad=True)
    derivatives = [wp.empty(3 * image.size, dtype=float, device=image.device) for _ in range(3)]
    similarity.similarity([_flat(image), _flat(target)], width, height, [_flat(result), *derivatives])

    def adjoint() -> None:
        gradient = _gradient(image)
        similarity.similarity_adjoint(
            [_flat(image), _flat(target)], width, height, derivatives, _flat(result.grad), _flat(gradient)
        )
        _clear([result])

    _record(tape, adjoint, [image, target, result])
    return result


def _record(tape: wp.Tape, adjoint: Callable[[], None], arrays: Sequence[wp.array]) -> None:
    tape.record_func(adjoint, [array for array in arrays if array.requires_grad and array.size > 0])


@cache
def add_kernel(real: Any) -> wp.Kernel:
    """The kernel that adds an array of numbers of a type to another."""

    @wp.kernel(module="unique", module_options=OPTIONS)
    def add(
        offset: int,
        more: wp.array(dtype=real),
        # outputs
        sums: wp.array(dtype=real),
    ):
        cell = wp.tid() + offset
        sums[cell] = sums[cell] + more[cell]

    return add


@contextmanager
def _added_to(arrays: Sequence[wp.array]) -> Iterator[list[wp.array | None]]:
    """Where an adjoint that writes may write, added to the gradients after; None for an input without one."""
    written = [wp.zeros_like(array.grad) if array.requires_grad else None for array in arrays]
    yield written
    for array, gradient in zip(arrays, written, strict=True):
        if gradient is not None:
            more, sums = _flat(gradient), _flat(array.grad)
            launch(add_kernel(sums.dtype), sums.size, [more], [sums], device=array.device)


def _gradient(array: wp.array) -> wp.array:
    """Where to add a gradient; a scratch array for an input that keeps none."""
    return array.grad if array.requires_grad else wp.zeros_like(array)


def _clear(outputs: Sequence[wp.array]) -> None:
    for array in outputs:
        array.grad.zero_()


def _flat(array: wp.array) -> wp.array:
    """The numbers of a contiguous array of any shape, not copied: use them while `array` lives."""
    real = getattr(array.dtype, "_wp_scalar_type_", array.dtype)
    count = array.size * getattr(array.dtype, "_length_", 1)
    return wp.array(ptr=array.ptr, shape=count, dtype=real, device=array.device)
