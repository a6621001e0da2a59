"""Attention propagation in a UNet: every self-attention passes through a bank (paper Sec. 3.3)."""

from __future__ import annotations

from typing import Any

import torch
import torch.nn.functional as F

from diga3d_warp.priors.attention import AttentionBank, attend_through


class BankedSelfAttention:
    """Attention processor of diffusers for one self-attention of a UNet.

    With the bank off it computes what diffusers' own processor does.

    Args:
        bank: Where references leave their keys and values.
        layer: Name of this attention.
    """

    def __init__(self, bank: AttentionBank, layer: str) -> None:
        self.bank = bank
        self.layer = layer

    def __call__(
        self,
        attn: Any,
        hidden_states: torch.Tensor,
        encoder_hidden_states: torch.Tensor | None = None,
        attention_mask: torch.Tensor | None = None,
        temb: torch.Tensor | None = None,
    ) -> torch.Tensor:
        """Self-attention over tokens (B, N, C), as a UNet's transformer blocks call it.

        A transformer block has no mask, group norm or residual inside its self-attention; another model that
        has would not be computed rightly.

        Raises:
            NotImplementedError: the call is not a plain self-attention.
        """
        plain = attention_mask is None and attn.group_norm is None and not attn.residual_connection
        if encoder_hidden_states is not None or not plain or hidden_states.ndim != 3:
            raise NotImplementedError(f"{self.layer} is not a plain self-attention")
        query, key, value = (
            project(hidden_states).unflatten(-1, (attn.heads, -1)).transpose(1, 2)
            for project in (attn.to_q, attn.to_k, attn.to_v)
        )
        attended = attend_through(self.bank, self.layer, query, key, value, scaled_dot_product)
        out = attn.to_out[0](attended.transpose(1, 2).flatten(2))
        return attn.to_out[1](out) / attn.rescale_output_factor


def scaled_dot_product(query: torch.Tensor, key: torch.Tensor, value: torch.Tensor) -> torch.Tensor:
    """Eq. 3: queries (B, heads, N, D) to keys and values (B or 1, heads, M, D)."""
    rows = query.shape[0]
    return F.scaled_dot_product_attention(query, key.expand(rows, -1, -1, -1), value.expand(rows, -1, -1, -1))


def install(unet: Any, bank: AttentionBank) -> dict[str, Any]:
    """Put the bank into every self-attention of a UNet.

    Cross-attentions, IP-Adapter's among them, stay as they are.

    Returns:
        The processors that were there, for `restore`.
    """
    before = dict(unet.attn_processors)
    banked = {
        name: BankedSelfAttention(bank, name) if name.endswith("attn1.processor") else processor
        for name, processor in before.items()
    }
    unet.set_attn_processor(banked)
    return before


def restore(unet: Any, before: dict[str, Any]) -> None:
    """Put the processors back that `install` replaced."""
    unet.set_attn_processor(dict(before))  # set_attn_processor empties the dictionary it is given
