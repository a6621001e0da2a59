"""Anchors: what a camera is shown, rows and parts of the decoder, gradients, and files."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from diga3d_warp.config import Accuracy
from diga3d_warp.errors import InputError
from diga3d_warp.gaussians.lift import LiftSettings, divided, vote
from diga3d_warp.gaussians.scaffold.anchors import ANCHORS
from diga3d_warp.gaussians.scaffold.storage import load_anchors
from diga3d_warp.gaussians.storage import load
from diga3d_warp.scene.camera import look_at
from diga3d_warp.splatting.render import render
from scaffolds import HEIGHT, WIDTH, cloud, in_double, lively, ring, same, scaffold_of

FINE = replace(Accuracy.EXACT, footprint="affine", pixel_order=False)


def test_gradients_through_the_rasteriser_are_those_of_finite_differences():
    """In float64, along a random direction of each parameter, of anchors and of networks."""
    scaffold, camera = in_double(lively()), ring(1)[0]
    random = torch.Generator().manual_seed(2)
    wanted = torch.randn(HEIGHT, WIDTH, 3, generator=random, dtype=torch.float64)

    def loss(named: dict[str, torch.Tensor]) -> torch.Tensor:
        moved = scaffold.with_parameters(named)
        return (render(moved, camera, accuracy=FINE).color * wanted).sum()

    leaves = {name: tensor.clone().requires_grad_() for name, tensor in scaffold.named()}
    assert render(scaffold, camera).alpha.max() > 0.3, "not blank"
    gradients = dict(zip(leaves, torch.autograd.grad(loss(leaves), list(leaves.values())), strict=True))
    step = 1e-8  # so small that no pixel crosses a cutoff of the renderer
    for name, tensor in scaffold.named():
        direction = torch.randn(tensor.shape, generator=random, dtype=torch.float64)
        there, back = (
            loss({**dict(scaffold.named()), name: tensor + sign * step * direction}) for sign in (1.0, -1.0)
        )
        by_difference = float(there - back) / (2.0 * step)
        along = float((gradients[name] * direction).sum())
        assert along == pytest.approx(by_difference, rel=2e-4, abs=1e-5), name


def test_gradients_reach_the_pose_of_the_camera():
    scaffold, camera = lively(), ring(1)[0]
    pose = camera.world_to_camera.clone().requires_grad_()
    render(scaffold, camera.with_pose(pose)).color.sum().backward()
    assert pose.grad.isfinite().all() and (pose.grad[:3] != 0.0).all()


def test_culling_of_anchors_changes_no_pixel():
    """The camera looks past some of them, and stands among others."""
    scaffold = scaffold_of(80)
    outwards = look_at(np.array([0.3, 0.0, 0.0]), np.array([3.0, 0.2, 0.1]))
    beside = ring(1)[0].with_pose(torch.from_numpy(outwards))
    for camera in (*ring(3, 1.2), *ring(2, 0.2), beside):
        near = scaffold.near(camera)
        everything = replace(scaffold)
        everything.near = lambda _: torch.arange(len(scaffold))
        assert torch.equal(render(scaffold, camera).color, render(everything, camera).color)
        assert len(near) > 0
    assert len(scaffold.near(beside)) < len(scaffold)


@pytest.mark.parametrize("name", ["features", "offsets", "log_spans", "log_sizes", "means"])
@pytest.mark.parametrize("broken", [math.nan, math.inf])
def test_an_anchor_with_broken_numbers_is_not_drawn(name, broken):
    scaffold, camera = scaffold_of(), ring(1)[0]
    owner = int(scaffold.drawn_in(camera).owners[0])
    others = scaffold.select(torch.arange(len(scaffold)) != owner)
    getattr(scaffold, name)[owner] = broken
    leaves = {key: tensor.requires_grad_() for key, tensor in scaffold.named()}
    rendering = render(scaffold, camera)
    assert torch.equal(rendering.color, render(others, camera).color)
    gradients = torch.autograd.grad(rendering.color.sum(), list(leaves.values()), allow_unused=True)
    assert all(each.isfinite().all() for each in gradients if each is not None)


def test_a_camera_that_sees_no_anchor_shows_the_background():
    scaffold = scaffold_of()
    away = scaffold.select(torch.zeros(0, dtype=torch.int64))
    for empty in (away, replace(scaffold, means=scaffold.means + 1e4)):
        rendering = render(empty, ring(1)[0], background=(0.2, 0.4, 0.6))
        assert (rendering.color - torch.tensor([0.2, 0.4, 0.6])).abs().max() < 1e-6
        assert len(empty.drawn_in(ring(1)[0]).gaussians) == 0


def test_an_anchor_at_the_centre_of_the_camera():
    scaffold = scaffold_of()
    camera = ring(1)[0]
    scaffold.means[0] = torch.from_numpy(camera.center).float()
    scaffold.requires = [tensor.requires_grad_() for _, tensor in scaffold.named()]
    rendering = render(scaffold, camera)
    assert rendering.color.isfinite().all() and rendering.alpha.max() > 0.1
    gradients = torch.autograd.grad(rendering.color.sum(), scaffold.requires, allow_unused=True)
    assert all(each.isfinite().all() for each in gradients if each is not None)


def test_votes_of_an_anchor_are_those_of_its_gaussians():
    scaffold, cameras = scaffold_of(), ring(3)
    masks = [np.ones((HEIGHT, WIDTH), bool), np.zeros((HEIGHT, WIDTH), bool), np.ones((HEIGHT, WIDTH), bool)]
    votes = vote(scaffold, cameras, masks)
    assert votes.total.shape == (len(scaffold),)
    pairs = zip(cameras, masks, strict=True)
    sums = [vote(scaffold.seen_from(camera), [camera], [mask]) for camera, mask in pairs]
    assert float(votes.total.sum()) == pytest.approx(float(sum(each.total.sum() for each in sums)), rel=1e-5)
    assert (votes.inside <= 2.0).all() and (votes.visible <= 3.0).all()
    assert float(votes.share.max()) <= 1.0 + 1e-6


def test_fitting_some_anchors_needs_no_weights_of_the_others():
    scaffold = scaffold_of().joined(cloud(9, seed=4))
    free = torch.zeros(len(scaffold), dtype=torch.bool)
    free[::3] = True
    parted = scaffold.parted(free)
    assert set(parted.parts[free].tolist()).isdisjoint(parted.parts[~free].tolist())
    for camera in ring(2):
        assert (render(parted, camera).color - render(scaffold, camera).color).abs().max() < 1e-5
    assert same(scaffold.parted(torch.ones(len(scaffold), dtype=torch.bool)), scaffold)


def test_selected_anchors_bring_only_their_parts_of_the_decoder():
    scaffold = scaffold_of(20).joined(cloud(5, seed=4))
    last = scaffold.select(scaffold.parts == 1)
    assert len(last.decoder) == 1 and (last.parts == 0).all()
    camera = ring(1)[0]
    mine = render(last, camera).color
    assert mine.max() > 0.1
    black = scaffold.brightened(scaffold.parts == 0, 0.0)
    assert (render(black, camera).color <= mine + 1e-5).all()


def test_anchors_are_brightened():
    scaffold, camera = scaffold_of(), ring(1)[0]
    everything = torch.ones(len(scaffold), dtype=torch.bool)
    before = render(scaffold, camera).color
    half = render(scaffold.brightened(everything, torch.tensor(0.5)), camera).color
    torch.testing.assert_close(half, 0.5 * before, rtol=1e-4, atol=1e-5)
    red = scaffold.brightened(everything, torch.tensor([[1.0, 0.0, 0.0]]).expand(len(scaffold), 3))
    assert (render(red, camera).color[..., 1:] <= 1e-6).all()
    assert scaffold.tints.unique().tolist() == [1.0], "the first is as it was"


def test_properties_of_rows():
    scaffold = scaffold_of()
    opacities = scaffold.opacities
    assert opacities.shape == (len(scaffold),) and (opacities > 0.05).all() and (opacities < 1.0).all()
    assert (scaffold.scales > 0.0).all() and scaffold.coefficients == 1
    assert len(scaffold.plain(ring(3))) <= len(scaffold) * scaffold.slots


def test_a_file_gives_back_the_same_bytes(tmp_path):
    scaffold = scaffold_of().joined(cloud(5, seed=4))
    scaffold.save(tmp_path)
    assert same(load(tmp_path), scaffold)
    first = (tmp_path / ANCHORS).read_bytes()
    load_anchors(tmp_path / ANCHORS).save(tmp_path)
    assert (tmp_path / ANCHORS).read_bytes() == first


def _cut(scaffold):
    scaffold.features = scaffold.features[:-1]


def _no_number(scaffold):
    scaffold.features[0, 0] = math.nan


def _no_such_part(scaffold):
    scaffold.parts[0] = 7


@pytest.mark.parametrize("spoil", [_cut, _no_number, _no_such_part])
def test_a_file_of_broken_anchors_is_refused(tmp_path, spoil):
    scaffold = scaffold_of()
    spoil(scaffold)
    scaffold.save(tmp_path)
    with pytest.raises(InputError, match="damaged"):
        load(tmp_path)


def test_a_file_that_is_no_file_of_anchors_is_refused(tmp_path):
    (tmp_path / ANCHORS).write_bytes(b"PK nothing")
    with pytest.raises(InputError, match="damaged"):
        load(tmp_path)
    np.savez(tmp_path / ANCHORS, means=np.zeros((2, 3)))
    with pytest.raises(InputError, match="damaged"):
        load(tmp_path)


def test_an_anchor_is_divided_between_those_that_share_its_gaussians():
    scaffold, camera = scaffold_of(), ring(1)[0]
    random = torch.Generator().manual_seed(4)
    taken = torch.rand(len(scaffold) * scaffold.slots, generator=random) < 0.3
    taken[: scaffold.slots] = True  # the first anchor is taken whole, the second not at all
    taken[scaffold.slots : 2 * scaffold.slots] = False
    parted = scaffold.divided(taken, torch.ones_like(taken))
    assert len(scaffold) < len(parted) < 2 * len(scaffold)
    assert torch.equal(parted.means[: len(scaffold)], scaffold.means), "rows keep their place"
    torch.testing.assert_close(render(parted, camera).color, render(scaffold, camera).color)
    drawn = parted.drawn_in(camera)
    before = scaffold.drawn_in(camera)
    assert len(drawn.gaussians) == len(before.gaussians)
    rows = torch.zeros(len(parted), dtype=torch.bool)
    rows[len(scaffold) :], rows[0] = True, True
    assert int(rows[drawn.owners].sum()) == int(taken[before.slots].sum())
    assert len(parted.select(~rows).drawn_in(camera).gaussians) == int((~taken[before.slots]).sum())
    nothing = scaffold.divided(taken, torch.zeros_like(taken))
    assert same(nothing, scaffold)


def test_only_gaussians_of_the_mask_are_divided_off():
    scaffold, cameras = scaffold_of(40), ring(4)
    left = np.zeros((HEIGHT, WIDTH), bool)
    left[:, : WIDTH // 2] = True
    masks = [left, left[:, ::-1].copy(), ~left, left]
    parted = divided(scaffold, cameras, masks, LiftSettings())
    assert len(parted) > len(scaffold)
    for camera in cameras:
        torch.testing.assert_close(render(parted, camera).color, render(scaffold, camera).color)
    plain = cloud(10)
    assert divided(plain, cameras, masks, LiftSettings()) is plain
