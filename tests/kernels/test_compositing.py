"""Blending against the plain float64 renderer, on splats given in the image plane."""

import math

import numpy as np
import pytest
import torch
from flat_splats import ACCURACIES, NAMES, blended, expected, few, plainly, splats, whole

import oracle
from diga3d_warp.config import Accuracy, Effects
from diga3d_warp.kernels import blending, compositing, compositing_adjoint
from diga3d_warp.kernels.pixel_lanes import CPU_LANES, CUDA_LANES
from diga3d_warp.splatting.composite import composite
from diga3d_warp.splatting.project import Projection


@pytest.mark.parametrize(
    "name,size,tolerance",
    [
        ("standard", (64, 48), 1e-5),
        ("standard", (37, 29), 1e-5),
        ("exact", (37, 29), 5e-6),
        ("draft", (37, 29), 3e-5),
    ],
)
def test_values_and_gradients_agree_with_float64(name, size, tolerance, device):
    found, leaves = blended(*size, device, ACCURACIES[name])
    parts, certain, references = expected(*size, ACCURACIES[name])
    assert certain.float().mean() > 0.9
    transmittance = parts[2]
    assert transmittance.min() < 10 * ACCURACIES[name].transmittance_min  # finished pixels
    assert transmittance.max() > 0.05
    assert (parts[4] > 1).float().mean() > 0.3
    for value, reference in zip(found, parts, strict=True):
        error = (value.detach().cpu().double() - reference).abs()
        assert error[certain].max() < tolerance * max(1.0, reference.max().item())

    oracle.weighted_sum(found, certain).backward()
    oracle.weighted_sum(parts, certain).backward()
    for field, leaf in leaves.items():
        reference = references[field].grad
        assert reference.abs().max() > 0.1
        error = (leaf.grad.cpu().double() - reference).norm() / reference.norm()
        assert error < 1e-4, f"{field}: {error}"


def test_a_gaussian_can_end_at_its_box():
    """As 3DGS's circle of 3 standard deviations: where alpha is still above the skip."""
    accuracy = Accuracy(extent="circle")
    fields, extents = splats(37, 29)
    leaves = {name: value.double() for name, value in fields.items()}
    small = 0.4 * extents
    projection = Projection(
        fields["centers"], fields["depths"], fields["factors"], small, fields["opacities"]
    )
    found = composite(projection, fields["colors"], 37, 29, accuracy=accuracy)
    parts = {}
    for name, boxes in (("box", small.double()), ("none", None)):
        parts[name] = plainly(*(leaves[name] for name in NAMES), extents[:, 0] > 0, 37, 29, extents=boxes)
    certain = parts["box"].certain
    assert certain.float().mean() > 0.8
    assert (found.color.double() - parts["box"].color).abs()[certain].max() < 1e-5
    assert (found.color.double() - parts["none"].color).abs()[certain].max() > 0.05


def test_lanes_of_a_gpu_give_the_same_image_and_gradients(monkeypatch, threads):
    """The CUDA form of the kernels, one pixel a thread, run on this machine's CPU."""
    threads(1)  # its atomic additions are none on CPU
    results = []
    for lanes in (CPU_LANES, CUDA_LANES):
        for module in (compositing, compositing_adjoint):
            monkeypatch.setattr(module, "lanes_for", lambda device, _, lanes=lanes: lanes)
        found, leaves = blended(37, 29)
        oracle.weighted_sum(found, torch.ones(29, 37, dtype=torch.bool)).backward()
        results.append([*found, *(leaf.grad for leaf in leaves.values())])
    for first, second in zip(*results, strict=True):
        torch.testing.assert_close(first, second, rtol=1e-4, atol=1e-5 * first.abs().max().item())


