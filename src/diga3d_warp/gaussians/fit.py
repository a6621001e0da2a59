"""Fit gaussians to images: Adam on (1 - 0.2) L1 + 0.2 D-SSIM, and on depth where known (paper Sec. 3.5)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import torch

from diga3d_warp.config import NO_EFFECT, Accuracy, Effects
from diga3d_warp.errors import InputError
from diga3d_warp.gaussians.checkpoint import Unusable, origin_of, read_checkpoint, write_checkpoint
from diga3d_warp.gaussians.density import DensitySettings
from diga3d_warp.gaussians.exposure import SETTINGS as EXPOSING
from diga3d_warp.gaussians.exposure import Exposures, exposed, unexposed
from diga3d_warp.gaussians.learner import Fitting, Seen, learner_of
from diga3d_warp.gaussians.losses import depth_loss, photometric_loss
from diga3d_warp.gaussians.optimiser import LearningRates
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.gaussians.representation import Representation
from diga3d_warp.gaussians.scaffold.settings import ScaffoldSettings
from diga3d_warp.gaussians.surround import behind_view, over_shell
from diga3d_warp.gaussians.target import Target
from diga3d_warp.gaussians.working import to_user, to_working
from diga3d_warp.scene.photographs.images import BACKGROUND
from diga3d_warp.scene.working_frame import WorkingFrame
from diga3d_warp.splatting.render import render


@dataclass(frozen=True)
class FitSettings:
    """Iterations, loss weights, learning rates and density control of a fit.

    Attributes:
        iterations: Steps of Adam, one image each.
        budget: Number of gaussians at the end, reached at `density.end`; fewer only if there were more.
        ssim_weight: Part of D-SSIM in the photometric loss. Paper and 3DGS: 0.2.
        depth_weight: Weight of the depth loss, relative to depth [1 / 1].
        opacity_weight, scale_weight: Weights of the mean opacity and the mean scale [1, 1 / scene extent];
            they make useless gaussians fade, so that they can be moved. 3DGS-MCMC: 0.01 each, which over a
            short fit costs sharpness.
        coarse_part: Part of the iterations that sees images of half the size: they cost a quarter, and
            the first shapes need no more.
        sh_steps: Parts of the iterations after which degree 1, 2 and 3 of the harmonics join in, as far as
            the effects let them.
        rates: Learning rates.
        density: Density control.
        scaffold: Settings of anchors (Scaffold-GS), which then stand for gaussians: `rates`, `density` and
            `sh_steps` are not read. None for plain gaussians.
        checkpoint_seconds: Time between two checkpoints [s].
        accuracy: Accuracy of the renderings.
    """

    iterations: int = 3000
    budget: int = 60_000
    ssim_weight: float = 0.2
    depth_weight: float = 0.0
    opacity_weight: float = 0.001
    scale_weight: float = 0.001
    coarse_part: float = 0.3
    sh_steps: tuple[float, ...] = (0.3, 0.5, 0.7)
    rates: LearningRates = field(default_factory=LearningRates)
    density: DensitySettings = field(default_factory=DensitySettings)
    scaffold: ScaffoldSettings | None = None
    checkpoint_seconds: float = field(default=20.0, metadata=NO_EFFECT)
    accuracy: Accuracy = Accuracy.STANDARD


@dataclass(frozen=True, eq=False)
class FitResult:
    """Fitted gaussians or anchors, and the course of the fit.

    Attributes:
        gaussians: Without gradient; anchors if the fit started from anchors.
        curve: Points of the fit: iteration, loss, psnr [dB] of the image at that step, gaussians or anchors.
        seconds: Time spent, summed over interruptions [s].
        exposures: Colour transform of each target, shape (V, 3, 4), where they were fitted.
    """

    gaussians: Representation
    curve: list[dict[str, float]]
    seconds: float
    exposures: torch.Tensor | None = None


_PRIOR = "the prior gives numbers that are not finite; run it in float32, or leave out the fine stage"
REMEDIES = {
    "photometric loss": "check that image and its weights for numbers that are not finite",
    "depth loss": "check the depth of that image",
    "guide": _PRIOR,
    "gradient of the guide": _PRIOR,
    "gradient": "numbers leave the range of float32; check cameras and images for absurd values",
}
"""Remedy for each term of a fit that is not finite."""

CURVE_INTERVAL = 25
"""Iterations between two points of the curve, each the mean over them."""


def fit(
    gaussians: Representation,
    targets: Sequence[Target],
    extent: float,
    settings: FitSettings,
    *,
    effects: Effects = Effects(),
    seed: int = 0,
    held: torch.Tensor | None = None,
    surround: Gaussians | None = None,
    checkpoint: Path | None = None,
    note: Callable[[str], None] | None = None,
    progress: bool = False,
    label: str = "fit",
) -> FitResult:
    """Optimise gaussians until their renderings match the targets.

    The same arguments give the same bytes, also when the fit was interrupted and resumed.

    Args:
        gaussians: Initialisation, gaussians or anchors; not changed. Means of gaussians in float64 are fitted
            relative to their middle.
        targets: At least one.
        extent: Unit of position rates, `Scene.extent` [scene units].
        settings: Iterations, losses, learning rates and density control.
        effects: Effects to simulate. `sh_degree` bounds the harmonics; with `exposure` each target has its
            own colour transform; with `background` a target that has alpha is compared over another random
            colour at each step; depth is blended if the loss needs it, whatever `depth` is.
        seed: Seed of the order of images and of density control.
        held: Gaussians or anchors that keep their values, shape (N,), bool. Those added later are free, and
            behind them: the rows up to the last one that is held keep their place.
        surround: Shell behind the gaussians, seen wherever they let light through; it keeps its values.
            Targets that have alpha are compared without it.
        checkpoint: File to go on from if it exists, and to save to.
        note: Receives a message if the checkpoint is unusable; the fit then starts again.
        progress: Show a bar on stderr.
        label: Name of the fit, on the bar and in errors.

    Raises:
        InputError: there are no gaussians; a loss or a gradient is not finite, after which no step is taken
            and the checkpoint stays as it is.
    """
    from tqdm import trange

    if len(gaussians) == 0:
        raise InputError("there are no gaussians to fit: start from one at least")
    if isinstance(gaussians, Gaussians) and gaussians.means.dtype != gaussians.sh.dtype:
        frame = WorkingFrame(gaussians.means.detach().mean(dim=0).cpu().numpy(), 1.0)
        shifted = [replace(each, camera=each.camera.relative_to(frame.origin)) for each in targets]
        result = fit(
            to_working(gaussians, frame), shifted, extent, settings, effects=effects, seed=seed, held=held,
            surround=None if surround is None else to_working(surround, frame),
            checkpoint=checkpoint, note=note, progress=progress, label=label,
        )  # fmt: skip
        assert isinstance(result.gaussians, Gaussians)
        return replace(result, gaussians=to_user(result.gaussians, frame))
    fitting = _Fit(gaussians, targets, extent, settings, seed, held, effects, label, surround)
    if checkpoint is not None:
        fitting.go_on(checkpoint, note)
    saved = time.monotonic()
    bar = trange(
        fitting.iteration, settings.iterations, initial=fitting.iteration, total=settings.iterations,
        desc=label, unit="it", disable=not progress, mininterval=0.5, dynamic_ncols=True,
    )  # fmt: skip
    for _ in bar:
        fitting.step()
        if progress and fitting.curve:
            last = fitting.curve[-1]
            bar.set_postfix(psnr=f"{last['psnr']:.1f}", gaussians=int(last["gaussians"]), refresh=False)
        if checkpoint is not None and time.monotonic() - saved > settings.checkpoint_seconds:
            fitting.save(checkpoint)
            saved = time.monotonic()
    exposures = fitting.exposures.transforms if fitting.exposures else None
    return FitResult(fitting.learner.scene().detached(), fitting.curve, fitting.seconds, exposures)


class _Fit:
    """The state of a fit between two steps; all of it is in a checkpoint."""

    def __init__(
        self, gaussians, targets, extent, settings: FitSettings, seed: int, held,
        effects: Effects = Effects(), label: str = "fit", surround: Gaussians | None = None,
    ) -> None:  # fmt: skip
        self.settings, self.effects, self.extent, self.label = settings, effects, extent, label
        self.seed = seed
        self.targets = list(targets)
        self.coarse = [target.halved() for target in targets] if settings.coarse_part > 0.0 else []
        self.shells = [
            None if surround is None or target.alpha is not None else behind_view(surround, target.camera)
            for target in targets
        ]
        self.exposures = Exposures([target.camera for target in targets]) if effects.exposure else None
        self.generator = torch.Generator().manual_seed(seed)
        self.fitting = Fitting(settings, extent, len(self.targets), held, self.generator)
        self.learner = learner_of(gaussians, self.fitting)
        self.iteration = 0
        self.order: list[int] = []
        self.curve: list[dict[str, float]] = []
        self.recent: list[tuple[float, float]] = []
        self.seconds = 0.0

    def step(self) -> None:
        """One image, one step of Adam, and density control where it is due."""
        start = time.perf_counter()
        s, done = self.settings, self.iteration / self.settings.iterations
        index = self._next_index()
        target = (self.coarse if done < s.coarse_part else self.targets)[index]
        scene = self.learner.scene()
        drawn = scene.drawn_in(target.camera)
        gaussians = drawn.gaussians
        with_depth = s.depth_weight > 0.0 and target.depth is not None
        effects = replace(self.effects, sh_degree=self._degree(done), depth=with_depth)
        exposure = self.exposures.transforms[index] if self.exposures else None
        behind = self._behind(target)
        # Exposure is that of the object: the background is chosen so that it comes out of it as `behind`.
        background = behind if exposure is None or target.alpha is None else unexposed(behind, exposure)
        rendering = render(
            gaussians, target.camera, effects=effects, accuracy=s.accuracy, background=background
        )
        wanted, color = target.over(behind), rendering.color
        if (shell := self.shells[index]) is not None:
            color = over_shell(color, rendering.alpha, shell, target.camera)
        shown = color
        if exposure is not None:
            color = exposed(color, exposure)
        losses = {"photometric loss": photometric_loss(color, wanted, target.weight, s.ssim_weight)}
        if with_depth:
            assert target.depth is not None
            losses["depth loss"] = s.depth_weight * depth_loss(
                rendering.depth, target.depth, target.weight, aligned=target.relative_depth
            )
        leaves, projection = dict(scene.named()), rendering.projection
        sources = [*leaves.values(), projection.centers]
        if target.guide is not None:
            sources.append(shown.view_as(shown))  # for the gradient of the guide alone
            losses["guide"] = target.guide(sources[-1], done, self.generator)
        loss = sum(losses.values(), torch.zeros(()))
        self._require_finite(losses, index)

        regularised = loss
        if len(gaussians):
            regularised = loss + s.opacity_weight * gaussians.opacities.mean()
            regularised = regularised + s.scale_weight * gaussians.scales.mean() / self.extent
        gradients = torch.autograd.grad(regularised, sources, allow_unused=True, materialize_grads=True)
        if target.guide is not None:
            self._require_finite({"gradient of the guide": gradients[-1].sum()}, index)
        of_leaves, of_centers = gradients[: len(leaves)], gradients[len(leaves)]
        pull = of_centers.norm(dim=1)
        # Networks spread one number that is not finite over all anchors.
        shared = of_leaves if drawn.owners is not None else ()
        self._require_finite({"gradient": sum((each.sum() for each in shared), pull.sum())}, index)
        named = dict(zip(leaves, of_leaves, strict=True))
        if self.exposures and done >= EXPOSING.begin:
            self._update_exposure(index, target, shown, rendering.alpha, background)
        self.learner.learn(Seen(target.camera, drawn, projection.visible, pull, named), self.iteration)
        self._record(float(loss.detach()), color.detach(), wanted, target.weight)
        self.iteration += 1
        self.seconds += time.perf_counter() - start

    def _update_exposure(
        self, index: int, target: Target, color: torch.Tensor, opacity: torch.Tensor, background: torch.Tensor
    ) -> None:
        """Update the exposure of an image, over black on both sides if the image has alpha."""
        assert self.exposures is not None
        alpha = None
        if target.alpha is not None:
            color, alpha = color - (1.0 - opacity)[..., None] * background, opacity
        self.exposures.update(index, color, target.over(torch.zeros(3)), target.solid_weight, alpha)

    def _behind(self, target: Target) -> torch.Tensor:
        """The colour behind image and rendering in this step, shape (3,).

        Over one colour, gaussians of that colour would cost nothing where there is nothing; over random ones
        all cost, and nothing fits best (instant-ngp; `--random_background` of 3DGS; splatfacto's default).
        Each channel is black or white: over all colours between, grey gaussians would cost half as much. A
        guide knows pictures over `BACKGROUND`.
        """
        if target.alpha is None:
            return torch.zeros(3)
        if target.guide is not None or not self.effects.background:
            return torch.tensor(BACKGROUND)
        return torch.randint(0, 2, (3,), generator=self.generator).float()

    def _degree(self, done: float) -> int:
        """Degree of the harmonics after a part of the iterations."""
        degree = sum(done >= part for part in self.settings.sh_steps)
        return degree if self.effects.sh_degree is None else min(degree, self.effects.sh_degree)

    def _require_finite(self, terms: dict[str, torch.Tensor], index: int) -> None:
        """Stop where a term is not finite: gaussians would be lost for good, and in silence.

        Raises:
            InputError: names the term, the image, the iteration, and what would mend it.
        """
        for name, value in terms.items():
            if not math.isfinite(value.detach()):
                raise InputError(
                    f"{self.label}: the {name} of image {index + 1} of {len(self.targets)} is "
                    f"{float(value.detach())} at iteration {self.iteration + 1} of "
                    f"{self.settings.iterations}: {REMEDIES[name]}"
                )

    def _next_index(self) -> int:
        if not self.order:
            self.order = torch.randperm(len(self.targets), generator=self.generator).tolist()
        return self.order.pop()

    def _record(self, loss: float, color: torch.Tensor, wanted: torch.Tensor, weight) -> None:
        if weight is None:
            mean = float(torch.nn.functional.mse_loss(color, wanted))
        else:
            squared = ((color - wanted) ** 2).mean(dim=2)
            mean = float((squared * weight).sum() / weight.sum().clamp_min(1.0))
        self.recent.append((loss, mean))
        if len(self.recent) < CURVE_INTERVAL:
            return
        losses, errors = torch.tensor(self.recent, dtype=torch.float64).mean(dim=0).tolist()
        psnr = -10.0 * torch.log10(torch.tensor(max(errors, 1e-12))).item()
        count = float(len(self.learner.scene()))
        self.curve.append({"iteration": self.iteration + 1, "loss": losses, "psnr": psnr, "gaussians": count})
        self.recent = []

    _PLAIN = ("iteration", "order", "curve", "recent", "seconds")

    @cached_property
    def origin(self) -> str:
        """Digest of what this fit starts from; needed before the first step."""
        settings = replace(self.settings, checkpoint_seconds=0.0)
        sizes = [(target.camera.width, target.camera.height) for target in self.targets]
        held = self.fitting.held
        start = [tensor for _, tensor in self.learner.scene().named()] + ([] if held is None else [held])
        start += [shell for shell in self.shells if shell is not None]
        return origin_of((settings, self.effects, self.extent, self.seed, sizes), start)

    def save(self, path: Path) -> None:
        """Write a checkpoint through a temporary file."""
        state: dict[str, Any] = {name: getattr(self, name) for name in self._PLAIN}
        state["generator"] = self.generator.get_state()
        state["learner"] = self.learner.state_dict()
        if self.exposures:
            state["exposures"] = self.exposures.transforms
        write_checkpoint(path, state, self.origin)

    def go_on(self, path: Path, note: Callable[[str], None] | None) -> None:
        """Go on from a checkpoint if there is one that is usable."""
        assert self.origin  # known from here on: `save` would find other gaussians
        if not path.exists():
            return
        try:
            self.load(path)
        except Unusable as unusable:
            if note is not None:
                note(f"{path} is {unusable}: that stage starts again")

    def load(self, path: Path) -> None:
        """Go on from a checkpoint.

        Raises:
            Unusable: it is damaged or of another fit.
        """
        state = read_checkpoint(path, self.origin)
        for name in self._PLAIN:
            setattr(self, name, state[name])
        self.generator.set_state(state["generator"])
        self.learner.load_state_dict(state["learner"])
        if self.exposures:
            self.exposures.transforms = state["exposures"]
