"""Canny's edges, and that holes of a warped image are not outlined."""

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
