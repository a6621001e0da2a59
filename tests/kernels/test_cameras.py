"""Lens models against OpenCV, finite differences and their own inverse."""

import math

import numpy as np
import pytest
import warp as wp

from diga3d_warp.kernels.cameras import lens_model, pixel_rays_kernel, valid_radius
from diga3d_warp.kernels.launch import DIFFERENTIABLE, launch

LENSES = {
    "none": (0.0, 0.0, 0.0, 0.0),
    "brown": (-0.21, 0.06, 0.004, -0.003),
    "brown5": (-0.21, 0.06, 0.004, -0.003, -0.05),
    "fisheye": (0.05, -0.02, 0.004, -0.0006),
}
vec2d = wp.types.vector(length=2, dtype=wp.float64)
mat22d = wp.types.matrix(shape=(2, 2), dtype=wp.float64)


def distort_kernel(kind: str) -> wp.Kernel:
    model = lens_model(kind, wp.float64)
    vector, distort, jacobian = model.vector, model.distort, model.distort_jacobian

    @wp.kernel(module="unique", module_options=DIFFERENTIABLE)
    def run(
        offset: int,
        points: wp.array(dtype=vec2d),
        k: vector,
        # outputs
        distorted: wp.array(dtype=vec2d),
        jacobians: wp.array(dtype=mat22d),
    ):
        i = wp.tid() + offset
        p = points[i]
        u, v = distort(p[0], p[1], k)
        xx, xy, yy = jacobian(p[0], p[1], k)
        distorted[i] = vec2d(u, v)
        jacobians[i] = mat22d(xx, xy, xy, yy)

    return run


