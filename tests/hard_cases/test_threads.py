"""Sums of many threads: the parts of a launch may run in any order, and not a bit changes."""

from __future__ import annotations

from collections import deque

import pytest
import torch

from diga3d_warp.config import POSE_GROUP, Accuracy, Effects
from diga3d_warp.kernels import launch
from diga3d_warp.splatting.reproject import reproject
from poison import images, rendered
from scenes import camera_at, random_gaussians

COUNT = 3 * POSE_GROUP + POSE_GROUP // 2 + 17
"""Without the guard, three parts of a launch would split a group of gaussians; three whole groups would hide
it."""

EVERYTHING = Effects(antialias=True, normals=True, median_depth=True)


@pytest.fixture
def orders(monkeypatch, threads):
    """Runs a function with all parts of its launches in order, then with the last part first."""

    def run(work):
        threads(3)
        results = []
        for arrange in (list, reversed):
            shared: list[int] = []

            def share(parts: deque, arrange=arrange, shared=shared) -> None:
                for part in arrange(parts):
                    part.launch()
                shared.append(len(parts))

            monkeypatch.setattr(launch, "_share", share)
            results.append(work())
            assert max(shared) >= 3
        return results

    return run


@pytest.mark.parametrize(
    "effects,accuracy",
    [
        (Effects(), Accuracy.STANDARD),
        (EVERYTHING, Accuracy.STANDARD),
        (Effects(pixel_order=True), Accuracy.DRAFT),
    ],
    ids=["as 3DGS", "everything", "per-pixel order"],
)
def test_bits_do_not_depend_on_which_part_runs_first(orders, effects, accuracy):
    gaussians, camera = random_gaussians(COUNT), camera_at(width=50, height=40)
    (out, leaves), (again, others) = orders(lambda: rendered(gaussians, camera, effects, accuracy))
    assert out.alpha.max() > 0.9
    for (name, image), (_, other) in zip(images(out), images(again), strict=True):
        assert torch.equal(image, other), name
    for name, leaf in leaves.items():
        assert leaf.grad.any(), name
        assert torch.equal(leaf.grad, others[name].grad), name


@pytest.mark.parametrize("accuracy", [Accuracy.STANDARD, Accuracy.DRAFT], ids=["mesh", "points"])
def test_reprojected_bits_do_not_depend_on_which_part_runs_first(orders, accuracy):
    source, target = camera_at(width=60, height=50), camera_at(width=60, height=50, distance=2.5)
    random = torch.Generator().manual_seed(0)
    image = torch.rand(50, 60, 3, generator=random)
    depth = 3.0 + 0.1 * torch.rand(50, 60, generator=random)

    def work():
        leaves = image.clone().requires_grad_(), depth.clone().requires_grad_()
        out = reproject(*leaves, source, target, accuracy=accuracy)
        (out.image.square().sum() + out.depth.square().sum()).backward()
        return *out, *(leaf.grad for leaf in leaves)

    first, second = orders(work)
    assert first[2].float().mean() > 0.3
    assert all(torch.equal(a, b) for a, b in zip(first, second, strict=True))
