"""Where torch tensors become Warp arrays: no copy, no gradient; gradients are joined by hand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
import warp as wp

from diga3d_warp.kernels.precision import types_of

REALS: dict[torch.dtype, Any] = {torch.float32: wp.float32, torch.float64: wp.float64}
"""Warp's scalar type for each of torch's that kernels are built for."""


def warp_array(tensor: torch.Tensor, dtype: Any) -> Any:
    """View a contiguous tensor as a Warp array of scalars, vectors or matrices."""
    wp.init()  # from_torch does not, where this is the first call of all
    return wp.from_torch(tensor.detach(), dtype=dtype, requires_grad=False)


def vector_arrays(tensors: Sequence[torch.Tensor]) -> list[Any]:
    """View tensors (N,), (N, C) and (N, 4, 4) as Warp arrays of scalars, vectors and matrices."""
    arrays = []
    for tensor in tensors:
        types = types_of(REALS[tensor.dtype])
        if tensor.ndim == 1:
            dtype = REALS[tensor.dtype]
        else:
            dtype = types.mat44 if tensor.ndim == 3 else getattr(types, f"vec{tensor.shape[1]}")
        arrays.append(warp_array(tensor, dtype))
    return arrays


def like(tensor: torch.Tensor | None, reference: torch.Tensor) -> torch.Tensor:
    """A contiguous gradient in the type of what it belongs to; zeros where torch passed none."""
    if tensor is None:
        return torch.zeros_like(reference)
    return tensor.to(reference.dtype).contiguous()
