"""Adam over the parameters of gaussians, whose number changes while it runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
import warp as wp

from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.kernels import adam
from diga3d_warp.splatting.arrays import warp_array


@dataclass(frozen=True)
class LearningRates:
    """Adam's learning rates per parameter.

    Two to three times those of 3DGS, which are made for 30,000 iterations: a fit on a CPU takes a tenth.

    Attributes:
        means: At the first iteration [scene extents]; falls exponentially to `means_final`. 3DGS: 1.6e-4.
        means_final: At the last iteration [scene extents]. 3DGS: 1.6e-6.
        log_scales, quaternions: In the units of the parameter. 3DGS: 5e-3 and 1e-3.
        opacity_logits: As in 3DGS.
        sh_dc: Of the constant harmonic, 3DGS: 2.5e-3; the higher ones learn 20 times slower, or they would
            explain single views by their directions.
    """

    means: float = 5e-4
    means_final: float = 5e-6
    log_scales: float = 1e-2
    quaternions: float = 3e-3
    opacity_logits: float = 5e-2
    sh_dc: float = 5e-3

    @property
    def sh_rest(self) -> float:
        return self.sh_dc / 20.0

    def of_means(self, progress: float, extent: float) -> float:
        """Rate of the means after a part of the iterations in [0, 1] [scene units].

        Args:
            progress: Part of the iterations that is done.
            extent: Unit of both rates [scene units].
        """
        return extent * self.means * (self.means_final / self.means) ** progress


class GaussianAdam:
    """Gaussians as leaf tensors, each with its moments.

    Attributes:
        tensors: Leaf tensors by name, as in `Gaussians`.
        moments: Running means of each tensor's gradient and of its square, in its shape.
        steps: Steps done.
    """

    def __init__(self, gaussians: Gaussians, rates: LearningRates) -> None:
        """Start from a copy of `gaussians`."""
        self.rates = rates
        self.tensors = dict(gaussians.detached().requires_grad_().named())
        self.moments = {name: _no_moments(tensor) for name, tensor in self.tensors.items()}
        self.steps = 0

    def gaussians(self) -> Gaussians:
        """The leaf tensors as gaussians."""
        return Gaussians(**self.tensors)

    @torch.no_grad()
    def step(
        self, gradients: Mapping[str, torch.Tensor], means_rate: float,
        held: torch.Tensor | None = None, visible: torch.Tensor | None = None,
    ) -> None:  # fmt: skip
        """One step of Adam.

        Args:
            gradients: Gradient of each tensor, by its name.
            means_rate: Learning rate of the means [scene units]; those of the others do not change.
            held: Rows that must not move, shape (N,), bool.
            visible: Rows that are visible in the image, shape (N,), bool; the others keep value and moments.
                None: all.
        """
        self.steps += 1
        moving = self._moving(held, visible)
        for name, tensor in self.tensors.items():
            flat = [warp_array(part.view(-1), wp.float32) for part in (tensor, *self.moments[name])]
            gradient = warp_array(gradients[name].contiguous().view(-1), wp.float32)
            rates = self._rates_of(name, means_rate)
            adam.step(len(tensor), len(rates), moving, gradient, rates, self.steps, flat)

    def _moving(self, held: torch.Tensor | None, visible: torch.Tensor | None) -> wp.array:
        """1 where a row moves, else 0, shape (N,), int32."""
        means = self.tensors["means"]
        moving = torch.ones(len(means), dtype=torch.int32, device=means.device)
        if held is not None:
            moving[held] = 0
        if visible is not None:
            moving[~visible] = 0
        return warp_array(moving, wp.int32)

    def _rates_of(self, name: str, means_rate: float) -> list[float]:
        """Learning rate of each number in a row of a parameter."""
        width = self.tensors[name][:1].numel()
        if name == "means":
            return [means_rate] * width
        if name == "sh":
            return [self.rates.sh_dc] * 3 + [self.rates.sh_rest] * (width - 3)
        return [getattr(self.rates, name)] * width

    @torch.no_grad()
    def overwrite(self, rows: torch.Tensor, values: Gaussians) -> None:
        """Replace rows (M,) by `values`, and forget what Adam knows of them."""
        for name, fresh in values.named():
            self.tensors[name][rows] = fresh
            for moment in self.moments[name]:
                moment[rows] = 0.0

    @torch.no_grad()
    def append(self, added: Gaussians) -> None:
        """Add gaussians at the end, with moments of zero."""
        for name, fresh in added.named():
            self.tensors[name] = torch.cat([self.tensors[name], fresh]).requires_grad_()
            self.moments[name] = [
                torch.cat(pair) for pair in zip(self.moments[name], _no_moments(fresh), strict=True)
            ]

    def state_dict(self) -> dict[str, Any]:
        """Everything that `load_state_dict` needs to go on as if nothing had happened."""
        tensors = {name: tensor.detach() for name, tensor in self.tensors.items()}
        return {"tensors": tensors, "moments": self.moments, "steps": self.steps}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from `state_dict`, whatever the number of gaussians was."""
        for name, tensor in state["tensors"].items():
            self.tensors[name] = tensor.clone().requires_grad_()
            self.moments[name] = [moment.clone() for moment in state["moments"][name]]
        self.steps = state["steps"]


def _no_moments(tensor: torch.Tensor) -> list[torch.Tensor]:
    """Both moments of rows that Adam knows nothing of."""
    return [torch.zeros_like(tensor, requires_grad=False) for _ in range(2)]
