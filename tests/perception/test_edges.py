"""Canny's edges, and that holes of a warped image are not outlined."""

import cv2
import numpy as np
import pytest
import torch

from diga3d_warp.perception.edges import RIM, canny_edges


def square():
    """A bright square on a dark ground."""
    image = torch.full((40, 50, 3), 0.2)
    image[10:30, 15:35] = 0.9
    return image


def test_a_square_has_four_sides():
    edges = canny_edges(square())
    assert edges.shape == (40, 50)
    assert edges.dtype == torch.float32
    assert set(edges.unique().tolist()) == {0.0, 1.0}
    assert float(edges[14:26, 14:17].sum(1).min()) == 1.0
    assert float(edges[14:26, 20:30].sum()) == 0.0
    assert float(edges[:7].sum() + edges[33:].sum()) == 0.0


def test_a_flat_image_has_none():
    assert float(canny_edges(torch.full((20, 30, 3), 0.5)).sum()) == 0.0


def test_a_hole_is_not_outlined():
    image, valid = torch.full((40, 50, 3), 0.7), torch.ones(40, 50, dtype=torch.bool)
    valid[12:25, 20:40] = False
    image[~valid] = 0.0
    assert float(canny_edges(image).sum()) > 40
    assert float(canny_edges(image, valid).sum()) == 0.0


def test_edges_away_from_the_hole_stay():
    valid = torch.ones(40, 50, dtype=torch.bool)
    valid[:, :15] = False
    with_hole, without = canny_edges(square(), valid), canny_edges(square())
    assert torch.equal(with_hole[:, 15 + RIM :], without[:, 15 + RIM :])
    assert float(with_hole[:, : 15 + RIM].sum()) == 0.0


def wave(size: tuple[int, int], contrast: float = 0.3) -> torch.Tensor:
    """A crooked border between two greys."""
    y, x = torch.meshgrid(torch.arange(size[0]), torch.arange(size[1]), indexing="ij")
    bright = x > 0.5 * size[1] + 0.15 * size[1] * torch.sin(6.0 * y / size[0])
    return torch.where(bright, 0.4 + contrast, 0.4)[..., None].expand(*size, 3)


@pytest.mark.parametrize(
    ("size", "wanted"), [((40, 50), (160, 200)), ((160, 200), (60, 75)), ((60, 75),) * 2]
)
def test_edges_at_another_size_are_thin_and_unbroken(size, wanted):
    """Resized as an image, a line of 0 and 1 would be grey, wide, or in pieces."""
    edges = canny_edges(wave(size), size=wanted).numpy()
    assert edges.shape == wanted and set(np.unique(edges)) == {0.0, 1.0}
    count, _ = cv2.connectedComponents(edges.astype(np.uint8), connectivity=8)
    assert count == 2, "one line on one background"
    assert (edges.sum(1) >= 1.0).mean() > 0.95, "from top to bottom"
    assert cv2.erode(edges, np.ones((2, 2), np.uint8)).sum() <= 0.02 * edges.sum(), "one pixel wide"


def test_an_enlarged_image_keeps_its_edges():
    faint = wave((40, 50), contrast=0.16)
    assert float(canny_edges(faint).sum()) > 30
    assert float(canny_edges(faint, size=(160, 200)).sum()) > 120


def test_a_hole_is_not_outlined_at_another_size():
    image, valid = torch.full((40, 50, 3), 0.7), torch.ones(40, 50, dtype=torch.bool)
    valid[12:25, 20:40] = False
    image[~valid] = 0.0
    for size in ((80, 100), (20, 25)):
        assert float(canny_edges(image, size=size).sum()) > 15
        assert float(canny_edges(image, valid, size).sum()) == 0.0
