"""Growing and pruning of anchors (Lu et al. 2024, Sec. 3.3), within a budget."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch

from diga3d_warp.gaussians.scaffold.anchors import Scaffold
from diga3d_warp.gaussians.scaffold.settings import GrowthSettings
from diga3d_warp.gaussians.scaffold.voxels import grouped, voxels_of

FRESH_SPAN = 0.5
"""Offsets of a new anchor's gaussians are drawn from this part of its voxel to both sides."""


class Grown(NamedTuple):
    """Voxels in which gaussians ask for anchors.

    Attributes:
        means: Centres of the voxels, shape (G, 3).
        owners: The anchor that asks most in each, shape (G,), int64.
        sizes: Sides of the voxels [scene units], shape (G,).
        pull: Its pull, shape (G,).
    """

    means: torch.Tensor
    owners: torch.Tensor
    sizes: torch.Tensor
    pull: torch.Tensor


@torch.no_grad()
def asked_for(
    scaffold: Scaffold, pull: torch.Tensor, may_ask: torch.Tensor, settings: GrowthSettings,
    generator: torch.Generator,
) -> Grown:  # fmt: skip
    """Voxels without an anchor in which gaussians are pulled hard, the hardest first.

    Args:
        scaffold: N anchors of k gaussians.
        pull: Mean pull on each gaussian [1 / half images], shape (N * k,).
        may_ask: Which gaussians were shown often enough, shape (N * k,), bool.
        settings: Voxels and thresholds.
        generator: Which gaussians take part in this round.
    """
    owners = torch.arange(len(scaffold)).repeat_interleave(scaffold.slots)
    spans = torch.exp(scaffold.log_spans)[owners]
    positions = scaffold.means[owners] + scaffold.offsets.reshape(-1, 3) * spans
    may_ask = may_ask & positions.isfinite().all(dim=1)
    taken, found = scaffold.means.double().numpy(), []
    for level, factor in enumerate(settings.levels):
        lot = torch.rand(len(pull), generator=generator) < settings.chance ** (level + 1)
        chosen = torch.nonzero(may_ask & lot & (pull >= settings.pull * 2.0**level))[:, 0]
        if not len(chosen):
            continue
        grown = _free_voxels(positions[chosen], pull[chosen], owners[chosen], taken, factor * scaffold.voxel)
        taken = np.concatenate([taken, grown.means.double().numpy()])
        found.append(grown)
    if not found:
        nothing = scaffold.means[:0]
        return Grown(nothing, owners[:0], nothing[:, 0], nothing[:, 0])
    everything = Grown(*(torch.cat(each) for each in zip(*found, strict=True)))
    order = torch.argsort(everything.pull, descending=True, stable=True)
    return Grown(*(each[order] for each in everything))


def _free_voxels(
    positions: torch.Tensor, pull: torch.Tensor, owners: torch.Tensor, taken: np.ndarray, size: float
) -> Grown:
    """Voxels of the positions that hold none of the anchors in `taken` (A, 3)."""
    cells, voxel = grouped(np.concatenate([voxels_of(taken, size), voxels_of(positions.numpy(), size)]))
    free = np.ones(len(cells), bool)
    free[voxel[: len(taken)]] = False
    mine = voxel[len(taken) :]
    # Of several gaussians in a voxel the last in the order of rising pull is kept: the most pulled one.
    strongest = np.full(len(cells), -1)
    order = np.argsort(pull.numpy(), kind="stable")
    strongest[mine[order]] = order
    chosen = strongest[free & (strongest >= 0)]
    centers = torch.from_numpy((cells[mine[chosen]] + 0.5) * size).to(positions)
    rows = torch.from_numpy(chosen)
    return Grown(centers, owners[rows], torch.full((len(rows),), size).to(positions), pull[rows])


@torch.no_grad()
def new_anchors(scaffold: Scaffold, grown: Grown, generator: torch.Generator) -> dict[str, torch.Tensor]:
    """Parameters of new anchors, by name: feature and tint are those of the anchor that asked.

    The paper starts their offsets at 0, where all k gaussians are drawn on one spot.
    """
    log_voxels = torch.log(grown.sizes)[:, None]
    offsets = FRESH_SPAN * (2.0 * torch.rand(len(grown.means), scaffold.slots, 3, generator=generator) - 1.0)
    return {
        "means": grown.means,
        "features": scaffold.features[grown.owners],
        "offsets": offsets.to(grown.means),
        "log_spans": log_voxels.expand(-1, 3).contiguous(),
        "log_sizes": torch.minimum(scaffold.log_sizes[grown.owners], log_voxels),
        "tints": scaffold.tints[grown.owners],
    }
