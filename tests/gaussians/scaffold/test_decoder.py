"""Decoder: gradients against finite differences, and inputs that saturate or are not finite."""

from __future__ import annotations

import math

import pytest
import torch

from diga3d_warp.gaussians.scaffold.decoder import (
    OPACITY_MOST,
    Decoder,
    activation_of,
    logit_of,
    view_of,
)
from scaffolds import in_double, lively, scaffold_of

EYE = torch.tensor([2.0, -1.0, 0.7], dtype=torch.float64)


def decoded(scaffold, means=None, features=None, eye=EYE, decoder=None):
    view = view_of(scaffold.means if means is None else means, eye, scaffold.reach)
    decoder = decoder or scaffold.decoder
    return decoder.decode(0, scaffold.features if features is None else features, view, scaffold.closed)


def test_gradients_are_those_of_finite_differences():
    """By feature, position, camera and every weight."""
    scaffold = in_double(lively())
    names = [name for name, _ in scaffold.decoder.named()]
    slots = decoded(scaffold).slots
    assert 10 < len(slots) < len(scaffold) * scaffold.slots, "some are drawn, some are not"

    def outputs(features, means, eye, *weights):
        decoder = Decoder.of(dict(zip(names, weights, strict=True)))
        found = decoded(scaffold, means, features, eye, decoder)
        assert torch.equal(found.slots, slots)
        return found[1:]

    inputs = [scaffold.features, scaffold.means, EYE, *(weight for _, weight in scaffold.decoder.named())]
    leaves = [tensor.clone().requires_grad_() for tensor in inputs]
    assert torch.autograd.gradcheck(outputs, leaves, eps=1e-7, atol=1e-5)


def test_logit_and_activation_are_inverse():
    logits = torch.linspace(-12.0, 12.0, 49, dtype=torch.float64)
    activations = activation_of(logits)
    torch.testing.assert_close(torch.tanh(activations), torch.sigmoid(logits))
    torch.testing.assert_close(logit_of(activations), logits)


@pytest.mark.parametrize("factor", [1e4, 1e12, 1e30])
def test_saturated_outputs_are_finite_and_so_are_their_gradients(factor):
    scaffold = lively()
    named = dict(scaffold.named())
    for head in ("opacity", "color", "shape"):
        for weight in ("outer", "outer_bias"):
            named[f"decoder.{head}.{weight}"] = factor * named[f"decoder.{head}.{weight}"]
    leaves = {name: tensor.clone().requires_grad_() for name, tensor in named.items()}
    loud = scaffold.with_parameters(leaves)
    found = decoded(loud, eye=EYE.float())
    assert len(found.slots) > 0
    assert all(part.isfinite().all() for part in found)
    assert found.logits.max() <= 2.0 * OPACITY_MOST
    assert (found.colors >= 0.0).all() and (found.colors <= 1.0).all()
    total = found.logits.sum() + found.colors.sum() + torch.exp(found.log_shares).sum()
    gradients = torch.autograd.grad(total, list(leaves.values()), allow_unused=True)
    assert all(gradient.isfinite().all() for gradient in gradients if gradient is not None)


@pytest.mark.parametrize("broken", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("head", ["opacity", "color", "shape"])
def test_outputs_that_are_not_finite_are_not_drawn(broken, head):
    scaffold = scaffold_of()
    getattr(scaffold.decoder, head).outer_bias[0, 0] = broken
    found = decoded(scaffold, eye=EYE.float())
    whole = decoded(scaffold_of(), eye=EYE.float())
    # The first output of each network belongs to the first gaussian of each anchor.
    spoilt = torch.isin(whole.slots, found.slots, invert=True)
    if head == "opacity" and broken == math.inf:
        assert found.logits.isfinite().all()
        return
    assert spoilt.any() and (whole.slots[spoilt] % scaffold.slots == 0).all()
    assert all(part.isfinite().all() for part in found)


def test_an_anchor_at_the_camera_has_no_direction():
    means = torch.tensor([[1.0, 2.0, 3.0], [1.0, 2.0, 4.0], [1.0, 2.0, 3.0 + 1e-30]], requires_grad=True)
    eye = torch.tensor([1.0, 2.0, 3.0], requires_grad=True)
    view = view_of(means, eye, 1.0)
    assert view[0].tolist() == [0.0] * 4 and view[2].tolist() == [0.0] * 4
    assert view[1].tolist() == [0.0, 0.0, 1.0, 0.5]
    view.sum().backward()
    assert means.grad.isfinite().all() and eye.grad.isfinite().all()
    assert (means.grad[0] == 0.0).all()


def test_distance_is_bounded():
    far = torch.tensor([[1e18, 0.0, 0.0], [1e-18, 0.0, 0.0], [0.0, 3.0, 0.0]])
    view = view_of(far, torch.zeros(3), 1.0)
    assert view.isfinite().all()
    assert view[:, 3].tolist() == pytest.approx([1.0, 1e-18, 0.75])
