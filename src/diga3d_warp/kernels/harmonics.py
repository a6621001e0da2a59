"""View-dependent colour from real spherical harmonics, in the order and signs of the 3DGS .ply.

Invariants
- colour = max(0, 0.5 + SH(direction)); where the maximum cuts, the gradient is zero.
- The direction runs from the camera centre to the mean; its length is guarded, so a mean at the centre
  gets the colour of degree 0 and no NaN.
- Gaussians with extent (0, 0) are culled: colour zero, gradient zero, whatever their coefficients hold.
- Coefficients that are not finite, or absurdly large, give black and a zero gradient.
"""

from functools import cache
from typing import Any, NamedTuple

import warp as wp

from diga3d_warp.config import POSE_GROUP, SPLATTING
from diga3d_warp.kernels.cells import aligned_function
from diga3d_warp.kernels.gaussian_lanes import GaussianLanes, lanes_for, moves_of, tables_of
from diga3d_warp.kernels.lanes import total_function
from diga3d_warp.kernels.launch import OPTIONS, launch
from diga3d_warp.kernels.precision import REALS, precision_of, types_of

C0 = 0.28209479177387814
"""sqrt(1 / (4 pi)): the constant harmonic. Basis constants as in Sloan, Efficient Spherical Harmonic
Evaluation (2013); the signs are those of 3DGS."""
C1 = 0.4886025119029199
C2 = (1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396)
C3 = (
    -0.5900435899266435, 2.890611442640554, -0.4570457994644658, 0.3731763325901154,
    -0.4570457994644658, 1.445305721320277, -0.5900435899266435,
)  # fmt: skip


class Basis(NamedTuple):
    """Warp functions of the harmonics up to a degree, at the direction of (x, y, z), of any length.

    Attributes:
        values: (x, y, z) -> all harmonics.
        weighted: (x, y, z, weights) -> their weighted sum. Its derivative by the weights is `values`.
    """

    values: Any
    weighted: Any


@cache
def basis(degree: int, real: Any) -> Basis:
    """The functions for one degree, 0 to 3; the terms above it are not in their code."""
    terms = (degree + 1) ** 2
    vec = wp.types.vector(length=terms, dtype=real)
    length_guard = real(1e-20)
    one, two, three, four = (real(number) for number in (1.0, 2.0, 3.0, 4.0))
    c0, c1 = real(C0), real(C1)
    c4, c5, c6, c7, c8 = (real(c) for c in C2)
    c9, c10, c11, c12, c13, c14, c15 = (real(c) for c in C3)

    @wp.func
    def values(vx: real, vy: real, vz: real) -> vec:
        b = vec()
        b[0] = c0
        if wp.static(degree > 0):
            scale = one / wp.sqrt(vx * vx + vy * vy + vz * vz + length_guard)
            x = vx * scale
            y = vy * scale
            z = vz * scale
            b[1] = -c1 * y
            b[2] = c1 * z
            b[3] = -c1 * x
        if wp.static(degree > 1):
            b[4] = c4 * x * y
            b[5] = c5 * y * z
            b[6] = c6 * (two * z * z - x * x - y * y)
            b[7] = c7 * x * z
            b[8] = c8 * (x * x - y * y)
        if wp.static(degree > 2):
            b[9] = c9 * y * (three * x * x - y * y)
            b[10] = c10 * x * y * z
            b[11] = c11 * y * (four * z * z - x * x - y * y)
            b[12] = c12 * z * (two * z * z - three * x * x - three * y * y)
            b[13] = c13 * x * (four * z * z - x * x - y * y)
            b[14] = c14 * z * (x * x - y * y)
            b[15] = c15 * x * (x * x - three * y * y)
        return b

    @wp.func
    def weighted(vx: real, vy: real, vz: real, weights: vec) -> real:
        return wp.dot(values(vx, vy, vz), weights)

    return Basis(values, weighted)


class Channels(NamedTuple):
    """Warp functions between harmonics and a table of coefficients, red, green and blue in turn.

    Attributes:
        blend: (harmonics, table, channel, lane) -> sum of a channel's coefficients times the harmonics.
        magnitude: (table, lane) -> sum of all coefficients' sizes: no harmonic up to degree 3 exceeds 1.5.
        mix: (table, r, g, b, lane) -> for each harmonic, its coefficients times r, g and b.
        spread: (table, harmonics, r, g, b, lane): set each coefficient to its harmonic times r, g or b.
    """

    blend: Any
    magnitude: Any
    mix: Any
    spread: Any


