"""What each gaussian takes of an image, and who is strongest in a pixel, against the plain renderer."""

from dataclasses import replace

import pytest
import torch
from flat_splats import NAMES, plainly, splats

import oracle
from diga3d_warp.config import Accuracy
from diga3d_warp.kernels import attribution
from diga3d_warp.kernels.pixel_lanes import CPU_LANES, CUDA_LANES
from diga3d_warp.splatting.attribution import Shares, Strongest, shares, strongest
from diga3d_warp.splatting.project import Projection

ORDERED = replace(Accuracy.STANDARD, pixel_order=True)
WIDTH, HEIGHT = 37, 29


def projection(device: str = "cpu") -> Projection:
    fields, extents = splats(WIDTH, HEIGHT)
    return Projection(*(
        tensor.to(device)
        for tensor in (
            fields["centers"], fields["depths"], fields["factors"], extents, fields["opacities"],
            fields["depth_slopes"],
        )
    ))  # fmt: skip


def expected(accuracy: Accuracy) -> oracle.Image:
    fields, extents = splats(WIDTH, HEIGHT)
    doubles = {name: value.double() for name, value in fields.items()}
    return plainly(
        *(doubles[name] for name in NAMES), extents[:, 0] > 0, WIDTH, HEIGHT,
        slopes=doubles["depth_slopes"] if accuracy.pixel_order else None,
    )  # fmt: skip


def values(certain: torch.Tensor) -> torch.Tensor:
    """Random, and zero where the plain renderer is not certain."""
    random = torch.rand(HEIGHT, WIDTH, 3, generator=torch.Generator().manual_seed(1))
    return random * certain[..., None]


@pytest.mark.parametrize("accuracy", [Accuracy.STANDARD, ORDERED])
def test_shares_are_sums_of_weights(accuracy, device):
    image = expected(accuracy)
    pixels = values(image.certain)
    found = Shares(*(part.cpu() for part in shares(projection(device), pixels.to(device), accuracy=accuracy)))
    sums = torch.einsum("hwn,hwc->nc", image.weights, pixels.double())
    assert (sums.amax(1) > 1.0).sum() > 40
    torch.testing.assert_close(found.sums.double(), sums, rtol=1e-4, atol=1e-4)
    weights, hits = image.weights.sum((0, 1)), (image.weights > 0).sum((0, 1))
    unsure = int((~image.certain).sum())
    assert (found.weights - weights).abs().max() < 1e-3 * weights.max() + 0.02 * unsure
    assert (found.hits - hits).abs().max() <= unsure and hits.max() > 100
    assert not found.weights[::9].any() and not found.hits[::9].any(), "culled gaussians take nothing"


@pytest.mark.parametrize("accuracy", [Accuracy.STANDARD, ORDERED])
@pytest.mark.parametrize("count", [1, 3])
def test_the_strongest_are_those_of_the_largest_weights(count, accuracy, device):
    image = expected(accuracy)
    found = Strongest(
        *(part.cpu() for part in strongest(projection(device), WIDTH, HEIGHT, count, accuracy=accuracy))
    )
    largest, ids = image.weights.topk(count)
    error = (found.weights.double() - largest).abs()[image.certain]
    assert largest.max() > 0.9 and error.max() < 1e-5
    # Where weights are clearly apart, so are the gaussians.
    ahead = image.weights.topk(count + 1).values
    clear = ((ahead[..., :-1] - ahead[..., 1:]) > 1e-4).all(-1) & image.certain
    assert clear.float().mean() > 0.5
    assert (found.gaussians.long() == ids)[clear].all()


@pytest.mark.parametrize("accuracy", [Accuracy.STANDARD, ORDERED])
def test_a_pixel_without_enough_gaussians_says_so(accuracy):
    one = Projection(*(tensor[1:2] for tensor in projection()))
    found = strongest(one, WIDTH, HEIGHT, 2, accuracy=accuracy)
    shown = found.weights[..., 0] > 0
    assert shown.any() and not shown.all()
    assert (found.gaussians[..., 0] == torch.where(shown, 0, -1)).all()
    assert (found.gaussians[..., 1] == -1).all() and not found.weights[..., 1].any()


def test_of_equal_weights_the_one_in_front_is_stronger():
    """The one behind takes a third of the three quarters that are left."""
    wall = Projection(
        torch.full((2, 2), 8.0), torch.tensor([2.0, 1.0]), torch.zeros(2, 3), torch.full((2, 2), 99.0),
        torch.tensor([1 / 3, 0.25]),
    )  # fmt: skip
    exact = Accuracy(exp_degree=6)  # its exp(0) is 1 to the bit
    found = strongest(wall, 8, 8, 2, accuracy=exact)
    assert (found.weights == 0.25).all()
    assert (found.gaussians == torch.tensor([1, 0])).all()


def test_pixels_beyond_the_border_count_for_nothing():
    wall = Projection(
        torch.full((1, 2), 8.0), torch.ones(1), torch.full((1, 3), 1e-12), torch.full((1, 2), 99.0),
        torch.tensor([0.5]),
    )  # fmt: skip
    for accuracy in (Accuracy.STANDARD, ORDERED):
        flat = wall._replace(depth_slopes=torch.zeros(1, 2))
        found = shares(flat, torch.ones(9, 21, 3), accuracy=accuracy)
        assert found.hits.item() == 9 * 21
        torch.testing.assert_close(found.weights, torch.tensor([0.5 * 9 * 21]))


@pytest.mark.parametrize("accuracy", [Accuracy.STANDARD, ORDERED])
def test_bits_do_not_depend_on_the_number_of_threads(accuracy, threads):
    results = []
    pixels = values(torch.ones(HEIGHT, WIDTH))
    for count in (1, 2, 4, 7):
        threads(count)
        results.append([
            *shares(projection(), pixels, accuracy=accuracy),
            *strongest(projection(), WIDTH, HEIGHT, 3, accuracy=accuracy),
        ])  # fmt: skip
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))


@pytest.mark.parametrize("accuracy", [Accuracy.STANDARD, ORDERED])
def test_lanes_of_a_gpu_give_the_same(accuracy, monkeypatch, threads):
    threads(1)
    results = []
    pixels = values(torch.ones(HEIGHT, WIDTH))
    for lanes in (CPU_LANES, CUDA_LANES):
        monkeypatch.setattr(attribution, "lanes_for", lambda device, blending, lanes=lanes: lanes)
        results.append([
            *shares(projection(), pixels, accuracy=accuracy),
            *strongest(projection(), WIDTH, HEIGHT, 3, accuracy=accuracy),
        ])  # fmt: skip
    for first, second in zip(*results, strict=True):
        torch.testing.assert_close(first, second, rtol=1e-4, atol=1e-5)


def test_no_gaussians_and_no_count():
    none = Projection(*(tensor[:0] for tensor in projection()))
    assert shares(none, torch.ones(HEIGHT, WIDTH, 3)).weights.shape == (0,)
    assert (strongest(none, WIDTH, HEIGHT, 2).gaussians == -1).all()
    with pytest.raises(ValueError, match="at least 1"):
        strongest(none, WIDTH, HEIGHT, 0)
