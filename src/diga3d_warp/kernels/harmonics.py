"""View-dependent colour from real spherical harmonics, in the order and signs of the 3DGS .ply.

Invariants
- colour = max(0, 0.5 + SH(direction)); where the maximum cuts, the gradient is zero.
- The direction runs from the camera centre to the mean; its length is guarded, so a mean at the centre
  gets the colour of degree 0 and no NaN.
- Gaussians with extent (0, 0) are culled: colour zero, gradient zero, coefficients never read.
- Coefficients that are not finite, or absurdly large, give black and a zero gradient.
"""

from __future__ import annotations

from functools import cache

import warp as wp

from diga3d_warp.config import POSE_GROUP, SPLATTING
from diga3d_warp.kernels.launch import DIFFERENTIABLE, launch

C0 = 0.28209479177387814
"""sqrt(1 / (4 pi)): the constant harmonic. Basis constants as in Sloan, Efficient Spherical Harmonic
Evaluation (2013); the signs are those of 3DGS."""
C1 = 0.4886025119029199
C2 = (1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396)
C3 = (
    -0.5900435899266435, 2.890611442640554, -0.4570457994644658, 0.3731763325901154,
    -0.4570457994644658, 1.445305721320277, -0.5900435899266435,
)  # fmt: skip


@wp.func
def magnitude(sh: wp.array2d(dtype=wp.vec3), i: int, terms: int) -> float:
    """Bound of the colour of gaussian `i`: no harmonic up to degree 3 exceeds 1.5."""
    total = wp.vec3(0.0, 0.0, 0.0)
    for k in range(terms):
        total += wp.abs(sh[i, k])
    return total[0] + total[1] + total[2]


@wp.func_grad(magnitude)
def adj_magnitude(sh: wp.array2d(dtype=wp.vec3), i: int, terms: int, adj_total: float):
    pass  # only compared, never drawn


@cache
def harmonics_kernel(degree: int) -> wp.Kernel:
    """The kernel for one degree, 0 to 3; the terms above it are not in its code."""

    @wp.kernel(module="unique", module_options=DIFFERENTIABLE)
    def shade(
        offset: int,
        means: wp.array(dtype=wp.vec3),
        sh: wp.array2d(dtype=wp.vec3),
        eyes: wp.array(dtype=wp.vec3),
        extents: wp.array(dtype=wp.vec2),
        # outputs
        colors: wp.array(dtype=wp.vec3),
    ):
        i = wp.tid() + offset
        if not (extents[i][0] > 0.0):
            return
        if not (magnitude(sh, i, wp.static((degree + 1) ** 2)) < wp.static(SPLATTING.color_max)):
            return
        color = wp.vec3(0.5, 0.5, 0.5) + wp.static(C0) * sh[i, 0]
        if wp.static(degree > 0):
            v = means[i] - eyes[i // wp.static(POSE_GROUP)]
            d = v * (1.0 / wp.sqrt(wp.dot(v, v) + 1.0e-20))
            x = d[0]
            y = d[1]
            z = d[2]
            color += wp.static(C1) * (z * sh[i, 2] - y * sh[i, 1] - x * sh[i, 3])
            if wp.static(degree > 1):
                color += (
                    (wp.static(C2[0]) * x * y) * sh[i, 4]
                    + (wp.static(C2[1]) * y * z) * sh[i, 5]
                    + (wp.static(C2[2]) * (2.0 * z * z - x * x - y * y)) * sh[i, 6]
                    + (wp.static(C2[3]) * x * z) * sh[i, 7]
                    + (wp.static(C2[4]) * (x * x - y * y)) * sh[i, 8]
                )
            if wp.static(degree > 2):
                color += (
                    (wp.static(C3[0]) * y * (3.0 * x * x - y * y)) * sh[i, 9]
                    + (wp.static(C3[1]) * x * y * z) * sh[i, 10]
                    + (wp.static(C3[2]) * y * (4.0 * z * z - x * x - y * y)) * sh[i, 11]
                    + (wp.static(C3[3]) * z * (2.0 * z * z - 3.0 * x * x - 3.0 * y * y)) * sh[i, 12]
                    + (wp.static(C3[4]) * x * (4.0 * z * z - x * x - y * y)) * sh[i, 13]
                    + (wp.static(C3[5]) * z * (x * x - y * y)) * sh[i, 14]
                    + (wp.static(C3[6]) * x * (x * x - 3.0 * y * y)) * sh[i, 15]
                )
        colors[i] = wp.vec3(
            wp.where(color[0] > 0.0, color[0], 0.0),
            wp.where(color[1] > 0.0, color[1], 0.0),
            wp.where(color[2] > 0.0, color[2], 0.0),
        )

    return shade


def shade(degree: int, count: int, inputs: list, outputs: list, *, device: object) -> None:
    """Evaluate `count` colours; outputs must hold zeros. Arguments as in the kernel."""
    launch(harmonics_kernel(degree), count, inputs, outputs, device=device, work=2, align=POSE_GROUP)


def shade_adjoint(
    degree: int,
    count: int,
    inputs: list,
    outputs: list,
    adj_inputs: list,
    adj_outputs: list,
    *,
    device: object,
) -> None:
    """Add the gradients of means, coefficients and eyes, given that of the colours."""
    launch(
        harmonics_kernel(degree), count, inputs, outputs,
        adj_inputs=adj_inputs, adj_outputs=adj_outputs, adjoint=True, device=device, work=4, align=POSE_GROUP,
    )  # fmt: skip
