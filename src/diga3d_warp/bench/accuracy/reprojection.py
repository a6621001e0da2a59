"""Error and time of each sampling of a reprojection (DIBR), on two views of a room with known depth."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np
import torch

from diga3d_warp.bench.stages import quiet
from diga3d_warp.config import Accuracy
from diga3d_warp.evaluation.metrics import psnr
from diga3d_warp.evaluation.tables import Table
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.synthetic.arc import arc_cameras
from diga3d_warp.scene.synthetic.room import room_scenery
from diga3d_warp.scene.synthetic.shots import set_stage, take
from diga3d_warp.splatting.reproject import Warp, reproject

SIZE = (320, 240)
"""Width and height of both views [px]."""

VIEWS = 24
SOURCE, TARGET = 10, 12
"""Of the arc's views, two that are 8 degrees apart."""

AHEAD = 0.5
"""Distance that the target camera moves forward [m]: a quarter of its distance, so that samples spread."""

FINEST = 4
"""Samples per side of a pixel of the truth."""

SAMPLINGS = {
    "nearest": Accuracy(sampling="nearest"),
    "bilinear": Accuracy(sampling="bilinear"),
    "nearest, 2 x 2 samples": Accuracy(sampling="nearest", supersampling=2),
    "bilinear, 2 x 2 samples": Accuracy(sampling="bilinear", supersampling=2),
}
STANDARD = "bilinear"
ORACLE = Accuracy(sampling="bilinear", supersampling=FINEST)


class Reprojected(NamedTuple):
    """A reprojection and its gradient.

    Attributes:
        warp: Without gradient.
        gradient: In the source's image, of a fixed sum of the target's colours, shape (H, W, 3), float64.
        forward, backward: Wall times [s].
    """

    warp: Warp
    gradient: torch.Tensor
    forward: float
    backward: float


class Sight(NamedTuple):
    """A source image with depth, and the true image of the target camera.

    Attributes:
        image, depth: Of the source, shapes (H, W, 3) and (H, W), float32.
        source, target: The cameras.
        seen: The target's image, shape (H, W, 3).
    """

    image: torch.Tensor
    depth: torch.Tensor
    source: Camera
    target: Camera
    seen: torch.Tensor


def sight() -> Sight:
    """Two views of the room."""
    cameras = list(arc_cameras(*SIZE, VIEWS, 0).values())
    stage, random = set_stage(room_scenery(0), 0, shadows=False), np.random.default_rng(0)
    source, target = cameras[SOURCE], moved_ahead(cameras[TARGET])
    shot, other = (take(stage, camera, 2, random) for camera in (source, target))
    image, seen = (torch.from_numpy(each.image).float() / 255.0 for each in (shot, other))
    return Sight(image, torch.from_numpy(shot.depth).float(), source, target, seen)


def moved_ahead(camera: Camera) -> Camera:
    """The camera further along its axis."""
    pose = camera.world_to_camera.clone()
    pose[2, 3] -= AHEAD
    return camera.with_pose(pose)


def reprojection_table(repeats: int) -> Table:
    """Error and time of each sampling."""
    views = sight()
    exact = reprojected(views._replace(image=views.image.double(), depth=views.depth.double()), ORACLE)
    runs: dict[str, list[Reprojected]] = {name: [] for name in SAMPLINGS}
    with quiet():
        for _ in range(repeats + 1):
            for name, results in runs.items():
                results.append(reprojected(views, SAMPLINGS[name]))
    # The first run loads the kernels.
    forward = {name: min(each.forward for each in results[1:]) for name, results in runs.items()}
    backward = {name: min(each.backward for each in results[1:]) for name, results in runs.items()}
    standard = forward[STANDARD] + backward[STANDARD]
    rows = [
        (
            name,
            *_errors(results[0], exact, views),
            f"{1e3 * forward[name]:.1f}",
            f"{1e3 * backward[name]:.1f}",
            f"{(forward[name] + backward[name]) / standard:.2f}",
        )
        for name, results in runs.items()
    ]
    columns = [
        "sampling", "PSNR [dB]", "max", "mean", "gradient", "missing [%]", "against the view itself [dB]",
        "forward [ms]", "backward [ms]", "times",
    ]  # fmt: skip
    title = (
        f"Reprojection (`Accuracy.sampling`, `Accuracy.supersampling`), {SIZE[0]} x {SIZE[1]} px, against "
        f"{FINEST} x {FINEST} bilinear samples in float64"
    )
    return Table(title, columns, rows)


def _errors(found: Reprojected, exact: Reprojected, views: Sight) -> list[str]:
    """Errors where both see a surface, and the share of what the exact one sees that this one misses."""
    warp, truth = found.warp, exact.warp
    both = warp.visible & truth.visible
    difference = (warp.image.double() - truth.image)[both].abs()
    missing = (truth.visible & ~warp.visible).sum() / truth.visible.sum()
    gradient = (found.gradient - exact.gradient).norm() / exact.gradient.norm()
    return [
        f"{psnr(warp.image, truth.image, both):.1f}",
        f"{difference.max():.1e}",
        f"{difference.mean():.1e}",
        f"{gradient:.1e}",
        f"{100.0 * missing:.1f}",
        f"{psnr(warp.image, views.seen, both):.1f}",
    ]


def reprojected(views: Sight, accuracy: Accuracy) -> Reprojected:
    """Reproject the source into the target, and backpropagate a seeded gradient."""
    image, depth = views.image.clone().requires_grad_(), views.depth.clone().requires_grad_()
    start = time.perf_counter()
    warp = reproject(image, depth, views.source, views.target, accuracy=accuracy)
    forward = time.perf_counter() - start
    random = torch.Generator().manual_seed(0)
    adj_image = torch.randn(warp.image.shape, generator=random, dtype=torch.float64).to(image)
    start = time.perf_counter()
    gradient, _ = torch.autograd.grad(warp.image, [image, depth], adj_image)
    backward = time.perf_counter() - start
    return Reprojected(Warp(*(part.detach() for part in warp)), gradient.double(), forward, backward)
