"""One step of a fit, cut into its stages and timed: render, loss, their adjoints, and the optimiser."""

from __future__ import annotations

import gc
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import torch
import warp as wp

from diga3d_warp.bench.garden import DEGREE, Garden, project_into
from diga3d_warp.config import Effects
from diga3d_warp.gaussians.losses import photometric_loss
from diga3d_warp.gaussians.optimiser import GaussianAdam, LearningRates
from diga3d_warp.kernels import plain
from diga3d_warp.kernels.launch import set_thread_count, thread_count, timed_launches
from diga3d_warp.splatting.arrays import vector_arrays
from diga3d_warp.splatting.composite import bin_projection, composite
from diga3d_warp.splatting.project import Projection
from diga3d_warp.splatting.render import render
from diga3d_warp.splatting.shade import shade

Seconds = dict[str, list[float]]
"""Wall-clock times [s] of each stage, one for each repeat."""

RASTERISER = ("sort and bin", "blend", "blend adjoint", "sum rows")
"""Stages whose cost follows the pairs of pixels and gaussians."""

OTHERS = (
    "project", "shade", "loss", "loss adjoint", "shade adjoint", "project adjoint", "optimiser"
)  # fmt: skip
"""Stages whose cost follows the gaussians, or the pixels."""

STAGES = (
    "project", "shade", "sort and bin", "blend", "loss", "loss adjoint", "blend adjoint", "sum rows",
    "shade adjoint", "project adjoint", "optimiser",
)  # fmt: skip
"""All stages in the order in which they run."""

WHOLE = "whole step"
"""The same step in one piece, as a fit runs it; the time beyond its stages is overhead of torch."""

PLAIN = ("plain blend", "plain blend adjoint")

EFFECTS = Effects(depth=False)
SSIM_WEIGHT = 0.2
NOISE = 0.1
"""Standard deviation of the difference between photograph and rendering, so that no gradient is zero."""


STILL = LearningRates(
    means=1e-12, means_final=1e-12, log_scales=1e-12, quaternions=1e-12, opacity_logits=1e-12, sh_dc=1e-12
)
"""Learning rate too small to change anything: every repeat renders the same scene."""


