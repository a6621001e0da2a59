"""Functions of one number without library calls, which would keep a loop over lanes from being vectorised.

Invariants
- In float64 they are Warp's own: scalar, and exact to the last digit.
- In float32 the exponential is right to 4e-7 of itself, the logarithm to 2e-7 of itself or of one.
- Neither raises or returns NaN for any number, infinity or NaN: the argument is brought into range first.
"""

import math
from functools import cache
from typing import Any

import numpy as np
import warp as wp
from numpy.polynomial import Chebyshev, Polynomial

EXP_DEGREE = 6
"""Of the polynomial on half a unit of log 2 to either side: it misses by 2e-9."""

LOG_DEGREE = 9
"""Of the polynomial on [1, 2]: it misses by 2e-8."""

EXP_RANGE = (-87.0, 88.0)
"""Where the exponential is a normal float32; it is constant outside."""

REDUCED = """
#ifndef __CUDA_ARCH__
#pragma clang fp reassociate(off)
#endif
return (x - k * coarse) - k * fine;
"""

POWER_OF_TWO = """
#ifdef __CUDA_ARCH__
return __int_as_float((k + 127) << 23);
#else
const int bits = (k + 127) << 23;
float power;
__builtin_memcpy(&power, &bits, sizeof(power));
return power;
#endif
"""

BITS = """
#ifdef __CUDA_ARCH__
return __float_as_int(x);
#else
int bits;
__builtin_memcpy(&bits, &x, sizeof(bits));
return bits;
#endif
"""


@wp.func_native(REDUCED)
def reduced(x: float, k: float, coarse: float, fine: float) -> float:
    """x - k (coarse + fine), where the sum has more digits than a float32 holds."""


@wp.func_native(POWER_OF_TWO)
def power_of_two(k: int) -> float: ...


@wp.func_native(BITS)
def bits_of(x: float) -> int: ...


def coefficients(function: Any, degree: int, domain: tuple[float, float]) -> tuple[float, ...]:
    """Of the polynomial that interpolates a function in Chebyshev's points, lowest first."""
    found = Chebyshev.interpolate(function, degree, domain=domain).convert(kind=Polynomial)
    return tuple(float(c) for c in found.coef)


@cache
def clamp_function(real: Any) -> Any:
    """Warp function: x, no lower than `low` and no higher than `high`. Warp's own asks a library for NaN."""

    @wp.func
    def clamp(x: real, low: real, high: real) -> real:
        x = wp.where(x > low, x, low)
        return wp.where(x < high, x, high)

    return clamp


@cache
def exp_function(real: Any) -> Any:
    """Warp function: exp(x), differentiable."""
    if real is wp.float64:
        return wp.exp
    lowest, highest = EXP_RANGE
    terms = coefficients(np.exp, EXP_DEGREE, (-0.5 * math.log(2.0), 0.5 * math.log(2.0)))
    coarse = 355.0 / 512.0  # log 2 to nine bits: its products with whole numbers are exact
    fine = math.log(2.0) - coarse

    @wp.func
    def exp(x: float) -> float:
        x = wp.where(x > wp.static(lowest), x, wp.static(lowest))
        x = wp.where(x < wp.static(highest), x, wp.static(highest))
        k = wp.floor(x * wp.static(1.0 / math.log(2.0)) + 0.5)
        r = reduced(x, k, wp.static(coarse), wp.static(fine))
        p = float(wp.static(terms[EXP_DEGREE]))
        for j in range(EXP_DEGREE):  # a constant that names j unrolls the loop
            p = p * r + wp.static(terms[EXP_DEGREE - 1 - j])
        return p * power_of_two(int(k))

    @wp.func_grad(exp)
    def adj_exp(x: float, adj_y: float):
        wp.adjoint[x] += exp(x) * adj_y

    return exp


@cache
def log_function(real: Any) -> Any:
    """Warp function: log(x) of a normal number above 0. Carries no gradient in float32."""
    if real is wp.float64:
        return wp.log
    terms = coefficients(lambda m: np.log1p(m), LOG_DEGREE, (0.0, 1.0))

    @wp.func
    def log(x: float) -> float:
        bits = bits_of(x)
        exponent = float((bits >> 23) - 127)
        m = float(bits & 0x7FFFFF) * wp.static(2.0**-23)  # x = 2^exponent (1 + m)
        p = float(wp.static(terms[LOG_DEGREE]))
        for j in range(LOG_DEGREE):
            p = p * m + wp.static(terms[LOG_DEGREE - 1 - j])
        return exponent * wp.static(math.log(2.0)) + p

    return log