@cache
def channels(degree: int, size: int, real: Any) -> Channels:
    """The functions for one degree, `size` gaussians in lanes."""
    terms = (degree + 1) ** 2
    harmonics, vec = (wp.types.vector(length=length, dtype=real) for length in (terms, size))
    _, _, get, put = tables_of(3 * terms, size, real)

    # Naming k in a constant unrolls a loop; all of these are called in loops over lanes.
    @wp.func
    def blend(b: harmonics, table: wp.array(dtype=vec), channel: int, t: int) -> real:
        total = real(0.0)
        for k in range(terms):
            total = total + b[wp.static(k)] * get(table, wp.static(3 * k) + channel, t)
        return total

    @wp.func
    def magnitude(table: wp.array(dtype=vec), t: int) -> real:
        total = real(0.0)
        for q in range(wp.static(3 * terms)):
            total = total + wp.abs(get(table, wp.static(q), t))
        return total

    @wp.func
    def mix(table: wp.array(dtype=vec), red: real, green: real, blue: real, t: int) -> harmonics:
        weights = harmonics()
        for k in range(terms):
            warm = red * get(table, wp.static(3 * k), t) + green * get(table, wp.static(3 * k + 1), t)
            weights[wp.static(k)] = warm + blue * get(table, wp.static(3 * k + 2), t)
        return weights

    @wp.func
    def spread(table: wp.array(dtype=vec), b: harmonics, red: real, green: real, blue: real, t: int):
        for k in range(terms):
            put(table, wp.static(3 * k), t, b[wp.static(k)] * red)
            put(table, wp.static(3 * k + 1), t, b[wp.static(k)] * green)
            put(table, wp.static(3 * k + 2), t, b[wp.static(k)] * blue)

    return Channels(blend, magnitude, mix, spread)


