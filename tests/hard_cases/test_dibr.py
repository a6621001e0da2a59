"""Hard cases of reprojection: the border of the target, folds, cracks, and surfaces behind one another."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from diga3d_warp.config import Accuracy
from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.reproject import Warp, reproject

WIDTH, HEIGHT, FOCAL = 24, 18, 20.0


def camera(x: float = 0.0, y: float = 0.0, z: float = 0.0, *, scale: float = 1.0) -> Camera:
    """A camera at (x, y, z) that looks along z."""
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, 3] = -torch.tensor([x, y, z], dtype=torch.float64)
    return Camera(WIDTH, HEIGHT, scale * FOCAL, scale * FOCAL, WIDTH / 2, HEIGHT / 2, pose)


def ramp() -> torch.Tensor:
    """An image whose red is the column and whose green is the row, from 0 to 1."""
    rows, columns = torch.meshgrid(torch.arange(HEIGHT), torch.arange(WIDTH), indexing="ij")
    return torch.stack([columns / WIDTH, rows / HEIGHT, torch.full((HEIGHT, WIDTH), 0.5)], -1).float()


def carried(depth: torch.Tensor, target: Camera) -> tuple[Warp, torch.Tensor, torch.Tensor]:
    """The ramp carried along a depth, and the gradients of image and depth."""
    image, depth = ramp().requires_grad_(), depth.clone().requires_grad_()
    out = reproject(image, depth, camera(), target)
    (out.image.sum() + out.depth.sum()).backward()
    for tensor in (out.image, out.depth, image.grad, depth.grad):
        assert tensor.isfinite().all()
    return out, image.grad, depth.grad


WALL = torch.full((HEIGHT, WIDTH), 2.0)


@pytest.mark.parametrize("columns,rows", [(5, 0), (-5, 0), (0, 4), (0, -4), (7, -3), (23, 17), (-23, 17)])
def test_a_surface_leaves_over_the_border(columns, rows):
    """A wall at depth 2 moves by whole pixels: what stays is the shifted image up to the last row."""
    out, adj_image, _ = carried(WALL, camera(columns * 2 / FOCAL, rows * 2 / FOCAL))
    seen = torch.zeros(HEIGHT, WIDTH, dtype=torch.bool)
    seen[max(0, -rows) : HEIGHT - max(0, rows), max(0, -columns) : WIDTH - max(0, columns)] = True
    assert torch.equal(out.visible, seen)
    expected = torch.roll(ramp(), (-rows, -columns), (0, 1))
    torch.testing.assert_close(out.image[seen], expected[seen], atol=1e-6, rtol=0)
    assert not out.image[~seen].any() and not out.depth[~seen].any()
    # Each visible pixel shows one source pixel: their gradients are all that the source receives.
    torch.testing.assert_close(adj_image.sum((0, 1)), seen.sum() * torch.ones(3), rtol=1e-5, atol=0)
    assert not adj_image[~torch.roll(seen, (rows, columns), (0, 1))].abs().gt(1e-4).any()


@pytest.mark.parametrize("columns", [24, 25, 1000, 10**9, 10**12])
def test_a_surface_beside_the_target_is_not_seen(columns):
    for sign in (1, -1):
        out, adj_image, adj_depth = carried(WALL, camera(sign * columns * 2 / FOCAL))
        assert not out.visible.any() and not out.image.any()
        assert not adj_image.any() and not adj_depth.any()


@pytest.mark.parametrize("z", [2.0, 2.0 - 1e-9, 2.0 - 1e-4, 3.0, 1e6])
def test_a_surface_at_the_target_or_behind_it_is_not_seen(z):
    out, adj_image, adj_depth = carried(WALL, camera(0.0, 0.0, z))
    assert not out.visible.any()
    assert not adj_image.any() and not adj_depth.any()


def test_half_a_surface_behind_the_target():
    """The left of a tilted wall is in front of the target, the right behind it: only the left is seen."""
    depth = torch.linspace(3.0, 1.2, WIDTH).expand(HEIGHT, WIDTH).contiguous()
    out, adj_image, _ = carried(depth, camera(0.0, 0.0, 1.8))
    assert out.visible.sum() > 10
    behind = depth < 1.8
    assert not adj_image[behind].any()
    assert out.depth[out.visible].max() < 3.0 - 1.8 + 1e-5 and out.depth[out.visible].min() > 0.0


def test_the_nearest_of_several_surfaces_is_seen():
    """Bars at depth 1 before a wall at 4, seen from the side: they hide it, whatever was drawn first."""
    for offset in (0.4, -0.4):
        depth = torch.full((HEIGHT, WIDTH), 4.0)
        depth[:, 9:15] = 1.0
        out, adj_image, _ = carried(depth, camera(offset))
        near = out.visible & (out.depth < 2.0)
        assert near.sum() == HEIGHT * 6
        torch.testing.assert_close(out.depth[near], torch.ones(int(near.sum())))
        start = 9 - round(offset * FOCAL)
        assert near[:, start : start + 6].all()
        hidden = torch.zeros(WIDTH, dtype=torch.bool)
        hidden[start + round(offset * FOCAL / 4) : start + 6 + round(offset * FOCAL / 4)] = True
        hidden[8:16] = False  # the bar itself, and the rim of the wall that is mixed with it
        assert hidden.any() and adj_image[:, hidden].abs().max() < 1e-6


def test_a_fold_shows_its_front():
    """A surface so steep that the target sees it from behind is not drawn: no colours from the wrong side."""
    columns = (np.arange(WIDTH) + 0.5 - WIDTH / 2) / FOCAL
    depth = torch.tensor(1.0 / (0.5 + 0.4 * columns), dtype=torch.float32).expand(HEIGHT, WIDTH).contiguous()
    side = 0.1
    points = columns * depth[0].numpy()
    moved = (points - side) / depth[0].numpy()
    assert (np.diff(moved) > 0).all()
    front, _, _ = carried(depth, camera(side))
    assert front.visible.sum() > 200
    far_side = 4.0  # from here the surface's points come in reverse order
    assert (np.diff((points - far_side) / depth[0].numpy()) < 0).all()
    turned = Camera(WIDTH, HEIGHT, 2.0, 2.0, 8.0 + WIDTH / 2, HEIGHT / 2, camera(far_side).world_to_camera)
    behind, _, _ = carried(depth, turned)
    assert not behind.visible.any()


@pytest.mark.parametrize("sampling", ["bilinear", "nearest"])
def test_a_surface_seen_exactly_edge_on_is_not_seen(sampling):
    """The wall x = 0 is a line through the middle of a column of pixels: its triangles have no area."""
    sideways = torch.tensor([[0.0, 0, 1, -5], [0, 1, 0, 0], [-1, 0, 0, 5], [0, 0, 0, 1]])
    source = Camera(WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, sideways)
    edge_on = Camera(WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2 + 0.5, HEIGHT / 2, camera().world_to_camera)
    image, depth = ramp().requires_grad_(), torch.full((HEIGHT, WIDTH), 5.0, requires_grad=True)
    out = reproject(image, depth, source, edge_on, accuracy=Accuracy(sampling=sampling))
    (out.image.sum() + out.depth.sum()).backward()
    for tensor in (out.image, out.depth, image.grad, depth.grad):
        assert tensor.isfinite().all()
    assert bool(out.visible.any()) == (sampling == "nearest")  # points have no area anyway


@pytest.mark.parametrize("scale", [2.0, 7.0, 15.0])
def test_no_cracks_where_the_target_is_magnified(scale):
    out, _, _ = carried(WALL, camera(0.013, 0.007, scale=scale))
    assert out.visible.all()
    assert out.image[..., 2].sub(0.5).abs().max() < 1e-6
    assert (out.image[:, 1:, 0] >= out.image[:, :-1, 0]).all()


@pytest.mark.parametrize("scale,seen", [(15.0, True), (17.0, False)])
def test_a_triangle_that_is_stretched_too_far_covers_nothing(scale, seen):
    """Sixteen pixels of the target between two of the source: more would be invented."""
    out, adj_image, _ = carried(WALL, camera(0.013, 0.007, scale=scale))
    assert bool(out.visible.all()) == seen and bool(out.visible.any()) == seen
    assert bool(adj_image.any()) == seen


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (9, 1)])
def test_a_source_of_one_row_has_no_surface(size):
    height, width = size
    source = Camera(width, height, FOCAL, FOCAL, width / 2, height / 2, torch.eye(4))
    image = torch.ones(height, width, 3, requires_grad=True)
    depth = torch.ones(height, width, requires_grad=True)
    out = reproject(image, depth, source, source)
    (out.image.sum() + out.depth.sum()).backward()
    assert not out.visible.any() and not image.grad.any() and not depth.grad.any()
