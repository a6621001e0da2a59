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


def warp_arrays(tensors: Sequence[torch.Tensor], dtypes: Sequence[Any]) -> list[Any]:
    """View tensors as Warp arrays, each of its own type."""
    return [warp_array(tensor, dtype) for tensor, dtype in zip(tensors, dtypes, strict=True)]


def vector_arrays(tensors: Sequence[torch.Tensor]) -> list[Any]:
    """View tensors (N,) as Warp arrays of scalars, and tensors (N, C) as arrays of vectors."""
    arrays = []
    for tensor in tensors:
        real = REALS[tensor.dtype]
        dtype = real if tensor.ndim == 1 else getattr(types_of(real), f"vec{tensor.shape[1]}")
        arrays.append(warp_array(tensor, dtype))
    return arrays


def like(tensor: torch.Tensor | None, reference: torch.Tensor) -> torch.Tensor:
    """A contiguous gradient in the type of what it belongs to; zeros where torch passed none."""
    if tensor is None:
        return torch.zeros_like(reference)
    return tensor.to(reference.dtype).contiguous()


def precision_of(tensor: torch.Tensor) -> str:
    """Name of a tensor's precision, as in `config.Accuracy`."""
    return str(tensor.dtype).removeprefix("torch.")


def device_of(tensor: torch.Tensor) -> wp.Device:
    """Warp's device where a tensor lies."""
    return wp.device_from_torch(tensor.device)
