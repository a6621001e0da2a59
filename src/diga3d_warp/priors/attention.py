"""Attention feature propagation (AFP): views attend to the features of reference views.

Paper Sec. 3.3, Eq. 3 and Eq. 4. A bank holds the features of the references at one timestep; a prior passes
each of its self-attentions through it, in whatever form the prior has them.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import torch

from diga3d_warp.errors import InputError

AFP_WEIGHT = 0.6
"""lambda_a of Eq. 4 (paper, appendix)."""


class Features(Protocol):
    """Features of a view at one attention layer, to which other views attend; opaque to the bank."""

    @property
    def nbytes(self) -> int:
        """Memory of the features [bytes]."""
        ...


@dataclass(frozen=True, eq=False)
class KeysValues:
    """The features of a network: K_r and V_r of Eq. 3.

    Attributes:
        key: Shape (1, ..., M, D).
        value: Shape (1, ..., M, E).
    """

    key: torch.Tensor
    value: torch.Tensor

    @property
    def nbytes(self) -> int:
        """Memory of keys and values [bytes]."""
        return self.key.nbytes + self.value.nbytes

    def to(self, device: torch.device) -> KeysValues:
        """The same on a device; they themselves if they are there."""
        return KeysValues(self.key.to(device), self.value.to(device))

    @staticmethod
    def joined(parts: Sequence[KeysValues]) -> KeysValues:
        """Those of several references as if they were one with more tokens."""
        return KeysValues(
            torch.cat([each.key for each in parts], -2), torch.cat([each.value for each in parts], -2)
        )


class AttentionBank:
    """Features of reference views at one timestep, and the attention to them.

    Outside of both modes attention is unchanged. In `writing`, each attention also stores its features; in
    `reading`, it is blended with the attention to the stored ones:

        w / K sum_r Attn(Q_i, K_r, V_r) + (1 - w) Attn(Q_i, K_i, V_i)

    The references are attended to one by one and averaged, as Eq. 4 says; one softmax over all of them
    together lets the best match win.

    Args:
        weight: lambda_a, in [0, 1] [1]. At 0 the result is exactly the view's own attention.
        joined: Whether the softmax is one over all references; of networks only, to compare.

    Raises:
        InputError: the weight is outside [0, 1].
    """

    def __init__(self, weight: float = AFP_WEIGHT, joined: bool = False) -> None:
        if not 0.0 <= weight <= 1.0:
            raise InputError(f"attention weight {weight} is outside [0, 1]: the paper uses {AFP_WEIGHT}")
        self.weight = weight
        self.joined = joined
        self._mode: Literal["off", "write", "read"] = "off"
        self._half: Hashable = None
        self._kept: dict[Hashable, list[Features]] = {}

    @contextmanager
    def writing(self, half: Hashable = None) -> Iterator[None]:
        """Attentions in this block store their features.

        Args:
            half: Half of classifier-free guidance; a reader of the same half finds them.
        """
        yield from self._as("write", half)

    @contextmanager
    def reading(self, half: Hashable = None) -> Iterator[None]:
        """Attentions in this block are blended with those to the references of the same half."""
        yield from self._as("read", half)

    def attend(
        self,
        layer: Hashable,
        own: torch.Tensor,
        features: Sequence[Features],
        attention: Callable[[Any], torch.Tensor],
    ) -> torch.Tensor:
        """One self-attention layer: plain, written to the bank, or blended with the references' features.

        Args:
            layer: Name of the attention, the same for all views.
            own: Attention of each view to itself, shape (B, ...).
            features: Features of each of the B views, stored in `writing`.
            attention: Attention of the B views to the features of one reference, shape (B, ...).

        Returns:
            Shape (B, ...).

        Raises:
            LookupError: reading a layer that no reference has written in this half.
        """
        if self._mode == "write" and self.weight > 0.0:
            self._kept.setdefault((layer, self._half), []).extend(features)
        if self._mode != "read" or self.weight == 0.0:
            return own
        references: Sequence[Any] = self._kept[layer, self._half]
        if self.joined:
            references = [KeysValues.joined(references)]
        propagated = torch.zeros_like(own)
        for reference in references:
            propagated = propagated + attention(reference)
        return torch.lerp(own, propagated / len(references), self.weight)

    def copy(self, other: AttentionBank, device: torch.device) -> None:
        """Hold what another bank holds, on a device, to read it there; of networks only."""
        kept: dict[Hashable, list[Any]] = dict(other._kept)
        self._kept = {layer: [each.to(device) for each in features] for layer, features in kept.items()}

    def clear(self) -> None:
        """Forget all references: the next timestep has its own."""
        self._kept.clear()

    @property
    def size(self) -> int:
        """Memory of the stored features [bytes]."""
        return sum(each.nbytes for kept in self._kept.values() for each in kept)

    def _as(self, mode: Literal["write", "read"], half: Hashable) -> Iterator[None]:
        before = self._mode, self._half
        self._mode, self._half = mode, half
        try:
            yield
        finally:
            self._mode, self._half = before


def attend_through(
    bank: AttentionBank,
    layer: Hashable,
    query: torch.Tensor,
    key: torch.Tensor,
    value: torch.Tensor,
    attention: Callable[[torch.Tensor, torch.Tensor, torch.Tensor], torch.Tensor],
) -> torch.Tensor:
    """The self-attention of a network, through a bank.

    Args:
        bank: Bank that stores the keys and values of the references.
        layer: Name of the attention.
        query: Shape (B, ..., N, D), one row a view.
        key: Shape (B, ..., M, D).
        value: Shape (B, ..., M, E).
        attention: Attn(Q, K, V) of Eq. 3, of queries to keys and values whose first dimension is B or 1.

    Returns:
        Shape (B, ..., N, E).
    """
    rows = [KeysValues(key[k : k + 1].detach(), value[k : k + 1].detach()) for k in range(len(key))]
    own = attention(query, key, value)
    return bank.attend(layer, own, rows, lambda left: attention(query, left.key, left.value))
