"""Sigma points: how a gaussian spreads in the image when it goes through the whole camera, not its Jacobian.

Along each axis of the gaussian two points at plus and minus h = sqrt(3) standard deviations go through
perspective and lens; the parabola through them and the centre stands for the camera along that axis. Its
moments under the gaussian are exact: the odd part o of the two displacements adds o o^T / 3 to the
covariance, the even part e adds 2 e e^T / 9 and moves the mean by e / 3. Along one axis these are the moments
of the unscented transform (Julier and Uhlmann 1997), along all three those of second-order divided
differences (Norgaard et al. 2000, New developments in state estimation for nonlinear systems).

Invariants
- The covariance is a Gram matrix of such parts, so it is positive semi-definite; the unscented transform
  subtracts products of different axes' even parts.
- No sigma point comes nearer than a part of the centre's depth: h shrinks instead, continuously. The odd part
  then stays a slope, o / h; of the even part only what was seen counts, not what the parabola would go on to.
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

    Its arguments: mean in camera space; its ray (x/z, y/z); where the lens puts that ray; the lens's Jacobian
    there; the axis, one standard deviation long, in camera space; lens coefficients; `valid_radius`. Its
    result is two columns of the Gram matrix's rows, in focal lengths: odd (x, y), then even (x, y). The mean
    moves by the even column over sqrt(2).
    """
    vec2, vec3, vec4, mat22, _, _ = types_of(real)
    distort = lens_model(lens_kind, real).distort
    bent = lens_kind != "none"
    zero, half, one = real(0.0), real(0.5), real(1.0)
    widest, even_scale = real(math.sqrt(3.0)), real(math.sqrt(0.5) / 3.0)
    nearest = real(1.0 - SPLATTING.sigma_depth)

    @wp.func
    def spread(mean: vec3, ray: vec2, seen: vec2, slope: mat22, axis: vec3, k: vec4, radius_max: real):
        h = widest
        if widest * wp.abs(axis[2]) > nearest * mean[2]:
            h = nearest * mean[2] / wp.abs(axis[2])
        step = h * axis
        across = vec2(step[0] - ray[0] * step[2], step[1] - ray[1] * step[2])
        ahead = across * (one / (mean[2] + step[2]))
        back = across * (-one / (mean[2] - step[2]))
        odd = slope * across * (one / (h * mean[2]))
        even = vec2(zero, zero)
        one_end = ray + ahead
        other_end = ray + back
        limit = radius_max * radius_max
        if wp.dot(one_end, one_end) < limit and wp.dot(other_end, other_end) < limit:
            if wp.static(bent):
                ahead = distort(one_end[0], one_end[1], k) - seen
                back = distort(other_end[0], other_end[1], k) - seen
            odd = (ahead - back) * (half / h)
            even = (ahead + back) * even_scale
        return vec4(odd[0], odd[1], even[0], even[1])

    return spread
