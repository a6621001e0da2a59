"""Texture and depth maps: the reference's inpainting arrives where the mask is, the scene stays elsewhere."""

import numpy as np
import pytest
import torch

from diga3d_warp.perception.edges import canny_edges
from diga3d_warp.propagation.conditions import texture_geometry
from diga3d_warp.scene.camera import Camera

HEIGHT, WIDTH, SHIFT = 40, 60, 5
FOCAL, FAR = 50.0, 2.0


def camera(shift: float) -> Camera:
    """A camera that is moved to the right by so many pixels of the plane at depth `FAR`."""
    pose = np.eye(4)
    pose[0, 3] = -shift * FAR / FOCAL
    return Camera(WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, torch.from_numpy(pose))


@pytest.fixture
def stripes():
    """Upright stripes of 10 px: the inpainted reference."""
    bright = (torch.arange(WIDTH) // 10) % 2 == 1
    return torch.where(bright, 0.8, 0.2)[None, :, None].expand(HEIGHT, WIDTH, 3).contiguous()


@pytest.fixture
def view():
    """What the view shows: a flat wall at another depth, its masked part black and near."""
    mask = torch.zeros(HEIGHT, WIDTH, dtype=torch.bool)
    mask[5:35, 10:50] = True
    image = torch.full((HEIGHT, WIDTH, 3), 0.2)
    depth = torch.full((HEIGHT, WIDTH), 4.0)
    image[mask], depth[mask] = 0.0, 1.0
    return image, depth, mask


def test_the_references_edges_arrive_in_the_mask(stripes, view):
    plane = torch.full((HEIGHT, WIDTH), FAR)
    edges, _ = texture_geometry(stripes, plane, camera(0), *view, camera(SHIFT))
    assert (edges.kind, edges.scale, edges.image.shape) == ("edges", 0.8, (1, HEIGHT, WIDTH))
    moved = torch.roll(canny_edges(stripes), -SHIFT, 1)
    inside = (slice(9, 31), slice(14, 46))
    assert float(moved[inside].sum()) > 50
    assert torch.equal(edges.image[0][inside], moved[inside])
    assert float(edges.image[0, :3].sum() + edges.image[0, 37:].sum()) == 0.0


def test_depth_is_the_references_in_the_mask_and_the_views_elsewhere(stripes, view):
    plane = torch.full((HEIGHT, WIDTH), FAR)
    _, depth = texture_geometry(stripes, plane, camera(0), *view, camera(SHIFT))
    assert (depth.kind, depth.scale, depth.image.shape) == ("depth", 1.0, (1, HEIGHT, WIDTH))
    mask = view[2]
    assert (depth.image[0][mask] == 1.0).all(), "the nearest that is left, not the object at depth 1"
    assert (depth.image[0][~mask] == 0.0).all()


def test_what_does_not_arrive_is_neither_edge_nor_depth(stripes, view):
    plane = torch.full((HEIGHT, WIDTH), FAR)
    plane[:, 20:35] = 0.0
    edges, depth = texture_geometry(stripes, plane, camera(0), *view, camera(0))
    gone = (slice(8, 32), slice(20, 35))
    assert float(edges.image[0][gone].sum()) == 0.0
    assert float(depth.image[0][gone].sum()) == 0.0
    assert float(edges.image[0, 10:30, 38:42].sum()) > 15


def test_maps_are_made_of_the_window_at_the_size_of_the_prior(stripes, view):
    """What lies outside of the window takes no part of the range of depths."""
    plane = torch.full((HEIGHT, WIDTH), FAR)
    image, depth, mask = view
    depth[:, 55:] = 0.1
    window, size = (slice(4, 36), slice(4, 52)), (64, 96)
    arguments = (stripes, plane, camera(0), image, depth, mask, camera(SHIFT))
    edges, near = texture_geometry(*arguments, window, size)
    assert edges.image.shape == near.image.shape == (1, *size)
    assert set(edges.image.unique().tolist()) == {0.0, 1.0} and float(edges.image.sum()) > 100
    assert float(near.image[0][8:56, 16:88].min()) == 1.0, "the reference's plane is the nearest here"
    _, whole = texture_geometry(*arguments)
    assert float(whole.image[0][mask].max()) < 0.1
