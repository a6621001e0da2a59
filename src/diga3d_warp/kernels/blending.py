"""What every compositing kernel shares: cut-offs, the opacity of a gaussian in a pixel, what is blended.

A kernel is compiled for one `Blending` and holds nothing that it does not ask for.

Invariants
- Forward and adjoint call the same `response`, `clipped` and `survives` in the same order, so they skip,
  clamp and stop at the same gaussians.
- In float32 there is no `wp.exp` in a lane: it is a scalar library call. A polynomial replaces it.
"""

import math
from dataclasses import dataclass, field
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import warp as wp
from numpy.polynomial import Chebyshev, Polynomial

from diga3d_warp.config import SPLATTING, Accuracy, Effects
from diga3d_warp.kernels.launch import OPTIONS
from diga3d_warp.kernels.precision import REALS, types_of

wp.set_module_options(OPTIONS)

EXP_DEGREES = range(2, 9)
"""Degrees of the polynomial. Below 2 the skip at alpha_min would move by a tenth; from 7 on float32 holds no
more."""

RANGE_MARGIN = 0.1
"""The polynomial reaches this far below ln(alpha_min), where it stays constant: a gaussian of opacity 1 is
there at 0.9 alpha_min, so its constant tail is skipped whatever the error of the polynomial."""


@dataclass(frozen=True)
class Blending:
    """What a compositing kernel is compiled for.

    Attributes:
        alpha_min, transmittance_min, exp_degree, precision: As in `config.Accuracy`.
        boxed: A gaussian ends at its box even where its alpha is above `alpha_min`. Without, the box must
            hold every pixel in which alpha reaches `alpha_min`.
        pixel_order: Each pixel blends by its own depths; see `ordering`.
        depth: Blend depths.
        normals: Blend normals.
        median: Find the depth of the gaussian at which transmittance falls below a half.
        deterministic: One thread a tile on CUDA too, so that gradients are summed in a fixed order. It
            chooses lanes rather than code, so kernels do not differ by it.
    """

    alpha_min: float = Accuracy.alpha_min
    transmittance_min: float = Accuracy.transmittance_min
    exp_degree: int = Accuracy.exp_degree
    precision: str = Accuracy.precision
    boxed: bool = False
    pixel_order: bool = False
    depth: bool = True
    normals: bool = False
    median: bool = False
    deterministic: bool = field(default=False, compare=False)

    def __post_init__(self) -> None:
        if not 0.0 < self.alpha_min < SPLATTING.alpha_max:
            raise ValueError(f"alpha_min {self.alpha_min} is not between 0 and {SPLATTING.alpha_max}")
        if not 0.0 <= self.transmittance_min < 1.0:
            raise ValueError(f"transmittance_min {self.transmittance_min} is not in [0, 1)")
        if self.exp_degree not in EXP_DEGREES:
            raise ValueError(f"exp_degree {self.exp_degree} is not between 2 and 8")
        if self.precision not in REALS:
            raise ValueError(f"precision {self.precision!r} is neither 'float32' nor 'float64'")

    @classmethod
    def of(
        cls, accuracy: Accuracy, effects: Effects, *, normals: bool = False, median: bool = False
    ) -> "Blending":
        """The kernels that an accuracy, some effects and some outputs need."""
        return cls(
            accuracy.alpha_min, accuracy.transmittance_min, accuracy.exp_degree, accuracy.precision,
            boxed=accuracy.extent == "circle", pixel_order=accuracy.pixel_order or effects.pixel_order,
            depth=effects.depth, normals=normals, median=median, deterministic=effects.deterministic,
        )  # fmt: skip

    @property
    def real(self) -> Any:
        """Scalar type of all arrays."""
        return REALS[self.precision]

    @property
    def features(self) -> int:
        """Numbers that are blended for each pixel: colour, then depth, then normal."""
        return 3 + self.depth + 3 * self.normals

    @property
    def normal_at(self) -> int:
        """First of the normal's features."""
        return 3 + self.depth


class Exponential(NamedTuple):
    """exp(x) on [-reach, 0] as p(x / 2^squarings)^(2^squarings).

    Attributes:
        coefficients: Of p, lowest first.
        squarings: So many that p spans no more than one unit, where a low degree follows exp.
        reach: Below -reach the value is that at -reach.
    """

    coefficients: tuple[float, ...]
    squarings: int
    reach: float


