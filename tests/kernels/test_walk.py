"""The random walk of faint gaussians: who walks, and what the noise depends on."""

import numpy as np
import warp as wp

from diga3d_warp.kernels.walk import walk

COUNT = 5000


def walked(quaternions: np.ndarray, logits: np.ndarray, held: np.ndarray, seed: int = 1) -> np.ndarray:
    """Means that were at zero, after one step."""
    count = len(logits)
    scales = np.log(np.tile([[0.1, 0.2, 0.3]], (count, 1))).astype(np.float32)
    means = wp.zeros(count, dtype=wp.vec3, device="cpu")
    shapes = [
        wp.array(values, dtype=dtype, device="cpu")
        for values, dtype in ((scales, wp.vec3), (quaternions, wp.vec4), (logits, float))
    ]
    walk(seed, shapes, wp.array(held, dtype=wp.bool, device="cpu"), 0.07, 100.0, 0.995, 1.0, means)
    return means.numpy()


def faint(count: int = COUNT) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Turned gaussians of an opacity of a quarter percent, none of them held."""
    quaternions = np.random.default_rng(0).normal(size=(count, 4)).astype(np.float32)
    return quaternions, np.full(count, -6.0, np.float32), np.zeros(count, bool)


def test_noise_depends_on_seed_and_index_alone(threads):
    quaternions, logits, held = faint()
    threads(1)
    alone = walked(quaternions, logits, held)
    threads(3)
    assert np.array_equal(alone, walked(quaternions, logits, held))
    logits[::2] = 2.0
    half = walked(quaternions, logits, held)
    assert np.array_equal(half[1::2], alone[1::2]) and not half[::2].any()
    assert (
        not np.isclose(alone, walked(quaternions, np.full_like(logits, -6.0), held, seed=2)).any(1).mean()
        > 0.1
    )


def test_what_has_no_shape_or_no_number_stays():
    quaternions, logits, held = faint(6)
    quaternions[0] = 0.0
    quaternions[1, 2] = np.nan
    quaternions[2, 0] = np.inf
    logits[3] = np.nan
    held[4] = True
    moved = walked(quaternions, logits, held).any(1)
    assert moved.tolist() == [False] * 5 + [True]
