"""Anchors that an edit left as they were."""

from __future__ import annotations

import hashlib

import torch

from diga3d_warp.gaussians.scaffold.anchors import BY_ROW, Scaffold


def same_anchors(before: Scaffold, after: Scaffold) -> torch.Tensor:
    """Row of `after` that holds each anchor of `before`, decoded by the same weights; -1 for none, (N,)."""
    rows = {key: row for row, key in enumerate(_keys(after))}
    return torch.tensor([rows.get(key, -1) for key in _keys(before)], dtype=torch.int64)


def _keys(scaffold: Scaffold) -> list[bytes]:
    """The bytes that decide what an anchor looks like, one string each."""
    flat = torch.cat([getattr(scaffold, name).detach().reshape(len(scaffold), -1) for name in BY_ROW], dim=1)
    decoders = [_digest(scaffold, part) for part in range(len(scaffold.decoder))]
    numbers = zip(scaffold.parts.tolist(), scaffold.closed.cpu().numpy(), flat.cpu().numpy(), strict=True)
    return [decoders[part] + closed.tobytes() + row.tobytes() for part, closed, row in numbers]


def _digest(scaffold: Scaffold, part: int) -> bytes:
    digest = hashlib.blake2b(digest_size=16)
    for _, weight in scaffold.decoder.named():
        digest.update(weight[part].detach().cpu().numpy().tobytes())
    return digest.digest()
