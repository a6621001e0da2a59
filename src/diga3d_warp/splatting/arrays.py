"""Where torch tensors become Warp arrays: no copy, no gradient; gradients are joined by hand."""

from __future__ import annotations

from typing import Any

import torch
import warp as wp


def warp_array(tensor: torch.Tensor, dtype: Any) -> Any:
    """View a contiguous tensor as a Warp array of scalars, vectors or matrices."""
    wp.init()  # from_torch does not, where this is the first call of all
    return wp.from_torch(tensor.detach(), dtype=dtype, requires_grad=False)


def like(tensor: torch.Tensor | None, reference: torch.Tensor) -> torch.Tensor:
    """A contiguous float32 gradient; zeros where torch passed none."""
    if tensor is None:
        return torch.zeros_like(reference)
    return tensor.to(torch.float32).contiguous()
