"""View-dependent colour from real spherical harmonics, in the order and signs of the 3DGS .ply.

Invariants
- colour = max(0, 0.5 + SH(direction)); where the maximum cuts, the gradient is zero.
- The direction runs from the camera centre to the mean; its length is guarded, so a mean at the centre
  gets the colour of degree 0 and no NaN.
- Gaussians with extent (0, 0) are culled: colour zero, gradient zero, coefficients never read.
- Coefficients that are not finite, or absurdly large, give black and a zero gradient.
"""

from functools import cache
from typing import Any

import warp as wp

from diga3d_warp.config import POSE_GROUP, SPLATTING
from diga3d_warp.kernels.launch import DIFFERENTIABLE, launch
from diga3d_warp.kernels.precision import REALS, types_of

C0 = 0.28209479177387814
"""sqrt(1 / (4 pi)): the constant harmonic. Basis constants as in Sloan, Efficient Spherical Harmonic
Evaluation (2013); the signs are those of 3DGS."""
C1 = 0.4886025119029199
C2 = (1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396)
C3 = (
    -0.5900435899266435, 2.890611442640554, -0.4570457994644658, 0.3731763325901154,
    -0.4570457994644658, 1.445305721320277, -0.5900435899266435,
)  # fmt: skip


@cache
def magnitude_function(real: Any) -> Any:
    """Warp function: bound of the colour of gaussian `i`. No harmonic up to degree 3 exceeds 1.5."""
    vec3 = types_of(real).vec3

    @wp.func
    def magnitude(sh: wp.array2d(dtype=vec3), i: int, terms: int):
        total = vec3()
        for k in range(terms):
            total += wp.abs(sh[i, k])
        return total[0] + total[1] + total[2]

    @wp.func_grad(magnitude)
    def adj_magnitude(sh: wp.array2d(dtype=vec3), i: int, terms: int, adj_total: real):
        pass  # only compared, never drawn

    return magnitude


@cache
def harmonics_kernel(degree: int, precision: str = "float32") -> wp.Kernel:
    """The kernel for one degree, 0 to 3; the terms above it are not in its code."""
    real = REALS[precision]
    vec2, vec3 = types_of(real)[:2]
    magnitude = magnitude_function(real)
    terms = (degree + 1) ** 2
    color_max = real(SPLATTING.color_max)
    length_guard = real(1e-20)
    zero, half, one, two, three, four = (real(number) for number in (0.0, 0.5, 1.0, 2.0, 3.0, 4.0))
    c0, c1 = real(C0), real(C1)
    c4, c5, c6, c7, c8 = (real(c) for c in C2)
    c9, c10, c11, c12, c13, c14, c15 = (real(c) for c in C3)

    @wp.kernel(module="unique", module_options=DIFFERENTIABLE)
    def shade(
        offset: int,
        means: wp.array(dtype=vec3),
        sh: wp.array2d(dtype=vec3),
        eyes: wp.array(dtype=vec3),
        extents: wp.array(dtype=vec2),
        # outputs
        colors: wp.array(dtype=vec3),
    ):
        i = wp.tid() + offset
        if not (extents[i][0] > zero):
            return
        if not (magnitude(sh, i, terms) < color_max):
            return
        color = vec3(half, half, half) + c0 * sh[i, 0]
        if wp.static(degree > 0):
            v = means[i] - eyes[i // wp.static(POSE_GROUP)]
            d = v * (one / wp.sqrt(wp.dot(v, v) + length_guard))
            x = d[0]
            y = d[1]
            z = d[2]
            color += c1 * (z * sh[i, 2] - y * sh[i, 1] - x * sh[i, 3])
            if wp.static(degree > 1):
                color += (
                    (c4 * x * y) * sh[i, 4]
                    + (c5 * y * z) * sh[i, 5]
                    + (c6 * (two * z * z - x * x - y * y)) * sh[i, 6]
                    + (c7 * x * z) * sh[i, 7]
                    + (c8 * (x * x - y * y)) * sh[i, 8]
                )
            if wp.static(degree > 2):
                color += (
                    (c9 * y * (three * x * x - y * y)) * sh[i, 9]
                    + (c10 * x * y * z) * sh[i, 10]
                    + (c11 * y * (four * z * z - x * x - y * y)) * sh[i, 11]
                    + (c12 * z * (two * z * z - three * x * x - three * y * y)) * sh[i, 12]
                    + (c13 * x * (four * z * z - x * x - y * y)) * sh[i, 13]
                    + (c14 * z * (x * x - y * y)) * sh[i, 14]
                    + (c15 * x * (x * x - three * y * y)) * sh[i, 15]
                )
        colors[i] = vec3(
            wp.where(color[0] > zero, color[0], zero),
            wp.where(color[1] > zero, color[1], zero),
            wp.where(color[2] > zero, color[2], zero),
        )

    return shade


def shade(
    degree: int, count: int, inputs: list, outputs: list, *, device: object, precision: str = "float32"
) -> None:
    """Evaluate `count` colours; outputs must hold zeros. Arguments as in the kernel."""
    launch(
        harmonics_kernel(degree, precision), count, inputs, outputs,
        device=device, work=2, align=POSE_GROUP,
    )  # fmt: skip


def shade_adjoint(
    degree: int,
    count: int,
    inputs: list,
    outputs: list,
    adj_inputs: list,
    adj_outputs: list,
    *,
    device: object,
    precision: str = "float32",
) -> None:
    """Add the gradients of means, coefficients and eyes, given that of the colours."""
    launch(
        harmonics_kernel(degree, precision), count, inputs, outputs,
        adj_inputs=adj_inputs, adj_outputs=adj_outputs, adjoint=True, device=device, work=4, align=POSE_GROUP,
    )  # fmt: skip
