"""DIBR against ray casting in float64, homographies and finite differences, and on hostile input."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from diga3d_warp.errors import InputError
from diga3d_warp.kernels.launch import set_thread_count, thread_count
from diga3d_warp.scene.camera import Camera, Distortion
from diga3d_warp.splatting.reproject import reproject

BROWN = Distortion("brown", (-0.08, 0.02, 0.003, -0.002))
BROWN5 = Distortion("brown5", (-0.08, 0.02, 0.003, -0.002, 0.04))
FISHEYE = Distortion("fisheye", (0.03, -0.01, 0.002, 0.0))


def camera(width=24, height=18, focal=20.0, shift=(0.0, 0.0, 0.0), turn=(0.0, 0.0, 0.0), lens=None) -> Camera:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("xyz", turn).as_matrix()
    pose[:3, 3] = -pose[:3, :3] @ np.asarray(shift)
    return Camera(
        width, height, focal, 1.1 * focal, 0.5 * width + 0.3, 0.5 * height - 0.2, torch.tensor(pose), lens
    )


def rays(view: Camera) -> np.ndarray:
    columns, rows = np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
    return np.stack(
        [(columns - view.cx) / view.fx, (rows - view.cy) / view.fy, np.ones_like(columns)], axis=-1
    )


def plane_depth(view: Camera, normal=(0.2, 0.1, -1.0), distance=-3.0) -> np.ndarray:
    return distance / (rays(view) @ np.asarray(normal))


def smooth_image(height: int, width: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.linspace(0, 1, width), np.linspace(0, 1, height))
    a = rng.uniform(1.0, 4.0, (3, 3))
    return np.stack([0.5 + 0.4 * np.sin(k[0] * x + k[1] * y + k[2]) for k in a], axis=-1)


def cast_rays(image: np.ndarray, depth: np.ndarray, source: Camera, target: Camera):
    """Oracle: each target ray against each triangle of the source's mesh (Moller-Trumbore)."""
    relative = target.pose @ np.linalg.inv(source.pose)
    vertices = (rays(source) * depth[..., None]).reshape(-1, 3) @ relative[:3, :3].T + relative[:3, 3]
    colors = image.reshape(-1, 3)
    square = np.arange(source.height * source.width).reshape(source.height, source.width)
    a, b, c, d = square[:-1, :-1], square[:-1, 1:], square[1:, :-1], square[1:, 1:]
    upper = np.stack([a, b, c], -1).reshape(-1, 3)
    lower = np.stack([d, c, b], -1).reshape(-1, 3)
    triangles = np.concatenate([upper, lower])
    v0, v1, v2 = (vertices[triangles[:, k]] for k in range(3))
    out, z = np.zeros((target.height, target.width, 3)), np.zeros((target.height, target.width))
    for row in range(target.height):
        for column in range(target.width):
            ray = rays(target)[row, column]
            p = np.cross(ray, v2 - v0)
            det = np.einsum("nk,nk->n", v1 - v0, p)
            s = -v0
            with np.errstate(all="ignore"):
                u = np.einsum("nk,nk->n", s, p) / det
                q = np.cross(s, v1 - v0)
                v = q @ ray / det
                t = np.einsum("nk,nk->n", v2 - v0, q) / det
            hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
            if hit.any():
                n = np.flatnonzero(hit)[np.argmin(t[hit])]
                weights = np.array([1 - u[n] - v[n], u[n], v[n]])
                out[row, column] = weights @ colors[triangles[n]]
                z[row, column] = t[n]
    return out, z


def warp64(image, depth, source, target):
    return reproject(torch.tensor(image), torch.tensor(depth), source, target)


@pytest.mark.parametrize("lens", [None, BROWN, BROWN5, FISHEYE])
def test_the_same_camera_gives_the_image_back(lens):
    view = camera(lens=lens, shift=(1.0, -2.0, 0.5), turn=(0.1, 0.7, -0.3))
    image = torch.rand(18, 24, 3, generator=torch.Generator().manual_seed(0))
    depth = torch.tensor(plane_depth(view), dtype=torch.float32)
    out = reproject(image, depth, view, view)
    assert out.visible.all()
    torch.testing.assert_close(out.image, image, atol=1e-6, rtol=0)
    torch.testing.assert_close(out.depth, depth, atol=1e-6, rtol=1e-6)


def test_agrees_with_ray_casting():
    source = camera()
    target = camera(20, 16, 24.0, shift=(0.3, -0.2, 0.4), turn=(0.05, -0.1, 0.15))
    bumps = 1.0 + 0.05 * smooth_image(18, 24, 3)[..., 0]
    image, depth = smooth_image(18, 24), plane_depth(source) * bumps
    out = warp64(image, depth, source, target)
    expected, z = cast_rays(image, depth, source, target)
    seen = out.visible.numpy()
    assert seen.mean() > 0.7
    assert (seen == (z > 0)).mean() > 0.99
    np.testing.assert_allclose(out.image.numpy()[seen], expected[seen], atol=1e-9)
    np.testing.assert_allclose(out.depth.numpy()[seen], z[seen], atol=1e-9)
    assert out.image.numpy()[~seen].sum() == 0.0


