"""Reprojection on Warp arrays: recorded on a tape, and the depth steps that carry no pixels."""

import numpy as np
import warp as wp

from diga3d_warp.kernels.launch import launch
from diga3d_warp.kernels.reprojection import Motion, reproject, reproject_adjoint, steps_kernel

WIDTH, HEIGHT = 12, 9


def sideways_motion() -> Motion:
    columns, rows = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    rays = np.stack([(columns - 6.0) / 10.0, (rows - 4.5) / 10.0], -1).reshape(-1, 2)
    return Motion(
        WIDTH, HEIGHT, wp.array(rays, dtype=wp.vec2d, device="cpu"),
        wp.mat33d(np.eye(3)), wp.vec3d(-0.2, 0.0, 0.0),
        WIDTH, HEIGHT, "none", wp.vec4d(10.0, 10.0, 6.0, 4.5), wp.vec4d(), 1e15,
    )  # fmt: skip


def test_a_tape_carries_the_gradient():
    """A wall at depth 2 moved by 0.2 shifts by one pixel: the gradient comes back shifted."""
    motion, pixels = sideways_motion(), WIDTH * HEIGHT
    rng = np.random.default_rng(0)
    image = wp.array(rng.random((pixels, 3)), dtype=wp.vec3, device="cpu", requires_grad=True)
    depth = wp.full(pixels, 2.0, dtype=float, device="cpu", requires_grad=True)
    outputs = [
        wp.zeros(pixels, dtype=wp.vec3, device="cpu", requires_grad=True),
        wp.zeros(pixels, dtype=float, device="cpu", requires_grad=True),
        wp.zeros(pixels, dtype=wp.bool, device="cpu"),
    ]
    with wp.Tape() as tape:
        buffers = reproject(image, depth, motion, outputs)
        tape.record_func(
            lambda: reproject_adjoint(
                image,
                depth,
                motion,
                outputs,
                *buffers,
                [outputs[0].grad, outputs[1].grad],
                image.grad,
                depth.grad,
            ),
            [image, depth],
        )
    weight = rng.random((HEIGHT, WIDTH, 3)).astype(np.float32)
    tape.backward(grads={outputs[0]: wp.array(weight.reshape(-1, 3), dtype=wp.vec3, device="cpu")})

    source = image.numpy().reshape(HEIGHT, WIDTH, 3)
    moved = outputs[0].numpy().reshape(HEIGHT, WIDTH, 3)
    np.testing.assert_allclose(moved[:, :-1], source[:, 1:], atol=1e-5)
    assert not outputs[2].numpy().reshape(HEIGHT, WIDTH)[:, -1].any()
    gradient = image.grad.numpy().reshape(HEIGHT, WIDTH, 3)
    np.testing.assert_allclose(gradient[:, 1:], weight[:, :-1], atol=1e-5)
    np.testing.assert_allclose(gradient[:, 0], 0.0, atol=1e-5)
    assert np.abs(depth.grad.numpy()).max() > 1e-3


def test_only_the_far_side_of_a_step_is_dropped():
    depth = np.full((HEIGHT, WIDTH), 4.0, np.float32)
    depth[3:6, 4:8] = 2.0
    depth[0, 0] = np.nan
    depth[8, 0] = 0.0
    behind = wp.zeros(depth.size, dtype=wp.uint8, device="cpu")
    launch(steps_kernel(), depth.size, [wp.array(depth.ravel(), device="cpu"), WIDTH], [behind], device="cpu")
    expected = np.zeros((HEIGHT, WIDTH), bool)
    expected[2:7, 3:9] = True
    expected[3:6, 4:8] = False
    np.testing.assert_array_equal(behind.numpy().reshape(HEIGHT, WIDTH).astype(bool), expected)