def exponential(alpha_min: float, degree: int) -> Exponential:
    """The polynomial for opacities down to `alpha_min`.

    Its relative error is about 2^squarings * 2 (h / 4)^(degree + 1) / (degree + 1)!, h the length that p
    spans. At 1/255, h = 0.71, that is 1e-2, 7e-4, 2e-5, 7e-7 and 2e-8 for degrees 2 to 6; rounding of float32
    adds up to 1e-6.
    """
    reach = RANGE_MARGIN - math.log(alpha_min)
    squarings = max(0, math.ceil(math.log2(reach)))
    span = reach / 2**squarings
    p = Chebyshev.interpolate(np.exp, degree, domain=[-span, 0.0]).convert(kind=Polynomial)
    return Exponential(tuple(float(c) for c in p.coef), squarings, reach)


class Rules(NamedTuple):
    """Warp functions that decide what a gaussian does to a pixel.

    Attributes:
        unit: What a Cholesky factor is multiplied by for `response`.
        response: (opacity, factor in `unit`, dx, dy, extent) -> opacity times the gaussian at the offset from
            a pixel to its centre.
        clipped: (response) -> alpha: 0 below alpha_min, at most alpha_max.
        survives: (transmittance after it, live) -> live, or 0 if the gaussian would finish the pixel.
        features: (index, colors, depths, normals) -> what is blended, read at an index of three arrays.
    """

    unit: float
    response: Any
    clipped: Any
    survives: Any
    features: Any


@cache
def rules(blending: Blending) -> Rules:
    """The functions for one kind of blending."""
    real = blending.real
    vec2, vec3, *_ = types_of(real)
    values = wp.types.vector(blending.features, real)
    coefficients, squarings, reach = exponential(blending.alpha_min, blending.exp_degree)
    degree = blending.exp_degree
    library = blending.precision == "float64"
    # In this unit half the squared length of the offset is what the polynomial takes. With an odd number of
    # squarings, as in all presets, it is a power of two, and no digit of a factor is lost.
    unit = math.sqrt(0.5 if library else 0.5 ** (squarings + 1))
    lowest = reach / 2**squarings
    boxed = blending.boxed
    alpha_min, alpha_max = blending.alpha_min, SPLATTING.alpha_max
    transmittance_min = blending.transmittance_min

    @wp.func
    def falloff(x: real) -> real:
        """exp of x <= 0 times 2^squarings; in float64 exp of x."""
        if wp.static(library):
            return wp.exp(x)
        x = wp.where(x > real(wp.static(-lowest)), x, real(wp.static(-lowest)))
        p = real(wp.static(coefficients[degree]))
        for k in range(degree):  # a constant that names k unrolls the loop, as does the next one
            p = p * x + real(wp.static(coefficients[degree - 1 - k]))
        for k in range(squarings):
            p = p * p + real(wp.static(0.0 * k))
        return p

    @wp.func
    def response(opacity: real, factor: vec3, dx: real, dy: real, extent: vec2) -> real:
        u = factor[0] * dx + factor[1] * dy
        v = factor[2] * dy
        raw = opacity * falloff(-(u * u + v * v))
        if wp.static(boxed):
            raw = wp.where(wp.abs(dx) <= extent[0], raw, real(0.0))
            raw = wp.where(wp.abs(dy) <= extent[1], raw, real(0.0))
        return raw

    @wp.func
    def clipped(raw: real) -> real:
        alpha = wp.where(raw < real(wp.static(alpha_max)), raw, real(wp.static(alpha_max)))
        return wp.where(alpha < real(wp.static(alpha_min)), real(0.0), alpha)

    @wp.func
    def survives(left: real, live: int) -> int:
        return wp.where(left < real(wp.static(transmittance_min)), 0, live)

    @wp.func
    def features(
        index: int, colors: wp.array(dtype=vec3), depths: wp.array(dtype=real), normals: wp.array(dtype=vec3)
    ) -> values:
        color = colors[index]
        result = values(real(0.0))
        result[0] = color[0]
        result[1] = color[1]
        result[2] = color[2]
        if wp.static(blending.depth):
            result[3] = depths[index]
        if wp.static(blending.normals):
            normal = normals[index]
            result[wp.static(blending.normal_at)] = normal[0]
            result[wp.static(blending.normal_at + 1)] = normal[1]
            result[wp.static(blending.normal_at + 2)] = normal[2]
        return result

    return Rules(unit, response, clipped, survives, features)
