"""Small scaffolds for the tests of anchors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.gaussians.scaffold.anchors import BY_ROW, Scaffold
from diga3d_warp.gaussians.scaffold.decoder import Decoder
from diga3d_warp.gaussians.scaffold.encode import encoded
from diga3d_warp.scene.camera import Camera, look_at
from scenes import random_gaussians

WIDTH, HEIGHT = 48, 32


def ring(count: int = 6, distance: float = 3.0) -> list[Camera]:
    """Cameras around the origin."""
    around = np.linspace(0, 2 * np.pi, count, endpoint=False)
    poses = [look_at(distance * np.array([np.cos(a), np.sin(a), 0.3]), np.zeros(3)) for a in around]
    return [Camera(WIDTH, HEIGHT, 45.0, 45.0, 24.0, 16.0, torch.from_numpy(pose)) for pose in poses]


def cloud(count: int = 60, seed: int = 3) -> Gaussians:
    """Opaque gaussians whose colour does not depend on the view."""
    gaussians = random_gaussians(count, seed=seed, degree=0)
    gaussians.sh *= 0.7
    gaussians.opacity_logits.clamp_(-1.0, 2.0)
    return gaussians


def scaffold_of(count: int = 60, seed: int = 3, slots: int = 4, width: int = 16) -> Scaffold:
    """Anchors that show such a cloud."""
    return encoded(cloud(count, seed), 1.0, slots, width, 0.5)


def lively(count: int = 24, seed: int = 5, slots: int = 3, width: int = 8) -> Scaffold:
    """Anchors whose networks answer to feature, direction and distance alike."""
    scaffold = scaffold_of(count, seed, slots, width)
    random = torch.Generator().manual_seed(seed)
    weights = {
        name: weight + 0.2 * torch.randn(weight.shape, generator=random)
        for name, weight in scaffold.decoder.named()
    }
    return replace(scaffold, decoder=Decoder.of(weights))


def in_double(scaffold: Scaffold) -> Scaffold:
    """The same in float64."""
    named = {name: tensor.double() for name, tensor in scaffold.named()}
    return scaffold.with_parameters(named)


def same(a: Scaffold, b: Scaffold) -> bool:
    """Whether two scaffolds have the same bytes."""
    mine, theirs = ([*each.named(), ("", each.parts), ("", each.closed)] for each in (a, b))
    pairs = zip(mine, theirs, strict=True)
    return all(torch.equal(mine, theirs) for (_, mine), (_, theirs) in pairs)


def rows_of(scaffold: Scaffold) -> dict[str, torch.Tensor]:
    """Parameters that have a row for each anchor, copied."""
    return {name: getattr(scaffold, name).detach().clone() for name in BY_ROW}