class Bench:
    """A scene, its photograph and an optimiser, ready to be timed."""

    def __init__(self, garden: Garden) -> None:
        self.garden, self.camera = garden, garden.camera
        gaussians = garden.gaussians()
        noise = torch.Generator().manual_seed(garden.seed)
        seen = render(gaussians, self.camera, effects=EFFECTS).color
        self.photograph = (seen + NOISE * torch.randn(seen.shape, generator=noise)).clamp(0.0, 1.0)
        self.optimiser = GaussianAdam(gaussians, STILL)

    def stages(self, repeats: int) -> Seconds:
        """Time every stage, each fed by the one before."""
        seconds: Seconds = defaultdict(list)
        with quiet():
            for repeat in range(repeats + 1):
                measured: dict[str, float] = {}
                self._step(measured)
                if repeat > 0:  # the first one compiles and warms up
                    for name, value in measured.items():
                        seconds[name].append(value)
        return seconds

    def whole(self, repeats: int) -> Seconds:
        """Time the step in one piece."""
        seconds: Seconds = {WHOLE: []}
        with quiet():
            for repeat in range(repeats + 1):
                start = time.perf_counter()
                rendering = render(self.optimiser.gaussians(), self.camera, effects=EFFECTS)
                loss = self._loss(rendering.color)
                gradients = torch.autograd.grad(loss, list(self.optimiser.tensors.values()))
                self._move(gradients, rendering.projection)
                if repeat > 0:
                    seconds[WHOLE].append(time.perf_counter() - start)
        return seconds

    def plain(self, repeats: int) -> Seconds:
        """Time the plain rasteriser on the same bins, one thread."""
        gaussians, camera = self.optimiser.gaussians(), self.camera
        with torch.no_grad():
            projection = project_into(gaussians, camera)
            colors = shade(gaussians.means, gaussians.sh, projection.extents, camera, DEGREE)
        pixels = camera.width * camera.height
        bins = bin_projection(projection, camera.width, camera.height)
        splats = plain.Blended(
            *vector_arrays([projection.centers, projection.factors, projection.opacities, colors])
        )
        image = plain.Image(*(wp.zeros(pixels, dtype=dtype, device="cpu") for dtype in (wp.vec3, float)))
        adj_image = plain.Image(*(wp.ones(pixels, dtype=dtype, device="cpu") for dtype in (wp.vec3, float)))
        seconds: Seconds = {name: [] for name in PLAIN}
        with quiet():
            for repeat in range(repeats + 1):
                adj_splats = plain.Blended(*map(wp.zeros_like, splats))
                start = time.perf_counter()
                plain.composite(bins, camera.width, camera.height, splats, image)
                middle = time.perf_counter()
                plain.composite_adjoint(
                    bins, camera.width, camera.height, splats, image, adj_image, adj_splats
                )
                if repeat > 0:
                    seconds["plain blend"].append(middle - start)
                    seconds["plain blend adjoint"].append(time.perf_counter() - middle)
        return seconds

    def _step(self, measured: dict[str, float]) -> None:
        gaussians, camera = self.optimiser.gaussians(), self.camera
        with watch(measured, "project"):
            projection = project_into(gaussians, camera)
        with watch(measured, "shade"):
            colors = shade(gaussians.means, gaussians.sh, projection.extents, camera, DEGREE)

        flat = projection._replace(
            centers=_leaf(projection.centers),
            factors=_leaf(projection.factors),
            opacities=_leaf(projection.opacities),
        )
        shaded = _leaf(colors)
        with watch(measured, "sort and bin"), timed_launches() as launches:
            blended = composite(flat, shaded, camera.width, camera.height, effects=EFFECTS)
        measured["blend"] = sum(seconds for name, seconds in launches if name == "composite")
        measured["sort and bin"] -= measured["blend"]

        color = _leaf(blended.color)
        with watch(measured, "loss"):
            loss = self._loss(color)
        with watch(measured, "loss adjoint"):
            (adj_color,) = torch.autograd.grad(loss, color)

        inputs = [flat.centers, flat.factors, flat.opacities, shaded]
        with watch(measured, "sum rows"), timed_launches() as launches:
            adj_splats = torch.autograd.grad(blended.color, inputs, adj_color)
        measured["blend adjoint"] = sum(t for name, t in launches if name == "composite_adjoint")
        measured["sum rows"] -= measured["blend adjoint"]

        parameters = list(self.optimiser.tensors.values())
        with watch(measured, "shade adjoint"):
            of_means, of_sh = torch.autograd.grad(colors, [gaussians.means, gaussians.sh], adj_splats[3])
        with watch(measured, "project adjoint"):
            gradients = list(torch.autograd.grad(
                [projection.centers, projection.factors, projection.opacities], parameters[:4],
                list(adj_splats[:3]),
            ))  # fmt: skip
            gradients[0] = gradients[0].add_(of_means)
        with watch(measured, "optimiser"):
            self._move([*gradients, of_sh], projection)

    def _move(self, gradients: Sequence[torch.Tensor], projection: Projection) -> None:
        by_name = dict(zip(self.optimiser.tensors, gradients, strict=True))
        self.optimiser.step(by_name, STILL.means, visible=projection.visible)

    def _loss(self, color: torch.Tensor) -> torch.Tensor:
        return photometric_loss(color, self.photograph, None, SSIM_WEIGHT)


@contextmanager
def watch(measured: dict[str, float], name: str) -> Iterator[None]:
    """Record the wall-clock time of the block [s] under a name."""
    start = time.perf_counter()
    yield
    measured[name] = time.perf_counter() - start


@contextmanager
def quiet() -> Iterator[None]:
    """Keep Python's garbage collector from running inside a measurement."""
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


@contextmanager
def threads(count: int) -> Iterator[None]:
    """Set the number of threads of Warp's launches and of torch inside the block."""
    before, torch_before = thread_count(), torch.get_num_threads()
    set_thread_count(count)
    torch.set_num_threads(count)
    try:
        yield
    finally:
        set_thread_count(before)
        torch.set_num_threads(torch_before)


def _leaf(tensor: torch.Tensor) -> torch.Tensor:
    return tensor.detach().requires_grad_()
