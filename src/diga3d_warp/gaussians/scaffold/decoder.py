"""The networks of Scaffold-GS: opacity, colour and shape of an anchor's gaussians from feature and view.

Three networks of one hidden layer each (Lu et al. 2024, Sec. 3.2.2). Edits fit a copy of them for the anchors
that may change, so a decoder holds several parts, one along the first dimension of each weight: what an edit
holds still is decoded by weights that it holds still.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from typing import NamedTuple

import torch

VIEW = 4
"""Inputs besides the feature: direction (3) and distance (1)."""

OUTPUTS = {"opacity": 1, "color": 3, "shape": 7}
"""Outputs of each network for one gaussian: activations of opacity, RGB and scale, and a quaternion."""

OPACITY_LEAST = 1e-8
"""Activation from which a gaussian is drawn: any accuracy's `alpha_min` is larger, and 1 / a is finite."""

OPACITY_MOST = 8.0
"""Largest activation of an opacity: tanh(8) is 1 - 2e-7, the last step before 1 in float32."""


@dataclass(eq=False)
class Head:
    """A network of one hidden layer, D of them.

    Attributes:
        inner, inner_bias: Hidden layer, shapes (D, F + `VIEW`, H) and (D, H).
        outer, outer_bias: Output layer, shapes (D, H, O) and (D, O).
    """

    inner: torch.Tensor
    inner_bias: torch.Tensor
    outer: torch.Tensor
    outer_bias: torch.Tensor

    def of(self, part: int, inputs: torch.Tensor) -> torch.Tensor:
        """Outputs of one of the D networks, shape (M, O), for inputs (M, F + `VIEW`)."""
        hidden = torch.relu(inputs @ self.inner[part] + self.inner_bias[part])
        return hidden @ self.outer[part] + self.outer_bias[part]


class Shapes(NamedTuple):
    """Decoded gaussians, before they are placed.

    Attributes:
        slots: Number of each among all gaussians of the M anchors, shape (G,), int64.
        logits: Opacity is their sigmoid, shape (G,).
        colors: RGB in [0, 1], shape (G, 3).
        log_shares: Logarithms of the standard deviations, as parts of the anchor's size, shape (G, 3).
        quaternions: (w, x, y, z), not of unit length, shape (G, 4).
    """

    slots: torch.Tensor
    logits: torch.Tensor
    colors: torch.Tensor
    log_shares: torch.Tensor
    quaternions: torch.Tensor


@dataclass(eq=False)
class Decoder:
    """The three networks, each D times; see `OUTPUTS`."""

    opacity: Head
    color: Head
    shape: Head

    def __len__(self) -> int:
        """Number D of parts."""
        return len(self.opacity.inner)

    def named(self) -> Iterator[tuple[str, torch.Tensor]]:
        """Weights by name, such as "color.inner"."""
        for head in fields(self):
            for weight in fields(Head):
                yield f"{head.name}.{weight.name}", getattr(getattr(self, head.name), weight.name)

    @classmethod
    def of(cls, named: Mapping[str, torch.Tensor]) -> Decoder:
        """The decoder of weights by name."""
        return cls(
            *(
                Head(*(named[f"{head}.{weight.name}"] for weight in fields(Head)))
                for head in (each.name for each in fields(cls))
            )
        )

    def parts(self, rows: torch.Tensor) -> Decoder:
        """The decoder of the parts in an index (E,), copied."""
        return Decoder.of({name: weight.detach()[rows].clone() for name, weight in self.named()})

    def joined(self, other: Decoder) -> Decoder:
        """The parts of this decoder, then those of another."""
        theirs = dict(other.named())
        return Decoder.of(
            {name: torch.cat([weight.detach(), theirs[name].detach()]) for name, weight in self.named()}
        )

    def decode(self, part: int, features: torch.Tensor, view: torch.Tensor, closed: torch.Tensor) -> Shapes:
        """Gaussians of M anchors as one camera sees them, those of opacity above 0 alone.

        Opacity is a tanh, as in the paper, and its gaussians below 0 are not drawn. Numbers that are not
        finite fail the comparison, so nothing broken is drawn. Gradients reach features, view and weights.

        Args:
            part: Which of the D decoders.
            features: shape (M, F), finite.
            view: Direction and distance of the anchors, from `view_of`, shape (M, `VIEW`).
            closed: Gaussians that are not drawn, shape (M, k), bool.
        """
        inputs = torch.cat([features, view], dim=1)
        activations = self.opacity.of(part, inputs).reshape(-1)
        count = closed.shape[1]
        slots = torch.nonzero((activations.detach() > OPACITY_LEAST) & ~closed.reshape(-1))[:, 0]
        anchors = torch.unique(slots // count)
        if len(anchors) < len(features):  # networks are only run where something is drawn
            inputs = inputs[anchors]
        place = torch.searchsorted(anchors, slots // count) * count + slots % count
        colors = self.color.of(part, inputs).reshape(-1, 3)[place]
        shapes = self.shape.of(part, inputs).reshape(-1, 7)[place]
        return _activated(slots, activations[slots], colors, shapes)

    def activations(self, part: int, features: torch.Tensor, view: torch.Tensor) -> torch.Tensor:
        """Opacity activations of all k gaussians of M anchors, shape (M, k); see `decode`."""
        return self.opacity.of(part, torch.cat([features, view], dim=1))


def _activated(
    slots: torch.Tensor, opacity: torch.Tensor, colors: torch.Tensor, shapes: torch.Tensor
) -> Shapes:
    usable = (colors.abs() < math.inf).all(dim=1) & (shapes.abs() < math.inf).all(dim=1)
    if not usable.all():
        slots, opacity, colors, shapes = slots[usable], opacity[usable], colors[usable], shapes[usable]
    identity = shapes.new_tensor([1.0, 0.0, 0.0, 0.0])
    return Shapes(
        slots,
        logit_of(opacity),
        torch.sigmoid(colors),
        torch.nn.functional.logsigmoid(shapes[:, :3]),
        shapes[:, 3:] + identity,
    )


def logit_of(activation: torch.Tensor) -> torch.Tensor:
    """Logit of the opacity tanh(a) of activations above 0: log(expm1(2 a) / 2), finite however large a is."""
    a = activation.clamp(max=OPACITY_MOST)
    return 2.0 * a + torch.log(-torch.expm1(-2.0 * a)) - math.log(2.0)


def activation_of(logits: torch.Tensor) -> torch.Tensor:
    """Activation of an opacity given as a logit, the inverse of `logit_of`: log1p(2 exp(x)) / 2."""
    return 0.5 * torch.nn.functional.softplus(logits + math.log(2.0))


def view_of(means: torch.Tensor, eye: torch.Tensor, reach: float) -> torch.Tensor:
    """Direction from the camera and bounded distance, d / (d + reach), of M anchors, shape (M, `VIEW`).

    The paper gives the distance itself to the networks; bounded, an anchor far away saturates nothing. An
    anchor at the camera's centre has direction 0, and no gradient there.

    Args:
        means: World positions, shape (M, 3).
        eye: Centre of the camera, shape (3,).
        reach: Distance that is seen as a half [scene units].
    """
    away = means - eye
    squared = (away * away).sum(dim=1, keepdim=True)
    apart = squared > torch.finfo(away.dtype).tiny
    distance = torch.where(apart, squared, 1.0).sqrt()
    direction = torch.where(apart, away / distance, 0.0)
    distance = torch.where(apart, distance, 0.0)
    return torch.cat([direction, distance / (distance + reach)], dim=1)
