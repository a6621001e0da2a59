"""DIBR with points in place of a mesh, and with several samples per pixel."""

import numpy as np
import pytest
import torch

from diga3d_warp.config import Accuracy
from diga3d_warp.errors import InputError
from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.reproject import reproject

POINTS = Accuracy(sampling="nearest")
WIDTH, HEIGHT, FOCAL = 24, 18, 20.0


def camera(shift=(0.0, 0.0, 0.0), turned: bool = False, focal: float = FOCAL) -> Camera:
    pose = np.eye(4)
    if turned:
        pose[:3, :3] = np.diag([-1.0, 1.0, -1.0])
    pose[:3, 3] = -pose[:3, :3] @ np.asarray(shift)
    return Camera(WIDTH, HEIGHT, focal, focal, 12.0, 9.0, torch.tensor(pose))


def picture(seed: int = 0, dtype: torch.dtype = torch.float32) -> torch.Tensor:
    return torch.rand(HEIGHT, WIDTH, 3, generator=torch.Generator().manual_seed(seed), dtype=dtype)


def test_points_give_the_same_camera_its_image_back():
    image, depth = picture(), 2.0 + picture(1)[..., 0] * 0.05
    out = reproject(image, depth, camera(), camera(), accuracy=POINTS)
    assert out.visible.all()
    assert torch.equal(out.image, image)
    torch.testing.assert_close(out.depth, depth, rtol=1e-6, atol=0)


def test_points_move_by_whole_pixels_and_fall_off_the_border():
    """A wall at depth 2, seen from three pixels to the right: the left edge leaves, the right is unseen."""
    image = picture()
    out = reproject(
        image, torch.full((HEIGHT, WIDTH), 2.0), camera(), camera((0.3, 0.0, 0.0)), accuracy=POINTS
    )
    assert torch.equal(out.image[:, :-3], image[:, 3:])
    assert not out.visible[:, -3:].any() and not out.image[:, -3:].any() and not out.depth[:, -3:].any()


def test_points_on_the_very_border_stay_in_their_row():
    """Half a pixel sideways, centres lie on borders between pixels: rounding decides, and none wraps."""
    rows = (torch.arange(HEIGHT)[:, None, None] / HEIGHT).expand(HEIGHT, WIDTH, 3)
    half = 0.5 * 2.0 / FOCAL
    for sign in (-1.0, 1.0):
        shifted = camera((sign * half, 0.0, 0.0))
        depth = torch.full((HEIGHT, WIDTH), 2.0)
        out = reproject(rows, depth, camera(), shifted, accuracy=POINTS)
        assert out.visible.float().mean() > 0.7
        assert torch.equal(out.image[out.visible], rows[out.visible])


def test_the_nearest_point_wins_and_at_equal_depth_the_first():
    image, depth = picture(), torch.full((HEIGHT, WIDTH), 4.0)
    depth[:, 12:] = 1.0
    out = reproject(image, depth, camera(), camera((0.5, 0.0, 0.0)), accuracy=POINTS)
    near = out.visible & (out.depth < 2.0)
    assert near.sum() > 20
    # A wall at 1 moves 10 px to the left, one at 4 by 2.5 px: the near one covers the far one.
    assert torch.equal(out.image[:, 2:14], image[:, 12:24])
    # Ten times farther off, ten by ten pixels fall into one: the first of them, row by row, is kept.
    shrunk = reproject(
        image, torch.full((HEIGHT, WIDTH), 1.0), camera(), camera((0, 0, -9.0)), accuracy=POINTS
    )
    rows, columns = torch.nonzero(shrunk.visible, as_tuple=True)
    assert 4 <= len(rows) <= 9
    first = min(
        (r, c) for r in range(HEIGHT) for c in range(WIDTH)
        if int((c + 0.5 - 12) / 10 + 12) == columns[0] and int((r + 0.5 - 9) / 10 + 9) == rows[0]
    )  # fmt: skip
    assert torch.equal(shrunk.image[rows[0], columns[0]], image[first])


def test_points_behind_a_depth_step_are_left_out():
    """Their colour is mixed with the nearer surface's."""
    depth = torch.full((HEIGHT, WIDTH), 4.0)
    depth[:, 12:] = 2.0
    out = reproject(picture(), depth, camera(), camera(), accuracy=POINTS)
    assert not out.visible[:, 11].any()
    assert out.visible[:, :11].all() and out.visible[:, 12:].all()


def test_points_crack_where_a_mesh_does_not():
    """What the mesh is for: twice as near, points reach a quarter of the pixels."""
    depth = torch.full((HEIGHT, WIDTH), 2.0)
    seen = {
        sampling: reproject(
            picture(), depth, camera(), camera(focal=2 * FOCAL), accuracy=Accuracy(sampling=sampling)
        ).visible.float().mean()
        for sampling in ("nearest", "bilinear")
    }  # fmt: skip
    assert seen["nearest"] == pytest.approx(0.25, abs=0.04)
    assert seen["bilinear"] == 1.0