def test_what_is_not_asked_for_leaves_the_rest_as_it_is():
    """Its code is compiled out, and its arrays are empty; colours are the same bits."""
    full, leaves = blended(37, 29)
    bare, bare_leaves = blended(37, 29, effects=Effects(depth=False), everything=False)
    assert not bare.depth_sum.any()
    assert bare.normal_sum is None and bare.median_depth is None
    assert torch.equal(full.color, bare.color)
    for image in (full, bare):
        (image.color.square().sum() + image.transmittance.sum()).backward()
    for name in ("centers", "factors", "opacities", "colors"):
        torch.testing.assert_close(leaves[name].grad, bare_leaves[name].grad, rtol=1e-4, atol=1e-5)
    assert not bare_leaves["depths"].grad.any()


def test_bits_do_not_depend_on_the_number_of_threads(threads):
    results = []
    for count in (1, 2, 4, 7):
        threads(count)
        found, leaves = blended(130, 100)
        oracle.weighted_sum(found, torch.ones(100, 130, dtype=torch.bool)).backward()
        results.append([*found, *(leaf.grad for leaf in leaves.values())])
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))


def test_float64_kernels_pass_gradcheck():
    leaves = few()
    image = plainly(*leaves[:5], torch.ones(7, dtype=torch.bool), 6, 5)
    assert ((image.transmittance > 1e-3) & (image.transmittance < 0.5)).all(), "every pixel has a median"
    found = whole(*leaves)
    assert found[0].dtype == torch.float64
    for value, reference in zip(
        found,
        (image.color, image.depth_sum, image.transmittance, image.weights @ leaves[5], image.median_depth),
        strict=True,
    ):
        torch.testing.assert_close(value, reference, rtol=1e-12, atol=1e-12)
    assert torch.autograd.gradcheck(whole, leaves, eps=1e-6, atol=1e-7, rtol=1e-5)


@pytest.mark.parametrize("alpha_min", [1 / 64, 1 / 255, 1e-7])
@pytest.mark.parametrize("degree", blending.EXP_DEGREES)
def test_the_polynomial_is_the_exponential(alpha_min, degree):
    """As close as its description says, and below alpha_min at the end of its range."""
    coefficients, squarings, reach = blending.exponential(alpha_min, degree)
    power = np.linspace(-reach, 0, 2001)
    found = np.polynomial.Polynomial(coefficients)(power / 2**squarings) ** (2**squarings)
    span = reach / 2**squarings
    promised = 2**squarings * 2 * (span / 4) ** (degree + 1) / math.factorial(degree + 1)
    error = np.abs(found / np.exp(power) - 1).max()
    assert 0.5 < span <= 1.0
    assert 0.8 * promised < error < 3 * promised
    assert found[0] < alpha_min


@pytest.mark.parametrize(
    "degree,least,most", [(2, 1e-4, 2e-2), (3, 2e-5, 2e-3), (4, 5e-7, 1e-4), (6, 0, 3e-6), (8, 0, 3e-6)]
)
def test_a_kernel_has_the_error_of_its_degree(degree, least, most):
    """Against float64's own exponential, where no splat is near a cut-off."""
    leaves = [leaf.detach() for leaf in few()]
    centers, factors, depths, opacities, colors, _ = leaves
    image = plainly(*leaves[:5], torch.ones(7, dtype=torch.bool), 6, 5)
    projection = Projection(*(
        tensor.float() for tensor in (centers, depths, factors, torch.full_like(centers, 50.0), opacities)
    ))  # fmt: skip
    found = composite(projection, colors.float(), 6, 5, accuracy=Accuracy(exp_degree=degree))
    assert least <= (found.color - image.color).abs().max() < most


@pytest.mark.parametrize(
    "wrong",
    [
        {"alpha_min": 0.0},
        {"alpha_min": math.nan},
        {"transmittance_min": 1.0},
        {"exp_degree": 9},
        {"exp_degree": 1},
    ],
)
def test_a_cut_off_that_no_kernel_can_have_is_an_error(wrong):
    (name,) = wrong
    with pytest.raises(ValueError, match=name):
        blending.Blending(**wrong)