def distort(kind: str, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    source = wp.array(points, dtype=vec2d, device="cpu")
    distorted = wp.zeros(len(points), dtype=vec2d, device="cpu")
    jacobians = wp.zeros(len(points), dtype=mat22d, device="cpu")
    launch(
        distort_kernel(kind),
        len(points),
        [source, lens_model(kind, wp.float64).vector(*LENSES[kind])],
        [distorted, jacobians],
        device="cpu",
    )
    return distorted.numpy(), jacobians.numpy()


def scattered_points() -> np.ndarray:
    points = np.random.default_rng(1).uniform(-0.8, 0.8, (200, 2))
    points[0] = 0.0
    points[1] = (1e-9, -1e-9)
    return points


@pytest.mark.parametrize("kind", ["brown", "brown5", "fisheye"])
def test_distort_agrees_with_opencv(kind):
    import cv2

    points = scattered_points()
    homogeneous = np.concatenate([points, np.ones((len(points), 1))], 1)[:, None]
    project = cv2.fisheye.projectPoints if kind == "fisheye" else cv2.projectPoints
    zero = np.zeros(3)
    expected = project(homogeneous, zero, zero, np.eye(3), np.array(LENSES[kind]))[0][:, 0]
    np.testing.assert_allclose(distort(kind, points)[0], expected, atol=1e-12)
    assert np.abs(expected - points).max() > 0.02


@pytest.mark.parametrize("kind", LENSES)
def test_jacobian_is_the_derivative(kind):
    points = scattered_points()
    step = 1e-6
    columns = [
        (distort(kind, points + shift)[0] - distort(kind, points - shift)[0]) / (2 * step)
        for shift in (np.array([step, 0.0]), np.array([0.0, step]))
    ]
    np.testing.assert_allclose(distort(kind, points)[1], np.stack(columns, -1), atol=1e-8)


@pytest.mark.parametrize("kind", LENSES)
def test_automatic_adjoint_is_the_jacobian(kind):
    points = scattered_points()
    rng = np.random.default_rng(2)
    weight = rng.normal(size=(len(points), 2))
    source = wp.array(points, dtype=vec2d, device="cpu", requires_grad=True)
    distorted = wp.zeros(len(points), dtype=vec2d, device="cpu", requires_grad=True)
    jacobians = wp.zeros(len(points), dtype=mat22d, device="cpu", requires_grad=True)
    with wp.Tape() as tape:
        wp.launch(
            distort_kernel(kind),
            len(points),
            inputs=[0, source, lens_model(kind, wp.float64).vector(*LENSES[kind])],
            outputs=[distorted, jacobians],
            device="cpu",
        )
    tape.backward(grads={distorted: wp.array(weight, dtype=vec2d, device="cpu")})
    expected = np.einsum("nij,ni->nj", jacobians.numpy(), weight)
    np.testing.assert_allclose(source.grad.numpy(), expected, atol=1e-7)


@pytest.mark.parametrize("scalar", [wp.float32, wp.float64])
@pytest.mark.parametrize("kind", LENSES)
def test_pixel_rays_invert_the_lens(kind, scalar):
    width, height, focal = 64, 48, 60.0
    vec2, vec4 = wp.types.vector(length=2, dtype=scalar), wp.types.vector(length=4, dtype=scalar)
    rays = wp.zeros(width * height, dtype=vec2, device="cpu")
    intrinsics, k = vec4(focal, focal, 32.0, 24.0), lens_model(kind, scalar).vector(*LENSES[kind])
    limit = scalar(valid_radius(kind, LENSES[kind]))
    launch(
        pixel_rays_kernel(kind, scalar), width * height, [width, intrinsics, k, limit], [rays], device="cpu"
    )
    found = rays.numpy().astype(np.float64)
    assert np.isfinite(found).all()
    again = distort(kind, found)[0] * focal + (32.0, 24.0)
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    expected = np.stack([columns, rows], -1).reshape(-1, 2)
    np.testing.assert_allclose(again, expected, atol=2e-5 if scalar is wp.float32 else 1e-9)


def test_pixels_outside_the_range_of_a_lens_have_no_ray():
    # r (1 - 0.4 r^2) never exceeds 0.609: pixels farther out see nothing that this lens can map
    coefficients = (-0.4, 0.0, 0.0, 0.0)
    rays = wp.zeros(101, dtype=wp.vec2, device="cpu")
    launch(
        pixel_rays_kernel("brown"),
        101,
        [101, wp.vec4(100.0, 100.0, 0.5, 0.5), wp.vec4(*coefficients), valid_radius("brown", coefficients)],
        [rays],
        device="cpu",
    )
    reached = np.isfinite(rays.numpy()).all(1)
    assert reached[:60].all()
    assert not reached[61:].any()


def test_valid_radius_is_where_the_lens_folds():
    assert valid_radius("none") == math.inf
    assert valid_radius("brown", (0.1, 0.02, 0.0, 0.0)) == math.inf
    assert valid_radius("brown", (-0.4, 0.0, 0.0, 0.0)) == pytest.approx(math.sqrt(1 / 1.2))
    assert valid_radius("brown", (-0.4, 0.0, 0.01, 0.0)) < math.sqrt(1 / 1.2)
    assert valid_radius("brown5", (0.1, 0.02, 0.0, 0.0, 0.01)) == math.inf
    assert valid_radius("brown5", (0.0, 0.0, 0.0, 0.0, -0.2)) == pytest.approx((1 / 1.4) ** (1 / 6))
    shorter = (-0.4, 0.1, 0.01, 0.0)
    assert valid_radius("brown5", (*shorter, 0.0)) == valid_radius("brown", shorter)
    assert valid_radius("fisheye") == math.inf
    assert valid_radius("fisheye", (-0.5, 0.0, 0.0, 0.0)) == pytest.approx(math.tan(math.sqrt(1 / 1.5)))


@pytest.mark.parametrize(
    "kind,coefficients",
    [
        ("brown", (-0.3, 0.02, 0.01, -0.02)),
        ("brown5", (0.2, 0.1, 0.01, -0.02, -0.3)),
        ("fisheye", (-0.3, 0.0, 0.0, 0.0)),
    ],
)
def test_the_jacobian_stays_positive_below_the_valid_radius(kind, coefficients, monkeypatch):
    monkeypatch.setitem(LENSES, kind, coefficients)
    limit = valid_radius(kind, coefficients)
    angle = np.linspace(0.0, 2 * np.pi, 400)
    directions = np.stack([np.cos(angle), np.sin(angle)], -1)
    for radius in np.linspace(0.0, 0.999 * limit, 20):
        assert np.linalg.det(distort(kind, radius * directions)[1]).min() > 0.0
    beyond = np.linalg.det(distort(kind, 1.2 * limit * directions)[1])
    assert beyond.min() < 0.0
