"""Growing: anchors where gaussians are pulled, in free voxels, the most pulled ones first."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from diga3d_warp.gaussians.scaffold.growing import asked_for, new_anchors
from diga3d_warp.gaussians.scaffold.settings import GrowthSettings
from diga3d_warp.gaussians.scaffold.voxels import voxels_of
from scaffolds import scaffold_of

EVERY = GrowthSettings(levels=(1.0,), chance=1.0)


def generator() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def asked(scaffold, pull, settings=EVERY):
    may_ask = torch.ones(len(pull), dtype=torch.bool)
    return asked_for(scaffold, pull, may_ask, settings, generator())


def spread(count: int = 40):
    """Anchors whose gaussians reach into other voxels."""
    scaffold = scaffold_of(count)
    scaffold.log_spans += 0.7
    return scaffold


def test_no_anchor_grows_where_nothing_is_pulled():
    scaffold = spread()
    grown = asked(scaffold, torch.zeros(len(scaffold) * scaffold.slots))
    assert len(grown.means) == 0
    assert all(len(value) == 0 for value in new_anchors(scaffold, grown, generator()).values())


def test_anchors_grow_in_voxels_that_have_none():
    scaffold = spread()
    pull = torch.rand(len(scaffold) * scaffold.slots, generator=generator()) + 1.0
    grown = asked(scaffold, pull)
    cells = {tuple(cell) for cell in voxels_of(grown.means.numpy(), scaffold.voxel).tolist()}
    taken = {tuple(cell) for cell in voxels_of(scaffold.means.numpy(), scaffold.voxel).tolist()}
    assert 0 < len(cells) == len(grown.means)
    assert cells.isdisjoint(taken)
    assert (grown.pull.diff() <= 0.0).all(), "the most pulled first"
    slots = scaffold.slots
    for mean, owner, most in zip(grown.means, grown.owners.tolist(), grown.pull, strict=True):
        rows = slice(owner * slots, (owner + 1) * slots)
        assert most in pull[rows]
        spans = torch.exp(scaffold.log_spans[owner])
        places = scaffold.means[owner] + scaffold.offsets[owner] * spans
        assert ((places - mean).abs().amax(dim=1) <= 0.5001 * scaffold.voxel).any()


def test_finer_voxels_need_a_harder_pull():
    scaffold = spread()
    settings = replace(EVERY, levels=(1.0, 0.25), pull=1.0)
    pull = torch.full((len(scaffold) * scaffold.slots,), 1.5)
    assert set(asked(scaffold, pull, settings).sizes.tolist()) == {scaffold.voxel}
    assert set(asked(scaffold, 2.0 * pull, settings).sizes.tolist()) == {
        scaffold.voxel,
        0.25 * scaffold.voxel,
    }


def test_new_anchors_look_like_those_that_asked():
    scaffold = spread()
    scaffold.tints[:] = 0.5
    grown = asked(scaffold, torch.ones(len(scaffold) * scaffold.slots))
    anchors = new_anchors(scaffold, grown, generator())
    assert torch.equal(anchors["features"], scaffold.features[grown.owners])
    assert (anchors["tints"] == 0.5).all()
    assert (torch.exp(anchors["log_sizes"]) <= 1.0001 * grown.sizes[:, None]).all()
    away = anchors["offsets"] * torch.exp(anchors["log_spans"])[:, None]
    assert (away.abs() <= 0.5001 * grown.sizes[:, None, None]).all()


def test_broken_positions_ask_for_nothing():
    scaffold = spread()
    scaffold.offsets[3] = torch.nan
    grown = asked(scaffold, torch.ones(len(scaffold) * scaffold.slots))
    assert grown.means.isfinite().all() and 3 not in grown.owners.tolist()


@pytest.mark.parametrize("size", [1e3, 1e-9])
def test_a_grid_of_one_cell_and_of_countless_ones(size):
    scaffold = replace(spread(), voxel=size)
    scaffold.means += 5.0
    grown = asked(scaffold, torch.ones(len(scaffold) * scaffold.slots))
    if size > 1.0:
        assert len(grown.means) == 0, "the one voxel has an anchor"
    else:
        assert len(grown.means) == len(scaffold) * scaffold.slots
