"""Normals: a gaussian flat enough to be a surface has the direction of its shortest axis.

Invariants
- Normals are in camera space (x right, y down, z forward), of unit length, and face the camera: their product
  with the direction from the camera to the mean is not positive. One seen exactly edge-on keeps its sign.
- Which axis is shortest, and its sign, are choices: they carry no gradient. So scales and means get none, and
  quaternions and the pose do. Of equally short axes the first is taken.
- Gaussians with extent (0, 0) are culled: normal zero, gradient zero.
"""

from functools import cache

import warp as wp

from diga3d_warp.config import POSE_GROUP
from diga3d_warp.kernels.launch import DIFFERENTIABLE, launch
from diga3d_warp.kernels.precision import REALS, types_of
from diga3d_warp.kernels.projection import rotation_function


@cache
def normals_kernel(precision: str = "float32") -> wp.Kernel:
    """The kernel for one precision."""
    real = REALS[precision]
    vec2, vec3, vec4, _, mat33, mat44 = types_of(real)
    rotation_of = rotation_function(real)
    zero = real(0.0)

    @wp.kernel(module="unique", module_options=DIFFERENTIABLE)
    def orient(
        offset: int,
        means: wp.array(dtype=vec3),
        log_scales: wp.array(dtype=vec3),
        quaternions: wp.array(dtype=vec4),
        poses: wp.array(dtype=mat44),
        extents: wp.array(dtype=vec2),
        # outputs
        normals: wp.array(dtype=vec3),
    ):
        i = wp.tid() + offset
        if not (extents[i][0] > zero):
            return
        pose = poses[i // wp.static(POSE_GROUP)]
        axes = wp.transpose(rotation_of(quaternions[i]))
        scale = log_scales[i]
        axis = axes[0]
        if scale[1] < scale[0] and scale[1] <= scale[2]:
            axis = axes[1]
        if scale[2] < scale[0] and scale[2] < scale[1]:
            axis = axes[2]
        to_camera = mat33(
            pose[0, 0], pose[0, 1], pose[0, 2],
            pose[1, 0], pose[1, 1], pose[1, 2],
            pose[2, 0], pose[2, 1], pose[2, 2],
        )  # fmt: skip
        normal = to_camera * axis
        if wp.dot(normal, wp.transform_point(pose, means[i])) > zero:
            normal = -normal
        normals[i] = normal

    return orient


def orient(count: int, inputs: list, outputs: list, *, device: object, precision: str = "float32") -> None:
    """Normals of `count` gaussians; outputs must hold zeros. Arguments as in the kernel."""
    launch(normals_kernel(precision), count, inputs, outputs, device=device, work=2, align=POSE_GROUP)


def orient_adjoint(
    count: int,
    inputs: list,
    outputs: list,
    adj_inputs: list,
    adj_outputs: list,
    *,
    device: object,
    precision: str = "float32",
) -> None:
    """Add the gradients of quaternions and poses, given that of the normals."""
    launch(
        normals_kernel(precision), count, inputs, outputs,
        adj_inputs=adj_inputs, adj_outputs=adj_outputs, adjoint=True, device=device, work=4, align=POSE_GROUP,
    )  # fmt: skip
