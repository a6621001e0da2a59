"""Cost of an effect: a training step with it and without it, timed on this machine's processor."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import torch

from diga3d_warp.config import Effects
from diga3d_warp.effects.plan import Choice, EffectsPlan
from diga3d_warp.gaussians.exposure import IDENTITY, exposed
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.render import render
from diga3d_warp.splatting.shade import coefficient_count

PRICED = ("sh_degree", "lens", "antialias", "depth", "median_depth", "normals", "exposure", "background")
"""Effects that change what a step computes, in the order in which they are timed.

Pixel order is not among them: a step with it takes 50 times as long (`diga3d bench effects`), longer than all
others together."""

SECONDS = 1.0
"""Time that pricing may take once all kernels are compiled [s]; what it did not reach has no price."""

ROUNDS = 5
"""Most times that each step is timed; the fastest counts."""

LONGEST_SIDE = 320
"""Size of the image that is timed [px]: a step of it takes some 20 ms."""

MOST_GAUSSIANS = 20_000
"""Gaussians that are timed, spread evenly over those given."""

BEHIND = (0.2, 0.3, 0.4)
"""Any colour behind the gaussians: it changes no time."""


def toggled(effects: Effects, name: str) -> Effects:
    """The effects with one switched: on to off, off to on; any degree of harmonics to 0, and 0 to 3."""
    if name == "sh_degree":
        return replace(effects, sh_degree=0 if effects.sh_degree else 3)
    return replace(effects, **{name: not getattr(effects, name)})


def training_step(gaussians: Gaussians, camera: Camera, effects: Effects) -> Callable[[], None]:
    """A function that renders an image and its gradient as a step of `fit` does, without loss and Adam.

    Args:
        gaussians: Rendered; not changed. Coefficients of harmonics that the effects leave out are not held.
        camera: Camera of the image.
        effects: What is simulated; exposure as a transform that has a gradient itself.
    """
    kept = gaussians.sh[:, : coefficient_count(effects.sh_degree)]
    parameters = replace(gaussians, sh=kept).detached().requires_grad_()
    transform = IDENTITY.clone().requires_grad_()
    pull = torch.ones(camera.height, camera.width, 3)

    def step() -> None:
        rendering = render(parameters, camera, effects=effects, background=BEHIND)
        color = exposed(rendering.color, transform) if effects.exposure else rendering.color
        total = (color * pull).sum()
        for output in (rendering.depth, rendering.median_depth, rendering.normals):
            if output is not None and output.requires_grad:
                total = total + output.sum()
        total.backward()
        for _, tensor in parameters.named():
            tensor.grad = None

    return step


def fastest(steps: dict[str, Callable[[], None]], rounds: int, seconds: float) -> dict[str, float]:
    """Least processor time of each function [s], the functions called in turn.

    Time of the processor rather than of the clock: others may share the machine. Each function is called
    once before, for its kernels to be compiled. Those that `seconds` on the clock do not reach are left out;
    the first is always there.
    """
    for step in steps.values():
        step()
    times: dict[str, float] = {}
    end = time.perf_counter() + seconds
    for _ in range(rounds):
        for name, step in steps.items():
            if times and time.perf_counter() > end:
                return times
            start = time.process_time()
            step()
            times[name] = min(times.get(name, float("inf")), time.process_time() - start)
    return times


def priced(plan: EffectsPlan, gaussians: Gaussians, camera: Camera) -> EffectsPlan:
    """The plan with the cost of each effect that can be switched, against the plan as it is.

    Args:
        plan: Effects plan of the scene.
        gaussians: Gaussians to render or, before a fit, its initialisation.
        camera: One of the scene's.
    """
    camera = camera.within(LONGEST_SIDE)
    stride = -(-len(gaussians) // MOST_GAUSSIANS)
    sample = gaussians.select(torch.arange(0, len(gaussians), stride))
    names = [name for name in PRICED if name != "lens" or camera.distortion is not None]
    steps = {"": training_step(sample, camera, plan.effects)}
    steps |= {name: training_step(sample, camera, toggled(plan.effects, name)) for name in names}
    times = fastest(steps, ROUNDS, SECONDS)

    def with_price(choice: Choice) -> Choice:
        if choice.effect not in times:
            return choice
        other, now = times[choice.effect], times[""]
        added = now - other if choice.value else other - now
        return replace(choice, cost_ms=1e3 * added, cost_share=added / now)

    return replace(plan, choices=tuple(map(with_price, plan.choices)))
