"""Sigma points: the footprint of a gaussian by the full camera model in place of its Jacobian.

Along each axis of the gaussian two points at plus and minus h = sqrt(3) standard deviations go through
perspective and lens; the parabola through them and the centre approximates the camera along that axis. Its
moments under the gaussian are exact: the odd part o of the two displacements adds o o^T / 3 to the
covariance, the even part e adds 2 e e^T / 9 and moves the mean by e / 3. Along one axis these are the moments
of the unscented transform (Julier and Uhlmann 1997), along all three those of second-order divided
differences (Norgaard et al. 2000, New developments in state estimation for nonlinear systems).

Invariants
- The covariance is a Gram matrix of such parts, so it is positive semi-definite; the unscented transform
  subtracts products of different axes' even parts.
- No sigma point comes nearer than a part of the centre's depth: h shrinks instead, continuously. The odd part
  then stays a slope, o / h; the even part is not extrapolated.
- A sigma point beyond the range of the lens turns its axis linear, as in the affine footprint.
- On a pinhole camera displacements are formed without subtracting pixel positions, so they keep all digits.
"""

import math
from functools import cache
from typing import Any

import warp as wp

from diga3d_warp.config import SPLATTING
from diga3d_warp.kernels.cameras import lens_model
from diga3d_warp.kernels.precision import types_of


@cache
def spread_function(lens_kind: str, real: Any) -> Any:
    """Warp function that sends one axis of a gaussian through the camera.

    Its arguments: mean in camera space; its ray (x/z, y/z); where the lens puts that ray; entries xx, xy and
    yy of the lens's Jacobian there; the axis, one standard deviation long, in camera space; lens
    coefficients; `valid_radius`. Its results are two columns of the Gram matrix's rows, in focal lengths: odd
    x, y, then even x, y. The mean moves by the even column over sqrt(2).
    """
    vec3 = types_of(real).vec3
    lens = lens_model(lens_kind, real)
    vector, distort = lens.vector, lens.distort
    bent = lens_kind != "none"
    zero, half, one = real(0.0), real(0.5), real(1.0)
    widest, even_scale = real(math.sqrt(3.0)), real(math.sqrt(0.5) / 3.0)
    nearest = real(1.0 - SPLATTING.sigma_depth)

    @wp.func
    def spread(
        mean: vec3, x: real, y: real, u: real, v: real, xx: real, xy: real, yy: real, axis: vec3, k: vector,
        radius_max: real,
    ):  # fmt: skip
        h = widest
        if widest * wp.abs(axis[2]) > nearest * mean[2]:
            h = nearest * mean[2] / wp.abs(axis[2])
        step = h * axis
        across_x = step[0] - x * step[2]
        across_y = step[1] - y * step[2]
        ahead = one / (mean[2] + step[2])
        back = -one / (mean[2] - step[2])
        ahead_x = across_x * ahead
        ahead_y = across_y * ahead
        back_x = across_x * back
        back_y = across_y * back
        slope = one / (h * mean[2])
        odd_x = (xx * across_x + xy * across_y) * slope
        odd_y = (xy * across_x + yy * across_y) * slope
        even_x = zero
        even_y = zero
        limit = radius_max * radius_max
        one_end = (x + ahead_x) * (x + ahead_x) + (y + ahead_y) * (y + ahead_y)
        other_end = (x + back_x) * (x + back_x) + (y + back_y) * (y + back_y)
        if one_end < limit and other_end < limit:
            if wp.static(bent):
                one_u, one_v = distort(x + ahead_x, y + ahead_y, k)
                other_u, other_v = distort(x + back_x, y + back_y, k)
                ahead_x = one_u - u
                ahead_y = one_v - v
                back_x = other_u - u
                back_y = other_v - v
            odd_x = (ahead_x - back_x) * (half / h)
            odd_y = (ahead_y - back_y) * (half / h)
            even_x = (ahead_x + back_x) * even_scale
            even_y = (ahead_y + back_y) * even_scale
        return odd_x, odd_y, even_x, even_y

    return spread
