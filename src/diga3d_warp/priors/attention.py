"""Attention feature propagation (AFP): views attend to the keys and values of reference views.

Paper Sec. 3.3, Eq. 3 and Eq. 4. A bank holds what references left at one timestep; priors pass each of their
self-attentions through `AttentionBank.attend`, whatever attention is to them.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from typing import Literal

import torch

from diga3d_warp.errors import InputError

AFP_WEIGHT = 0.6
"""lambda_a of Eq. 4 (paper, appendix)."""

Attention = Callable[[torch.Tensor, torch.Tensor, torch.Tensor], torch.Tensor]
"""Attn(Q, K, V) of Eq. 3, with any leading dimensions that the three broadcast over."""


class AttentionBank:
    """Keys and values of reference views at one timestep, and the attention to them.

    Off, attention is as if the bank were not there. In `writing`, each attention also leaves its keys and
    values; in `reading`, it is blended with the attention to them:

        w / K sum_r Attn(Q_i, K_r, V_r) + (1 - w) Attn(Q_i, K_i, V_i)

    The references are attended to one by one and averaged: one softmax over all of them together would let
    the best match win, which is not Eq. 4.

    Args:
        weight: lambda_a, in [0, 1] [1]. At 0 the result is exactly the view's own attention.

    Raises:
        InputError: the weight is outside [0, 1].
    """

    def __init__(self, weight: float = AFP_WEIGHT) -> None:
        if not 0.0 <= weight <= 1.0:
            raise InputError(f"attention weight {weight} is outside [0, 1]: the paper uses {AFP_WEIGHT}")
        self.weight = weight
        self._mode: Literal["off", "write", "read"] = "off"
        self._half: Hashable = None
        self._kept: dict[Hashable, list[tuple[torch.Tensor, torch.Tensor]]] = {}

    @contextmanager
    def writing(self, half: Hashable = None) -> Iterator[None]:
        """Attentions in this block leave their keys and values.

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
        query: torch.Tensor,
        key: torch.Tensor,
        value: torch.Tensor,
        attention: Attention,
    ) -> torch.Tensor:
        """One self-attention, as the mode asks.

        Args:
            layer: Name of the attention, the same for all views.
            query: Shape (B, ..., N, D), one row a view.
            key: Shape (B, ..., M, D).
            value: Shape (B, ..., M, E).
            attention: Attention of `query` to keys and values whose first dimension is B or 1.

        Returns:
            Shape (B, ..., N, E).

        Raises:
            LookupError: reading a layer that no reference has written in this half.
        """
        own = attention(query, key, value)
        if self._mode == "write" and self.weight > 0.0:
            rows = [(key[k : k + 1].detach(), value[k : k + 1].detach()) for k in range(key.shape[0])]
            self._kept.setdefault((layer, self._half), []).extend(rows)
        if self._mode != "read" or self.weight == 0.0:
            return own
        references = self._kept[layer, self._half]
        propagated = torch.zeros_like(own)
        for reference_key, reference_value in references:
            propagated = propagated + attention(query, reference_key, reference_value)
        return torch.lerp(own, propagated / len(references), self.weight)

    def clear(self) -> None:
        """Forget all references: the next timestep has its own."""
        self._kept.clear()

    @property
    def size(self) -> int:
        """What the kept keys and values occupy [bytes]."""
        return sum(k.nbytes + v.nbytes for rows in self._kept.values() for k, v in rows)

    def _as(self, mode: Literal["write", "read"], half: Hashable) -> Iterator[None]:
        before = self._mode, self._half
        self._mode, self._half = mode, half
        try:
            yield
        finally:
            self._mode, self._half = before
