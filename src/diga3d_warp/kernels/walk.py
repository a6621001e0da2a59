"""The random walk of faint gaussians within their own shape (3DGS-MCMC, Kheradmand et al. 2024, Eq. 8).

    mean += gate(opacity) length Sigma n,   n normal,   Sigma = R S S R^T

Invariants
- A gaussian's noise depends on the seed and its index alone, not on threads or on which others walk.
- Opaque, held and shapeless gaussians, and what is not finite, stay where they are.
"""

from __future__ import annotations

import math

import warp as wp

from diga3d_warp.config import SPLATTING
from diga3d_warp.kernels.footprint import rotation_function
from diga3d_warp.kernels.launch import OPTIONS, launch

wp.set_module_options(OPTIONS)

rotation_of = rotation_function(wp.float32)


@wp.func
def sigmoid(x: float) -> float:
    return 1.0 / (1.0 + wp.exp(-x))


@wp.kernel
def walk_faint(
    offset: int,
    seed: int,
    log_scales: wp.array(dtype=wp.vec3),
    quaternions: wp.array(dtype=wp.vec4),
    opacity_logits: wp.array(dtype=float),
    held: wp.array(dtype=wp.bool),
    logit_max: float,
    steepness: float,
    threshold: float,
    length: float,
    # outputs
    means: wp.array(dtype=wp.vec3),
):
    i = wp.tid() + offset
    logit = opacity_logits[i]
    if held[i] or not (logit < logit_max):
        return
    q = quaternions[i]
    if not (wp.dot(q, q) >= wp.static(SPLATTING.quaternion_min)):
        return
    state = wp.rand_init(seed, i)
    noise = wp.vec3(wp.randn(state), wp.randn(state), wp.randn(state))
    turn = rotation_of(q)
    scale = log_scales[i]
    variances = wp.vec3(wp.exp(2.0 * scale[0]), wp.exp(2.0 * scale[1]), wp.exp(2.0 * scale[2]))
    shaped = turn * wp.cw_mul(variances, wp.transpose(turn) * noise)
    step = (length * sigmoid(steepness * (1.0 - sigmoid(logit) - threshold))) * shaped
    if wp.isfinite(step):
        means[i] = means[i] + step


def walk(
    seed: int, shapes: list[wp.array], held: wp.array, opacity_max: float, steepness: float,
    threshold: float, length: float, means: wp.array,
) -> None:  # fmt: skip
    """Move faint gaussians.

    Args:
        seed: Of the noise, an integer of 31 bits.
        shapes: log_scales (N,) vec3, quaternions (N,) vec4, opacity_logits (N,), float32.
        held: Gaussians that stay, shape (N,), bool.
        opacity_max: Gaussians from this opacity on stay, in (0, 1).
        steepness, threshold: The gate is the sigmoid of steepness (1 - opacity - threshold).
        length: Of a step at full gate, for a covariance of one [1 / scene units].
        means: Output, moved in place, shape (N,), vec3.
    """
    launch(
        walk_faint, means.shape[0],
        [seed, *shapes, held, math.log(opacity_max / (1.0 - opacity_max)), steepness, threshold, length],
        [means],
        device=means.device, work=2,
    )  # fmt: skip
