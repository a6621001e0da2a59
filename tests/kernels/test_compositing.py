"""Blending against the plain float64 renderer, on splats given in the image plane."""

import pytest
import torch

import oracle
from diga3d_warp.kernels import compositing, compositing_adjoint
from diga3d_warp.splatting.composite import Composite, composite
from diga3d_warp.splatting.project import Projection

COUNT = 200
NAMES = ("centers", "conics", "depths", "opacities", "colors")


def splats(width: int, height: int) -> tuple[dict[str, torch.Tensor], torch.Tensor]:
    """Splats of all sizes and opacities over an image, and their extents; every ninth is culled."""
    random = torch.Generator().manual_seed(3)

    def uniform(*shape: int) -> torch.Tensor:
        return torch.rand(shape, generator=random, dtype=torch.float64)

    axes = torch.exp(2.6 * uniform(COUNT, 2))
    angle = 6.3 * uniform(COUNT)
    turn = torch.stack([angle.cos(), -angle.sin(), angle.sin(), angle.cos()], -1).reshape(-1, 2, 2)
    covariance = turn @ torch.diag_embed(axes**2) @ turn.mT
    inverse = torch.linalg.inv(covariance)
    opacities = torch.where(uniform(COUNT) < 0.2, 0.99 + 0.01 * uniform(COUNT), uniform(COUNT))
    reach = (2 * torch.log((255 * opacities).clamp_min(1))).sqrt() * 1.001
    extents = reach[:, None] * covariance.diagonal(dim1=1, dim2=2).sqrt()
    extents[::9] = 0.0
    fields = {
        "centers": uniform(COUNT, 2) * torch.tensor([width + 20, height + 20]) - 10,
        "conics": torch.stack([inverse[:, 0, 0], inverse[:, 0, 1], inverse[:, 1, 1]], -1),
        "depths": 1 + 5 * uniform(COUNT),
        "opacities": opacities,
        "colors": 1.5 * uniform(COUNT, 3),
    }
    return {name: fields[name].float() for name in NAMES}, extents.float()


def blended(
    width: int, height: int, device: str = "cpu", with_depth: bool = True
) -> tuple[Composite, dict[str, torch.Tensor]]:
    fields, extents = splats(width, height)
    leaves = {name: value.to(device).requires_grad_() for name, value in fields.items()}
    projection = Projection(
        leaves["centers"], leaves["depths"], leaves["conics"], extents.to(device), leaves["opacities"]
    )
    return composite(projection, leaves["colors"], width, height, with_depth=with_depth), leaves


def expected(width: int, height: int) -> tuple[oracle.Image, dict[str, torch.Tensor]]:
    fields, extents = splats(width, height)
    leaves = {name: value.double().requires_grad_() for name, value in fields.items()}
    return oracle.composite(*leaves.values(), extents[:, 0] > 0, width, height), leaves


@pytest.mark.parametrize("width,height", [(64, 48), (37, 29)])
def test_values_agree_with_float64(width, height, device):
    found, _ = blended(width, height, device)
    image, _ = expected(width, height)
    assert image.certain.float().mean() > 0.9
    assert image.transmittance.min() < 2e-4  # finished pixels
    assert image.transmittance.max() > 0.05
    for value, reference in zip(found, (image.color, image.depth_sum, image.transmittance), strict=True):
        error = (value.detach().cpu().double() - reference).abs()
        assert error[image.certain].max() < 1e-5 * max(1.0, reference.max().item())


@pytest.mark.parametrize("width,height", [(64, 48), (37, 29)])
def test_gradients_agree_with_float64(width, height, device):
    found, leaves = blended(width, height, device)
    image, references = expected(width, height)
    oracle.weighted_sum(found, image.certain).backward()
    blend = (image.color, image.depth_sum, image.transmittance)
    oracle.weighted_sum(blend, image.certain).backward()
    for name, leaf in leaves.items():
        reference = references[name].grad
        assert reference.abs().max() > 0.1
        error = (leaf.grad.cpu().double() - reference).norm() / reference.norm()
        assert error < 1e-4, f"{name}: {error}"


def test_lanes_of_a_gpu_give_the_same_image_and_gradients(monkeypatch, threads):
    """The CUDA form of the kernels, one pixel a thread, run on this machine's CPU."""
    threads(1)  # its atomic additions are none on CPU
    results = []
    for lanes in (compositing.CPU_LANES, compositing.CUDA_LANES):
        for module in (compositing, compositing_adjoint):
            monkeypatch.setattr(module, "lanes_of", lambda device, lanes=lanes: lanes)
        found, leaves = blended(37, 29)
        oracle.weighted_sum(found, torch.ones(29, 37, dtype=torch.bool)).backward()
        results.append([*found, *(leaf.grad for leaf in leaves.values())])
    for first, second in zip(*results, strict=True):
        torch.testing.assert_close(first, second, rtol=1e-4, atol=1e-5 * first.abs().max().item())


def test_depth_costs_nothing_where_it_is_not_asked_for():
    """Its code is compiled out; colours and their gradients are the same bits."""
    full, leaves = blended(37, 29)
    bare, bare_leaves = blended(37, 29, with_depth=False)
    assert not bare.depth_sum.any()
    assert torch.equal(full.color, bare.color)
    for image in (full, bare):
        (image.color.square().sum() + image.transmittance.sum()).backward()
    for name in ("centers", "conics", "opacities", "colors"):
        torch.testing.assert_close(leaves[name].grad, bare_leaves[name].grad, rtol=1e-4, atol=1e-5)
    assert not bare_leaves["depths"].grad.any()


def test_bits_do_not_depend_on_the_number_of_threads(threads):
    results = []
    for count in (1, 2, 3):
        threads(count)
        found, leaves = blended(130, 100)
        oracle.weighted_sum(found, torch.ones(100, 130, dtype=torch.bool)).backward()
        results.append([*found, *(leaf.grad for leaf in leaves.values())])
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))


def test_the_polynomial_is_the_exponential():
    power = torch.linspace(-8, 0, 1001, dtype=torch.float64)
    x = power / 8
    polynomial = sum(c * x**k for k, c in enumerate(compositing.EXP))
    assert ((polynomial**8 / power.exp()) - 1).abs().max() < 4e-7