@cache
def harmonics_kernel(degree: int, lanes: GaussianLanes, precision: str = "float32") -> wp.Kernel:
    """The kernel for one degree."""
    real, size, numbers = REALS[precision], lanes.size, 3 * (degree + 1) ** 2
    vec2, vec3 = types_of(real)[:2]
    vec = wp.types.vector(length=size, dtype=real)
    aligned = aligned_function(vec)
    pairs, triples = moves_of(vec2, size), moves_of(vec3, size)
    load_vec2, load_vec3, store_vec3 = pairs.load, triples.load, triples.store
    load_table = tables_of(numbers, size, real).load
    in_3 = wp.types.matrix(shape=(3, size), dtype=real)
    values = basis(degree, real).values
    blend, magnitude, *_ = channels(degree, size, real)
    color_max, zero, half = real(SPLATTING.color_max), real(0.0), real(0.5)

    @wp.kernel(module="unique", module_options=OPTIONS)
    def shade(
        offset: int,
        count: int,
        stride: int,
        means: wp.array(dtype=vec3),
        sh: wp.array(dtype=real),
        eyes: wp.array(dtype=vec3),
        extents: wp.array(dtype=vec2),
        # outputs
        colors: wp.array(dtype=vec3),
    ):
        begin = (wp.tid() + offset) * wp.static(lanes.span)
        end = wp.min(begin + wp.static(lanes.span), count)
        eye = eyes[begin // wp.static(POSE_GROUP)]
        table = aligned(wp.zeros(shape=wp.static(numbers + 1), dtype=vec))
        for first in range(begin, end, wp.static(size)):
            used = wp.min(wp.static(size), end - first)
            mean = load_vec3(means, first, used)
            extent = load_vec2(extents, first, used)
            load_table(sh, stride, first, used, table)
            color = in_3()
            for t in range(size):
                b = values(mean[0, t] - eye[0], mean[1, t] - eye[1], mean[2, t] - eye[2])
                red = half + blend(b, table, 0, t)
                green = half + blend(b, table, 1, t)
                blue = half + blend(b, table, 2, t)
                drawn = wp.where(extent[0, t] > zero, 1, 0) & wp.where(magnitude(table, t) < color_max, 1, 0)
                color[0, t] = wp.where((drawn & wp.where(red > zero, 1, 0)) != 0, red, zero)
                color[1, t] = wp.where((drawn & wp.where(green > zero, 1, 0)) != 0, green, zero)
                color[2, t] = wp.where((drawn & wp.where(blue > zero, 1, 0)) != 0, blue, zero)
            store_vec3(colors, first, used, color)

    return shade


@cache
def adjoint_kernel(degree: int, lanes: GaussianLanes, precision: str = "float32") -> wp.Kernel:
    """The kernel that pulls gradients of the colours back."""
    real, size, numbers = REALS[precision], lanes.size, 3 * (degree + 1) ** 2
    vec3 = types_of(real).vec3
    vec = wp.types.vector(length=size, dtype=real)
    aligned = aligned_function(vec)
    triples, tables = moves_of(vec3, size), tables_of(numbers, size, real)
    load_vec3, store_vec3 = triples.load, triples.store
    load_table, store_table, *_ = tables
    in_3 = wp.types.matrix(shape=(3, size), dtype=real)
    _, _, mix, spread = channels(degree, size, real)
    total = total_function(size, real)
    pulled = wp.grad(basis(degree, real).weighted)
    zero = real(0.0)

    @wp.kernel(module="unique", module_options=OPTIONS)
    def shade_adjoint(
        offset: int,
        count: int,
        stride: int,
        means: wp.array(dtype=vec3),
        sh: wp.array(dtype=real),
        eyes: wp.array(dtype=vec3),
        colors: wp.array(dtype=vec3),
        adj_colors: wp.array(dtype=vec3),
        # outputs
        adj_means: wp.array(dtype=vec3),
        adj_sh: wp.array(dtype=real),
        adj_eyes: wp.array(dtype=vec3),
    ):
        begin = (wp.tid() + offset) * wp.static(lanes.span)
        end = wp.min(begin + wp.static(lanes.span), count)
        group = begin // wp.static(POSE_GROUP)
        eye = eyes[group]
        of_eye = in_3()
        table = aligned(wp.zeros(shape=wp.static(numbers + 1), dtype=vec))
        result = aligned(wp.zeros(shape=wp.static(numbers + 1), dtype=vec))
        for first in range(begin, end, wp.static(size)):
            used = wp.min(wp.static(size), end - first)
            mean = load_vec3(means, first, used)
            color = load_vec3(colors, first, used)
            g = load_vec3(adj_colors, first, used)
            load_table(sh, stride, first, used, table)
            g_mean = in_3()
            for t in range(size):
                red = wp.where(color[0, t] > zero, g[0, t], zero)
                green = wp.where(color[1, t] > zero, g[1, t], zero)
                blue = wp.where(color[2, t] > zero, g[2, t], zero)
                weights = mix(table, red, green, blue, t)
                # Of a culled gaussian, mean and coefficients may be anything.
                seen = color[0, t] + color[1, t] + color[2, t] > zero
                vx = wp.where(seen, mean[0, t] - eye[0], zero)
                vy = wp.where(seen, mean[1, t] - eye[1], zero)
                vz = wp.where(seen, mean[2, t] - eye[2], zero)
                g_x, g_y, g_z, b = pulled(vx, vy, vz, weights)
                g_mean[0, t] = wp.where(seen, g_x, zero)
                g_mean[1, t] = wp.where(seen, g_y, zero)
                g_mean[2, t] = wp.where(seen, g_z, zero)
                of_eye[0, t] -= wp.where(seen, g_x, zero)
                of_eye[1, t] -= wp.where(seen, g_y, zero)
                of_eye[2, t] -= wp.where(seen, g_z, zero)
                spread(result, b, red, green, blue, t)
            store_table(adj_sh, stride, first, used, result)
            store_vec3(adj_means, first, used, g_mean)
        if adj_eyes:
            wp.atomic_add(adj_eyes, group, vec3(total(of_eye[0]), total(of_eye[1]), total(of_eye[2])))

    return shade_adjoint


def shade(
    degree: int, means: wp.array, sh: wp.array, stride: int, eyes: wp.array, extents: wp.array,
    colors: wp.array,
) -> None:  # fmt: skip
    """Evaluate the colours of N gaussians, in the precision of the arrays.

    Args:
        degree: Highest degree to evaluate.
        means: shape (N,), vec3.
        sh: Coefficients, shape (N * stride * 3,).
        stride: Coefficients of a gaussian.
        eyes: Camera centre, one equal row for each `POSE_GROUP` gaussians, shape (G,), vec3.
        extents: From `projection`, shape (N,), vec2.
        colors: Output, shape (N,), vec3.
    """
    count, device, precision = means.shape[0], means.device, precision_of(means)
    lanes = lanes_for(device, calls=precision == "float64")
    launch(
        harmonics_kernel(degree, lanes, precision), -(-count // lanes.span),
        [count, 3 * stride, means, sh, eyes, extents], [colors],
        device=device, work=lanes.span,
    )  # fmt: skip


def shade_adjoint(
    degree: int, means: wp.array, sh: wp.array, stride: int, eyes: wp.array, colors: wp.array,
    adj_colors: wp.array, adj_means: wp.array | None, adj_sh: wp.array | None, adj_eyes: wp.array | None,
) -> None:  # fmt: skip
    """Write the gradients of means and coefficients, and add those of eyes.

    Args:
        degree, means, sh, stride, eyes: As in `shade`.
        colors: What it wrote.
        adj_colors: Their gradients.
        adj_means, adj_sh, adj_eyes: Outputs; None for those that are not needed.
    """
    count, device, precision = means.shape[0], means.device, precision_of(means)
    lanes = lanes_for(device, calls=precision == "float64")
    launch(
        adjoint_kernel(degree, lanes, precision), -(-count // lanes.span),
        [count, 3 * stride, means, sh, eyes, colors, adj_colors], [adj_means, adj_sh, adj_eyes],
        device=device, work=2 * lanes.span,
    )  # fmt: skip