def plane_points(view: Camera, normal=(0.2, 0.1, -1.0), distance=-3.0):
    """Depth of a plane in a view and its points in world space, with rays from OpenCV."""
    import cv2

    columns, rows = np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
    pixels = np.stack([columns, rows], -1).reshape(-1, 1, 2)
    matrix = np.array([[view.fx, 0, view.cx], [0, view.fy, view.cy], [0, 0, 1.0]])
    lens = view.distortion
    until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-14)
    if lens is not None and lens.kind == "fisheye":
        xy = cv2.fisheye.undistortPoints(pixels, matrix, np.array(lens.coefficients))
    else:
        coefficients = None if lens is None else np.array(lens.coefficients)
        xy = cv2.undistortPoints(pixels, matrix, coefficients, criteria=until)
    directions = np.concatenate([xy.reshape(-1, 2), np.ones((len(pixels), 1))], 1)
    to_world = np.linalg.inv(view.pose)
    origin, world = to_world[:3, 3], directions @ to_world[:3, :3].T
    depth = (distance - origin @ np.asarray(normal)) / (world @ np.asarray(normal))
    size = (view.height, view.width)
    return depth.reshape(size), (origin + world * depth[:, None]).reshape(*size, 3)


@pytest.mark.parametrize("source_lens", [None, BROWN, FISHEYE])
@pytest.mark.parametrize("target_lens", [None, BROWN, FISHEYE])
def test_a_plane_moves_as_its_function_says(source_lens, target_lens):
    """Colours that are a linear function of the plane's own coordinates survive any pair of lenses."""
    source = camera(96, 72, 80.0, lens=source_lens)
    target = camera(96, 72, 90.0, shift=(0.2, 0.1, 0.3), turn=(0.0, 0.05, 0.1), lens=target_lens)
    depth, points = plane_points(source)
    target_depth, target_points = plane_points(target)
    out = warp64(0.5 + 0.1 * points, depth, source, target)
    seen = out.visible.numpy()
    assert seen.mean() > 0.6
    np.testing.assert_allclose(out.image.numpy()[seen], 0.5 + 0.1 * target_points[seen], atol=2e-5)
    np.testing.assert_allclose(out.depth.numpy()[seen], target_depth[seen], atol=2e-4)


def two_planes():
    """A red square at depth 2 before a blue wall at depth 4."""
    view = camera(48, 36, 40.0)
    depth = torch.full((36, 48), 4.0)
    image = torch.zeros(36, 48, 3)
    image[..., 2] = 1.0
    depth[12:24, 18:30] = 2.0
    image[12:24, 18:30] = torch.tensor([1.0, 0.0, 0.0])
    return view, image, depth


