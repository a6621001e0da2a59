"""Exponential and logarithm against NumPy's in float64."""

import numpy as np
import pytest
import warp as wp

from diga3d_warp.kernels.elementary import EXP_RANGE, clamp_function, exp_function, log_function
from diga3d_warp.kernels.launch import OPTIONS, launch


def evaluated(function, numbers: np.ndarray, real=wp.float32) -> np.ndarray:
    @wp.kernel(module="unique", module_options=OPTIONS)
    def run(offset: int, x: wp.array(dtype=real), y: wp.array(dtype=real)):
        i = wp.tid() + offset
        y[i] = function(x[i])

    source = wp.array(numbers, dtype=real, device="cpu")
    result = wp.zeros_like(source)
    launch(run, len(numbers), [source], [result], device="cpu")
    return result.numpy().astype(np.float64)


def test_exp_is_right_to_the_last_digits():
    x = np.linspace(*EXP_RANGE, 200_001).astype(np.float32)
    x = np.concatenate([x, np.linspace(-1e-3, 1e-3, 1001).astype(np.float32)])
    exact = np.exp(x.astype(np.float64))
    assert np.abs(evaluated(exp_function(wp.float32), x) / exact - 1.0).max() < 4e-7


def test_exp_is_finite_whatever_it_is_given():
    odd = np.array([np.inf, -np.inf, np.nan, 1e38, -1e38, 0.0, -0.0, 1e-45])
    found = evaluated(exp_function(wp.float32), odd)
    assert np.isfinite(found).all() and (found > 0.0).all()
    assert found[1] < 1e-37 and found[0] > 1e37 and (found[5:] == 1.0).all()


def test_log_is_right_to_the_last_digits():
    random = np.random.default_rng(0)
    x = np.concatenate([np.exp(random.uniform(-80.0, 80.0, 100_000)), np.linspace(1.0, 2.0, 10_001)])
    x = x.astype(np.float32)
    exact = np.log(x.astype(np.float64))
    error = np.abs(evaluated(log_function(wp.float32), x) - exact)
    assert (error < 2e-7 * np.maximum(1.0, np.abs(exact))).all()
    assert np.isfinite(evaluated(log_function(wp.float32), np.array([0.0, -1.0, np.inf, np.nan]))).all()


def test_the_derivative_of_exp_is_exp():
    exp = exp_function(wp.float32)

    @wp.func
    def doubled(x: wp.float32) -> wp.float32:  # not `float`, of which Warp 1.19 derives code that fails
        return 2.0 * exp(x)

    pulled = wp.grad(doubled)

    @wp.func
    def slope(x: float) -> float:
        return 0.5 * pulled(x)

    x = np.linspace(-20.0, 20.0, 1001).astype(np.float32)
    np.testing.assert_allclose(evaluated(slope, x), np.exp(x.astype(np.float64)), rtol=1e-6)


@pytest.mark.parametrize("real", [wp.float32, wp.float64])
def test_clamp_brings_everything_into_range(real):
    clamp = clamp_function(real)
    low, high = real(-1.5), real(2.0)

    @wp.func
    def clamped(x: real) -> real:
        return clamp(x, low, high)

    found = evaluated(clamped, np.array([-np.inf, -2.0, 0.25, 3.0, np.inf, np.nan]), real)
    assert found[:5].tolist() == [-1.5, -1.5, 0.25, 2.0, 2.0]
    assert -1.5 <= found[5] <= 2.0


def test_in_float64_they_are_the_library_s():
    assert exp_function(wp.float64) is wp.exp and log_function(wp.float64) is wp.log