@pytest.mark.parametrize("bad", [0.0, -1.0, float("nan"), float("inf"), 1e-38, 1e38])
@pytest.mark.parametrize("accuracy", [POINTS, Accuracy(supersampling=2)])
def test_depths_that_are_none_are_left_out(accuracy, bad):
    image, depth = picture(), torch.full((HEIGHT, WIDTH), 2.0)
    depth[8, 10] = bad
    image[8, 10] = float("nan")
    image.requires_grad_()
    depth.requires_grad_()
    out = reproject(image, depth, camera(), camera((0.05, 0.0, 0.0)), accuracy=accuracy)
    (out.image.sum() + out.depth.sum()).backward()
    assert out.visible.float().mean() > 0.8
    for tensor in (out.image, out.depth, image.grad, depth.grad):
        assert tensor.isfinite().all()
    assert not image.grad[8, 10].any() and depth.grad[8, 10] == 0
    assert image.grad.sum() > 100


@pytest.mark.parametrize("accuracy", [POINTS, Accuracy(supersampling=3)])
def test_nothing_behind_the_target_is_seen(accuracy):
    depth = torch.full((HEIGHT, WIDTH), 2.0)
    for target in (camera((0.0, 0.0, 2.5)), camera(turned=True)):
        out = reproject(picture(), depth, camera(), target, accuracy=accuracy)
        assert not out.visible.any() and not out.image.any() and not out.depth.any()


@pytest.mark.parametrize("accuracy", [POINTS, Accuracy(supersampling=2)])
def test_gradients_agree_with_finite_differences(accuracy):
    source = camera().resized(8, 6)
    target = camera((0.11, -0.07, 0.13)).resized(8, 6)
    image = picture(dtype=torch.float64)[:6, :8].clone().requires_grad_()
    depth = (2.0 + 0.02 * picture(2, torch.float64)[:6, :8, 0]).requires_grad_()

    def parts(image, depth):
        out = reproject(image, depth, source, target, accuracy=accuracy)
        assert out.visible.float().mean() > 0.5
        return out.image, out.depth

    assert torch.autograd.gradcheck(parts, (image, depth), eps=1e-7, atol=1e-5)


def test_bits_do_not_depend_on_the_number_of_threads(threads):
    results = []
    for count in (1, 2, 5):
        threads(count)
        image, depth = picture().requires_grad_(), (2.0 + 0.1 * picture(1)[..., 0]).requires_grad_()
        out = reproject(image, depth, camera(), camera((0.2, 0.1, -0.3)), accuracy=POINTS)
        (out.image.square().sum() + out.depth.sum()).backward()
        results.append((*out, image.grad, depth.grad))
    assert results[0][2].float().mean() > 0.5
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))


@pytest.mark.parametrize("times", [2, 3])
def test_several_samples_make_an_edge_of_mixed_pixels(times):
    """A red half-plane before a blue one, four times smaller in the target: one sample takes one colour."""
    image = torch.zeros(HEIGHT, WIDTH, 3)
    image[:, :13, 0] = 1.0
    image[:, 13:, 2] = 1.0
    depth = torch.full((HEIGHT, WIDTH), 2.0)
    far = camera((0.0, 0.0, -6.0))
    single, several = (
        reproject(image, depth, camera(), far, accuracy=Accuracy(sampling="nearest", supersampling=n))
        for n in (1, times)
    )

    def mixed(warp) -> torch.Tensor:
        return warp.visible & (warp.image[..., 0] > 0.05) & (warp.image[..., 2] > 0.05)

    assert not mixed(single).any()
    assert mixed(several).sum() >= 3
    torch.testing.assert_close(several.image[several.visible].sum(1), torch.ones(int(several.visible.sum())))
    torch.testing.assert_close(
        several.depth[several.visible], torch.full_like(several.depth[several.visible], 8)
    )


def test_several_samples_do_not_mix_the_depths_of_two_surfaces():
    depth = torch.full((HEIGHT, WIDTH), 4.0)
    depth[:, 12:] = 2.0
    out = reproject(picture(), depth, camera(), camera((0.5, 0.0, 0.0)), accuracy=Accuracy(supersampling=3))
    seen = out.depth[out.visible]  # the near wall's edge cuts through the middle of pixels
    assert ((seen - 4.0).abs() < 1e-4).sum() > 50 and ((seen - 2.0).abs() < 1e-4).sum() > 50
    assert ((seen - 4.0).abs().minimum((seen - 2.0).abs()) < 1e-4).all()


@pytest.mark.parametrize("times", [2, 3, 4])
def test_several_samples_keep_the_corners(times):
    depth = torch.full((HEIGHT, WIDTH), 2.0)
    out = reproject(
        torch.full((HEIGHT, WIDTH, 3), 0.7), depth, camera(), camera(), accuracy=Accuracy(supersampling=times)
    )
    assert out.visible.all()
    torch.testing.assert_close(out.image, torch.full((HEIGHT, WIDTH, 3), 0.7))


def test_no_sample_at_all_is_refused():
    with pytest.raises(InputError, match="supersampling"):
        reproject(
            picture(), torch.ones(HEIGHT, WIDTH), camera(), camera(), accuracy=Accuracy(supersampling=0)
        )
