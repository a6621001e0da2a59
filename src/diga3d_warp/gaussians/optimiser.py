"""Adam over the parameters of gaussians, whose number changes while it runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch

from diga3d_warp.gaussians.parameters import Gaussians

MOMENTS = ("exp_avg", "exp_avg_sq")
"""Per-row tensors in the state of torch's Adam."""


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


class GaussianAdam:
    """Gaussians as leaf tensors, with one Adam group per parameter.

    The harmonics are split into constant and higher ones, which learn at different rates.
    """

    NAMES = ("means", "log_scales", "quaternions", "opacity_logits", "sh_dc", "sh_rest")

    def __init__(self, gaussians: Gaussians, rates: LearningRates, extent: float) -> None:
        """Start from a copy of `gaussians`; `extent` is the unit of position rates [scene units]."""
        self.rates, self.extent = rates, extent
        tensors = _split(gaussians.detached())
        groups = []
        for name in self.NAMES:
            rate = getattr(rates, name) * (extent if name == "means" else 1.0)
            groups.append({"params": [tensors[name].requires_grad_()], "lr": rate, "name": name})
        self.adam = torch.optim.Adam(groups, eps=1e-15, fused=True)

    @property
    def tensors(self) -> dict[str, torch.Tensor]:
        """Leaf tensors by name."""
        return {group["name"]: group["params"][0] for group in self.adam.param_groups}

    @property
    def means_rate(self) -> float:
        """The present learning rate of the means [scene units]."""
        return self.adam.param_groups[0]["lr"]

    def gaussians(self) -> Gaussians:
        """The gaussians, joined to the leaf tensors by gradient."""
        t = self.tensors
        sh = torch.cat([t["sh_dc"], t["sh_rest"]], dim=1)
        return Gaussians(t["means"], t["log_scales"], t["quaternions"], t["opacity_logits"], sh)

    def step(self, progress: float, held: torch.Tensor | None = None) -> None:
        """One step of Adam, after a backward pass.

        Args:
            progress: Part of the iterations that is done, in [0, 1]; sets the rate of the means.
            held: Rows that must not move, shape (N,), bool.
        """
        first, last = self.rates.means * self.extent, self.rates.means_final * self.extent
        self.adam.param_groups[0]["lr"] = first * (last / first) ** progress
        if held is not None:
            for tensor in self.tensors.values():
                if tensor.grad is not None:
                    tensor.grad[held] = 0.0
        self.adam.step()
        self.adam.zero_grad(set_to_none=True)

    @torch.no_grad()
    def overwrite(self, rows: torch.Tensor, values: Gaussians) -> None:
        """Replace rows (M,) by `values`, and forget what Adam knows of them."""
        fresh = _split(values)
        for name, tensor in self.tensors.items():
            tensor[rows] = fresh[name]
            for moment in MOMENTS:
                if moment in self.adam.state.get(tensor, {}):
                    self.adam.state[tensor][moment][rows] = 0.0

    @torch.no_grad()
    def append(self, added: Gaussians) -> None:
        """Add gaussians at the end, with moments of zero."""
        fresh = _split(added)
        for group in self.adam.param_groups:
            old = group["params"][0]
            new = torch.cat([old.detach(), fresh[group["name"]]]).requires_grad_()
            state = self.adam.state.pop(old, {})
            for moment in MOMENTS:
                if moment in state:
                    state[moment] = torch.cat([state[moment], torch.zeros_like(fresh[group["name"]])])
            group["params"][0] = new
            self.adam.state[new] = state

    def state_dict(self) -> dict[str, Any]:
        """Everything that `load_state_dict` needs to go on as if nothing had happened."""
        tensors = {name: tensor.detach() for name, tensor in self.tensors.items()}
        return {"tensors": tensors, "adam": self.adam.state_dict()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from `state_dict`, whatever the number of gaussians was."""
        for group in self.adam.param_groups:
            group["params"][0] = state["tensors"][group["name"]].clone().requires_grad_()
        self.adam.state.clear()
        self.adam.load_state_dict(state["adam"])


def _split(gaussians: Gaussians) -> dict[str, torch.Tensor]:
    """Tensors by name, with the harmonics split."""
    tensors = dict(gaussians.named())
    sh = tensors.pop("sh")
    return {**tensors, "sh_dc": sh[:, :1].clone(), "sh_rest": sh[:, 1:].clone()}
