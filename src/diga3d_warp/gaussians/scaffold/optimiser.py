"""Adam over anchors, whose number changes while it runs, and over their networks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import torch

from diga3d_warp.gaussians.scaffold.anchors import BY_ROW, Scaffold
from diga3d_warp.gaussians.scaffold.settings import AnchorRates
from diga3d_warp.kernels.adam import DECAY


class AnchorAdam:
    """Anchors as leaf tensors, each with its moments.

    Attributes:
        tensors: Leaf tensors by name, as in `Scaffold.named`.
        moments: Running means of each tensor's gradient and of its square, in its shape.
        frame: What does not learn: parts of the decoder, gaussians that are closed, and lengths.
        steps: Steps done.
    """

    def __init__(self, scaffold: Scaffold, rates: AnchorRates) -> None:
        """Start from a copy of `scaffold`."""
        own = scaffold.detached()
        self.rates = rates
        self.frame = own
        self.tensors = {name: tensor.requires_grad_() for name, tensor in own.named()}
        self.moments = {name: torch.zeros(2, *tensor.shape) for name, tensor in self.tensors.items()}
        self.steps = 0

    def scaffold(self) -> Scaffold:
        """The leaf tensors as anchors."""
        return self.frame.with_parameters(self.tensors)

    @property
    def parts(self) -> torch.Tensor:
        """Part of the decoder of each anchor, shape (N,), int64."""
        return self.frame.parts

    @torch.no_grad()
    def step(
        self, gradients: Mapping[str, torch.Tensor], done: float, free: torch.Tensor, parts: torch.Tensor
    ) -> None:
        """One step of Adam.

        Args:
            gradients: Gradient of each tensor, by its name.
            done: Part of the fit that is done, on which the rates depend.
            free: Anchors that may move, shape (N,), bool.
            parts: Parts of the decoder that may change, shape (D,), bool.
        """
        self.steps += 1
        root = (1.0 - DECAY.second**self.steps) ** -0.5
        for name, tensor in self.tensors.items():
            rate = self.rates.of(name, done) / (1.0 - DECAY.first**self.steps)
            if rate == 0.0:
                continue
            may_move = free if name in BY_ROW else parts
            gradient, (first, second) = gradients[name], self.moments[name]
            first.lerp_(gradient, 1.0 - DECAY.first)
            second.mul_(DECAY.second).addcmul_(gradient, gradient, value=1.0 - DECAY.second)
            change = rate * first / (second.sqrt() * root + DECAY.floor)
            if not may_move.all():
                change[~may_move] = 0.0
            tensor -= change

    @torch.no_grad()
    def append(self, added: Mapping[str, torch.Tensor], parts: torch.Tensor) -> None:
        """Add anchors (G, ...) by name at the end, decoded by these parts (G,), with moments of zero."""
        for name in BY_ROW:
            fresh = torch.zeros(2, *added[name].shape)
            self.tensors[name] = torch.cat([self.tensors[name], added[name]]).requires_grad_()
            self.moments[name] = torch.cat([self.moments[name], fresh], dim=1)
        open_ = torch.zeros(len(parts), self.frame.slots, dtype=torch.bool)
        closed = torch.cat([self.frame.closed, open_])
        self.frame = replace(self.frame, parts=torch.cat([self.parts, parts]), closed=closed)

    @torch.no_grad()
    def keep(self, rows: torch.Tensor) -> None:
        """Take out all anchors but those in a mask (N,); the others keep their order and moments."""
        for name in BY_ROW:
            self.tensors[name] = self.tensors[name].detach()[rows].clone().requires_grad_()
            self.moments[name] = self.moments[name][:, rows].clone()
        self.frame = replace(self.frame, parts=self.parts[rows], closed=self.frame.closed[rows])

    def state_dict(self) -> dict[str, Any]:
        """Everything that `load_state_dict` needs to go on as if nothing had happened."""
        tensors = {name: tensor.detach() for name, tensor in self.tensors.items()}
        fixed = {"parts": self.parts, "closed": self.frame.closed}
        return {"tensors": tensors, "moments": self.moments, "fixed": fixed, "steps": self.steps}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from `state_dict`, whatever the number of anchors was."""
        self.tensors = {name: tensor.clone().requires_grad_() for name, tensor in state["tensors"].items()}
        self.moments = {name: moment.clone() for name, moment in state["moments"].items()}
        self.frame, self.steps = replace(self.frame, **state["fixed"]), state["steps"]
