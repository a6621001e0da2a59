"""Error and time of ways to render a scene."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from tqdm import tqdm

from diga3d_warp.bench.accuracy.knobs import ORACLE, STANDARD, Way
from diga3d_warp.bench.accuracy.scenes import Subject
from diga3d_warp.bench.stages import quiet
from diga3d_warp.config import Effects
from diga3d_warp.evaluation.metrics import psnr
from diga3d_warp.splatting.render import render

TIE_TIME, TIE_ERROR = 0.03, 0.01
"""Relative differences up to which two times and two errors count as equal: the variation of repeated
measurements on an idle machine, and an invisible difference."""

SLOW = 0.5
"""Seconds from which a way to render is timed once: its share of noise is small, and repeats would take most
of the command's time."""


@dataclass(frozen=True)
class Error:
    """Error of a rendering against another.

    Attributes:
        psnr: Of colour, for a peak of 1 [dB].
        largest, mean: Of the absolute difference of colours, over pixels and channels.
        gradient: |g - g'| / |g'| of the gradient in means, scales, rotations, opacities or harmonics,
            whichever is furthest off.
    """

    psnr: float
    largest: float
    mean: float
    gradient: float

    @property
    def root_mean_square(self) -> float:
        """Of the difference of colours."""
        return 10.0 ** (-self.psnr / 20.0)


class Rendered(NamedTuple):
    """A rendering and its gradients.

    Attributes:
        color: shape (H, W, 3), float64.
        gradients: Gradients of a fixed weighted sum of the colours, by parameter, float64.
        forward, backward: Wall times [s].
    """

    color: torch.Tensor
    gradients: dict[str, torch.Tensor]
    forward: float
    backward: float


@dataclass(frozen=True)
class Found:
    """Measurements of one way to render one scene.

    Attributes:
        color, gradients: As in `Rendered`.
        error: Against the oracle.
        forward, backward: Best wall times [s].
    """

    color: torch.Tensor
    gradients: dict[str, torch.Tensor]
    error: Error
    forward: float
    backward: float

    @property
    def seconds(self) -> float:
        """Forward and backward."""
        return self.forward + self.backward


def measure(subject: Subject, ways: Iterable[Way], repeats: int) -> dict[Way, Found]:
    """Measure ways to render a scene; each repeat runs all of them in turn, so that noise affects all alike.

    The slow ones run in the first repeat only.

    Args:
        subject: The scene and its camera.
        ways: `STANDARD` among them.
        repeats: Times that each is run, beyond the one that compiles its kernels.
    """
    truth = rendered(subject, Way(ORACLE))
    first: dict[Way, Rendered] = {}
    times: dict[Way, list[tuple[float, float]]] = {way: [] for way in ways}
    with quiet():
        for repeat in tqdm(range(repeats + 1), subject.name, unit="run", leave=False):
            for way, seconds in times.items():
                if seconds and sum(seconds[0]) > SLOW:
                    continue
                result = rendered(subject, way)
                if repeat == 0:
                    first[way] = result
                else:
                    seconds.append((result.forward, result.backward))
    return {
        way: Found(
            result.color,
            result.gradients,
            error(result, truth),
            min(forward for forward, _ in times[way]),
            min(backward for _, backward in times[way]),
        )
        for way, result in first.items()
    }


def rendered(subject: Subject, way: Way, pixels: torch.Tensor | None = None) -> Rendered:
    """Render a scene and backpropagate a seeded gradient, from the given pixels (H, W) only if any."""
    full, leaves = subject.camera, subject.gaussians.detached().requires_grad_()
    camera = full
    if way.image_scale != 1.0:
        camera = full.resized(round(way.image_scale * full.width), round(way.image_scale * full.height))
    start = time.perf_counter()
    color = render(
        leaves, camera, effects=Effects(sh_degree=way.sh_degree, depth=False), accuracy=way.accuracy
    ).color
    if camera is not full:
        color = _enlarged(color, full.height, full.width)
    forward = time.perf_counter() - start

    random = torch.Generator().manual_seed(0)
    adj_color = torch.randn(color.shape, generator=random, dtype=torch.float64).to(color)
    if pixels is not None:
        adj_color[~pixels] = 0.0
    parameters = dict(leaves.named())
    start = time.perf_counter()
    found = torch.autograd.grad(color, list(parameters.values()), adj_color)
    backward = time.perf_counter() - start
    gradients = {name: gradient.double() for name, gradient in zip(parameters, found, strict=True)}
    # The gradient in a quaternion is as large as it is short: only their product is a property of the image.
    gradients["quaternions"] *= leaves.quaternions.detach().double().norm(dim=1, keepdim=True)
    return Rendered(color.detach().double(), gradients, forward, backward)


def _enlarged(color: torch.Tensor, height: int, width: int) -> torch.Tensor:
    planes = color.permute(2, 0, 1)[None]
    larger = torch.nn.functional.interpolate(planes, (height, width), mode="bilinear", align_corners=False)
    return larger[0].permute(1, 2, 0)


def error(found: Rendered | Found, truth: Rendered | Found) -> Error:
    """Error of one rendering against another."""
    difference = (found.color - truth.color).abs()
    return Error(
        psnr(found.color, truth.color),
        float(difference.max()),
        float(difference.mean()),
        max(_relative(found.gradients[name], wanted) for name, wanted in truth.gradients.items()),
    )


def _relative(found: torch.Tensor, wanted: torch.Tensor) -> float:
    return float((found - wanted).norm() / wanted.norm())


def ratios(found: Mapping[Way, Found], way: Way) -> tuple[float, float, float]:
    """Times forward, backward and together, in those of STANDARD."""
    mine, standard = found[way], found[STANDARD]
    return (
        mine.forward / standard.forward,
        mine.backward / standard.backward,
        mine.seconds / standard.seconds,
    )


def pareto_front(points: Sequence[tuple[float, float]]) -> list[bool]:
    """Indices of the Pareto front of (time, error): no other point is as good in both and better in one."""

    def beats(one: tuple[float, float], other: tuple[float, float]) -> bool:
        parts = list(zip(one, other, (TIE_TIME, TIE_ERROR), strict=True))
        never_worse = all(mine <= theirs * (1.0 + tie) for mine, theirs, tie in parts)
        return never_worse and any(mine < theirs * (1.0 - tie) for mine, theirs, tie in parts)

    return [not any(beats(other, point) for other in points) for point in points]
