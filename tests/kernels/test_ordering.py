"""Blending in each pixel's own order: as the plain float64 renderer's, however far from the list's."""

from dataclasses import replace

import pytest
import torch
from flat_splats import blended, expected, few, plainly, whole

import oracle
from diga3d_warp.config import Accuracy, Effects
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.kernels import ordering
from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.composite import Composite, composite
from diga3d_warp.splatting.project import Projection
from diga3d_warp.splatting.render import render

STANDARD = replace(Accuracy.STANDARD, pixel_order=True)
EXACT = Accuracy.EXACT


@pytest.mark.parametrize("accuracy,tolerance", [(STANDARD, 1e-5), (EXACT, 5e-6)])
def test_values_and_gradients_agree_with_float64(accuracy, tolerance, device):
    found, leaves = blended(37, 29, device, accuracy)
    parts, certain, references = expected(37, 29, accuracy)
    assert certain.float().mean() > 0.8
    for value, reference in zip(found, parts, strict=True):
        error = (value.detach().cpu().double() - reference).abs()
        assert error[certain].max() < tolerance * max(1.0, reference.max().item())
    ordered_once, _ = blended(37, 29, device, replace(accuracy, pixel_order=False))
    assert (found.color - ordered_once.color).abs()[certain].max() > 0.1, "the order makes a difference"

    oracle.weighted_sum(found, certain).backward()
    oracle.weighted_sum(parts, certain).backward()
    for name, leaf in leaves.items():
        reference = references[name].grad
        assert reference.abs().max() > 0.1
        error = (leaf.grad.cpu().double() - reference).norm() / reference.norm()
        assert error < 1e-4, f"{name}: {error}"


def leaning(accuracy: Accuracy) -> Composite:
    """Two wide gaussians that cross in the middle: red is nearer on the left, green on the right."""
    projection = Projection(
        centers=torch.full((2, 2), 16.0),
        depths=torch.tensor([3.0, 2.9]),
        factors=torch.tensor([[0.03, 0.0, 0.03]]).repeat(2, 1),
        extents=torch.full((2, 2), 100.0),
        opacities=torch.tensor([0.9, 0.9]),
        depth_slopes=torch.tensor([[0.05, 0.0], [-0.05, 0.0]]),
    )
    return composite(projection, torch.tensor([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), 32, 32, accuracy=accuracy)


def test_two_gaussians_that_cross_are_each_in_front_on_one_side():
    red, green, _ = leaning(STANDARD).color.unbind(-1)
    # 3 + 0.05 d < 2.9 - 0.05 d where the pixel lies more than 1 px left of the centre
    assert (red > 2 * green)[:, :15].all() and (green > 2 * red)[:, 15:].all()
    red, green, _ = leaning(Accuracy.STANDARD).color.unbind(-1)
    assert (green > 2 * red).all()


def test_slopes_of_projected_gaussians_are_those_of_their_planes():
    """Two flat discs that cross at a right angle: each is in front where it leans towards the camera."""
    gaussians = Gaussians(
        means=torch.tensor([[0.0, 0.0, 4.0], [0.0, 0.0, 4.0]]),
        log_scales=torch.log(torch.tensor([[0.8, 0.8, 1e-3]])).repeat(2, 1),
        quaternions=torch.tensor([[0.924, 0.0, 0.383, 0.0], [0.924, 0.0, -0.383, 0.0]]),
        opacity_logits=torch.full((2,), 3.0),
        sh=torch.tensor([[[1.7, -1.7, -1.7]], [[-1.7, 1.7, -1.7]]]),
    )
    camera = Camera(40, 30, 40.0, 40.0, 20.0, 15.0, torch.eye(4))
    # The first is turned by +45 degrees about y, which points down: its right half comes to the front.
    ordered = render(gaussians, camera, effects=Effects(pixel_order=True)).color[15]
    assert (ordered[12:19, 1] > 1.5 * ordered[12:19, 0]).all()
    assert (ordered[21:28, 0] > 1.5 * ordered[21:28, 1]).all()
    plain = render(gaussians, camera).color[15]
    assert (plain[12:28, 0] > plain[12:28, 1]).all()


@pytest.mark.parametrize("count", [1, ordering.WINDOW, ordering.WINDOW + 1, 3 * ordering.WINDOW + 5])
def test_a_list_in_reverse_is_turned_around(count):
    """Where every gaussian stands wrong in the list, a window of fixed size would fail."""
    random = torch.Generator().manual_seed(count)
    depths = torch.linspace(1.0, 2.0, count, dtype=torch.float64)
    leaves = {
        "centers": torch.tensor([[-20.0, 8.0]]).repeat(count, 1).double(),
        "factors": torch.tensor([[0.01, 0.0, 0.01]]).repeat(count, 1).double(),
        "depths": depths,
        "opacities": torch.full((count,), 0.05).double(),
        "colors": torch.rand(count, 3, generator=random, dtype=torch.float64),
    }
    # At the centres nearer ones come first; 20 px to the right, where the image begins, all have depth 1.
    slopes = torch.stack([-0.05 * (depths - 1.0), torch.zeros(count)], 1)
    everything = torch.ones(count, dtype=torch.bool)
    image = plainly(*leaves.values(), everything, 16, 16, slopes=slopes.double())
    single = {name: value.float() for name, value in leaves.items()}
    projection = Projection(
        single["centers"], single["depths"], single["factors"], torch.full((count, 2), 200.0),
        single["opacities"], slopes.float(),
    )  # fmt: skip
    found = composite(projection, single["colors"], 16, 16, accuracy=STANDARD)
    assert image.certain.float().mean() > 0.9
    assert (found.color - image.color)[image.certain].abs().max() < 1e-5
    if count > 1:
        plain = composite(projection, single["colors"], 16, 16)
        assert (found.color - plain.color).abs().max() > 1e-3


def test_equal_depths_keep_the_order_of_the_list():
    found, _ = blended(37, 29, accuracy=STANDARD)
    leaves = few()
    flat = torch.zeros(7, 2, dtype=torch.float64)
    for value, reference in zip(whole(*leaves, flat), whole(*leaves), strict=True):
        torch.testing.assert_close(value, reference, rtol=1e-12, atol=1e-12)
    assert found.color.max() > 0.5


def test_float64_kernels_pass_gradcheck():
    leaves = few()
    slopes = torch.randn(7, 2, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    image = plainly(*leaves[:5], torch.ones(7, dtype=torch.bool), 6, 5, slopes=slopes)
    torch.testing.assert_close(whole(*leaves, slopes)[0], image.color, rtol=1e-12, atol=1e-12)
    assert torch.autograd.gradcheck(
        lambda *inputs: whole(*inputs, slopes), leaves, eps=1e-6, atol=1e-7, rtol=1e-5
    )


def test_bits_do_not_depend_on_the_number_of_threads(threads):
    results = []
    for count in (1, 2, 4, 7):
        threads(count)
        found, leaves = blended(70, 50, accuracy=STANDARD)
        oracle.weighted_sum(found, torch.ones(50, 70, dtype=torch.bool)).backward()
        results.append([*found, *(leaf.grad for leaf in leaves.values())])
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))


def test_without_slopes_there_is_no_order():
    projection = Projection(*(torch.zeros(1, *tail) for tail in ((2,), (), (3,), (2,), ())))
    with pytest.raises(ValueError, match="needs depth_slopes"):
        composite(projection, torch.zeros(1, 3), 4, 4, accuracy=STANDARD)