def test_the_front_surface_wins_without_cracks_or_ghosts():
    view, image, depth = two_planes()
    target = camera(48, 36, 40.0, shift=(0.4, 0.0, 0.5))
    out = reproject(image, depth, view, target)
    near, far = out.visible & (out.depth < 2.5), out.visible & (out.depth > 2.5)
    # 11 px between the centres of the outer pixels, 2 / 1.5 times nearer
    assert near.sum() == pytest.approx((11 * 2 / 1.5) ** 2, rel=0.12)
    torch.testing.assert_close(
        out.image[near], torch.tensor([1.0, 0.0, 0.0]).expand(int(near.sum()), 3), atol=1e-6, rtol=0
    )
    torch.testing.assert_close(
        out.image[far], torch.tensor([0.0, 0.0, 1.0]).expand(int(far.sum()), 3), atol=1e-6, rtol=0
    )
    rows, columns = torch.nonzero(near, as_tuple=True)
    box = near[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
    assert box.all()
    assert (~out.visible).sum() > 10  # what the square hid stays unseen


def test_no_cracks_up_to_the_stretch_limit():
    source = camera(16, 12, 12.0)
    target = camera(64, 48, 12.0 * 4 * 3, lens=None)
    depth = torch.full((12, 16), 2.0)
    out = reproject(torch.full((12, 16, 3), 0.7), depth, source, target)
    assert out.visible.all()
    torch.testing.assert_close(out.image, torch.full((48, 64, 3), 0.7))


@pytest.mark.parametrize("bad", [0.0, -1.0, float("nan"), float("inf"), -float("inf"), 1e-38, 1e38])
def test_pixels_without_a_usable_depth_are_left_out(bad):
    view = camera()
    depth = torch.tensor(plane_depth(view), dtype=torch.float32)
    depth[8, 10] = bad
    image = torch.full((18, 24, 3), 0.5)
    image[8, 10] = float("nan")
    depth.requires_grad_()
    image.requires_grad_()
    out = reproject(image, depth, view, camera(shift=(0.05, 0.0, 0.0)))
    assert torch.isfinite(out.image).all() and torch.isfinite(out.depth).all()
    assert out.visible.float().mean() > 0.8
    (out.image.sum() + out.depth.sum()).backward()
    assert torch.isfinite(image.grad).all() and torch.isfinite(depth.grad).all()
    assert image.grad[8, 10].abs().sum() == 0.0 and depth.grad[8, 10] == 0.0
    assert image.grad.abs().sum() > 100.0


def test_points_behind_the_target_are_not_seen():
    view = camera()
    depth = torch.full((18, 24), 2.0)
    out = reproject(torch.ones(18, 24, 3), depth, view, camera(shift=(0.0, 0.0, 2.5)))
    assert not out.visible.any()
    assert out.image.sum() == 0.0
    turned = reproject(torch.ones(18, 24, 3), depth, view, camera(turn=(0.0, np.pi, 0.0)))
    assert not turned.visible.any()


def test_a_surface_seen_from_behind_is_not_seen():
    source = camera()
    behind = camera(shift=(0.0, 0.0, 6.0), turn=(0.0, np.pi, 0.0))
    assert not reproject(torch.ones(18, 24, 3), torch.full((18, 24), 3.0), source, behind).visible.any()


def test_points_beyond_the_fold_of_a_lens_do_not_come_back():
    source = camera(64, 48, 12.0)  # sees farther out than the lens of the target maps one to one
    target = camera(64, 48, 40.0, lens=Distortion("brown", (-0.6, 0.0, 0.0, 0.0)))
    radius = torch.tensor(np.linalg.norm(rays(source)[..., :2], axis=-1))
    image = radius[..., None].expand(48, 64, 3)
    out = reproject(image, torch.full((48, 64), 2.0, dtype=torch.float64), source, target)
    assert radius.max() > 2.0
    assert out.visible.sum() > 1000
    assert out.image[out.visible].max() < np.sqrt(1 / 1.8)


def test_gradients_agree_with_finite_differences():
    source = camera(10, 8, 9.0)
    target = camera(9, 8, 10.0, shift=(0.13, -0.07, 0.21), turn=(0.02, 0.03, -0.05), lens=BROWN)
    image = torch.tensor(smooth_image(8, 10), requires_grad=True)
    depth = torch.tensor(
        plane_depth(source) * (1 + 0.02 * smooth_image(8, 10, 5)[..., 0]), requires_grad=True
    )
    generator = torch.Generator().manual_seed(3)
    color_weight = torch.rand(8, 9, 3, generator=generator, dtype=torch.float64)
    depth_weight = torch.rand(8, 9, generator=generator, dtype=torch.float64)

    def loss(image, depth):
        out = reproject(image, depth, source, target)
        assert out.visible.float().mean() > 0.6
        return (out.image * color_weight).sum() + (out.depth * depth_weight).sum()

    assert torch.autograd.gradcheck(loss, (image, depth), eps=1e-7, atol=1e-5)


def test_the_gradient_in_the_image_is_the_transpose():
    view, image, depth = two_planes()
    target = camera(48, 36, 40.0, shift=(0.3, 0.1, 0.2))
    image = image.requires_grad_()
    weight = torch.rand(36, 48, 3, generator=torch.Generator().manual_seed(1))
    out = reproject(image, depth, view, target)
    (out.image * weight).sum().backward()
    other = torch.rand(36, 48, 3, generator=torch.Generator().manual_seed(2))
    forward = (reproject(other, depth, view, target).image * weight).sum()
    torch.testing.assert_close((image.grad * other).sum(), forward, rtol=1e-5, atol=1e-5)
    assert forward > 10.0


def test_equal_depths_and_thread_counts_do_not_change_a_byte():
    # a fold: two parts of the source land on the same pixels at the same depth
    source = camera(48, 36, 40.0)
    target = camera(48, 36, 40.0, shift=(0.2, 0.0, 0.0))
    generator = torch.Generator().manual_seed(4)
    image = torch.rand(36, 48, 3, generator=generator)
    depth = 3.0 + 0.1 * torch.rand(36, 48, generator=generator)
    before = thread_count()
    results = []
    try:
        for threads in (1, 2, 5):
            set_thread_count(threads)
            i, d = image.clone().requires_grad_(), depth.clone().requires_grad_()
            out = reproject(i, d, source, target)
            (out.image.square().sum() + out.depth.sum()).backward()
            results.append((out.image, out.depth, out.visible, i.grad, d.grad))
    finally:
        set_thread_count(before)
    assert results[0][2].float().mean() > 0.5
    for other in results[1:]:
        for a, b in zip(results[0], other, strict=True):
            assert torch.equal(a, b)


def test_shapes_that_do_not_fit_are_refused():
    view = camera()
    with pytest.raises(InputError, match="24 x 18"):
        reproject(torch.rand(18, 23, 3), torch.ones(18, 24), view, view)
    with pytest.raises(InputError, match="float32"):
        reproject(torch.rand(18, 24, 3), torch.ones(18, 24, dtype=torch.float64), view, view)
