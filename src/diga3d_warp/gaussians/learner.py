"""What a fit does to its scene: a step of Adam, and density control where it is due."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import torch

from diga3d_warp.gaussians.density import relocate_and_grow, walk
from diga3d_warp.gaussians.optimiser import GaussianAdam
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.gaussians.representation import Drawn, Representation
from diga3d_warp.scene.camera import Camera

if TYPE_CHECKING:
    from diga3d_warp.gaussians.fit import FitSettings


class Seen(NamedTuple):
    """What one image has shown of a scene, and asks of it.

    Attributes:
        camera: Of the image.
        drawn: The M gaussians that were drawn.
        visible: Which of them the image may show, shape (M,), bool.
        pull: Norm of the gradient of the loss by their projected centres [1 / px], shape (M,).
        gradients: Gradient of each parameter, by name.
    """

    camera: Camera
    drawn: Drawn
    visible: torch.Tensor
    pull: torch.Tensor
    gradients: Mapping[str, torch.Tensor]


class Learner(Protocol):
    """A scene while it is fitted."""

    def scene(self) -> Representation:
        """The scene; its parameters are leaf tensors that carry gradient."""

    def learn(self, seen: Seen, iteration: int) -> None:
        """One step of Adam, and density control where it is due, after an image of an iteration."""

    def state_dict(self) -> dict[str, Any]:
        """Everything that `load_state_dict` needs to go on as if nothing had happened."""

    def load_state_dict(self, state: dict[str, Any]) -> None: ...


class Fitting(NamedTuple):
    """What a learner knows of its fit.

    Attributes:
        settings: Iterations, budget, learning rates and density control.
        extent: Unit of lengths [scene units].
        images: Their number.
        held: Rows that keep their values, shape (N,), bool; rows added later are free. None: none.
        generator: Source of random choices; its state is in the checkpoint of the fit.
    """

    settings: FitSettings
    extent: float
    images: int
    held: torch.Tensor | None
    generator: torch.Generator

    def held_of(self, count: int) -> torch.Tensor | None:
        """Rows that keep their values, of `count` rows, shape (count,)."""
        if self.held is None:
            return None
        return torch.nn.functional.pad(self.held, (0, count - len(self.held)))

    def wanted(self, first: int, most: int, begin: float, end: float, done: float) -> int:
        """Rows that a scene should have at a point of the fit.

        Geometric growth, so that each round adds the same share; done three quarters of the way.

        Args:
            first: Rows at the start.
            most: Budget of rows; never fewer than at the start.
            begin, end: Parts of the iterations between which rows are added.
            done: Part of the iterations that is done.
        """
        first = max(first, 1)
        share = min(1.0, (done - begin) / (end - begin) / 0.75)
        return round(first * (max(most, first) / first) ** share)


class GaussianLearner:
    """Gaussians while they are fitted.

    Attributes:
        optimiser: Holds the gaussians.
        pull, shown: Summed pull of images on each gaussian and number of images that showed it since the last
            round of density control, shape (N,).
        last_shown: Iteration of the last image that showed it, shape (N,), int64.
    """

    def __init__(self, gaussians: Gaussians, fitting: Fitting) -> None:
        self.fitting = fitting
        self.optimiser = GaussianAdam(gaussians, fitting.settings.rates)
        self.first_count = len(gaussians)
        self.pull, self.shown = torch.zeros(2, len(gaussians)).unbind()
        self.last_shown = torch.zeros(len(gaussians), dtype=torch.int64)

    def scene(self) -> Gaussians:
        """The gaussians as leaf tensors."""
        return self.optimiser.gaussians()

    def learn(self, seen: Seen, iteration: int) -> None:
        """See `Learner.learn`; gaussians that the image does not show keep value and moments."""
        fitting, done = self.fitting, iteration / self.fitting.settings.iterations
        means_rate = fitting.settings.rates.of_means(done, fitting.extent)
        held = fitting.held_of(len(self.last_shown))
        self.optimiser.step(seen.gradients, means_rate, held, seen.visible)
        self.note(seen.pull, seen.visible, iteration)
        self.control_density(iteration, done, means_rate)

    def note(self, pull: torch.Tensor, visible: torch.Tensor, iteration: int) -> None:
        """Accumulate the pull (N,) of an image on the gaussians that are visible in it (N,)."""
        self.pull += pull
        self.shown += visible
        self.last_shown[visible] = iteration

    def unseen(self, iteration: int) -> torch.Tensor:
        """Gaussians that were visible in none of the images since each was last used, shape (N,), bool.

        Adam skips gaussians that an image does not show, so neither images nor regularisers would update
        them. Images come in rounds of random order: within two rounds' steps each comes once at least.
        """
        return iteration - self.last_shown >= 2 * self.fitting.images

    def control_density(self, iteration: int, done: float, means_rate: float) -> None:
        """Move, add and shake gaussians where it is due, after a part of the iterations in [0, 1]."""
        fitting, density = self.fitting, self.fitting.settings.density
        held = fitting.held_of(len(self.last_shown))
        if density.begin <= done < density.end and iteration % density.interval == 0:
            budget = fitting.settings.budget
            wanted = fitting.wanted(self.first_count, budget, density.begin, density.end, done)
            pull = self.pull / self.shown.clamp_min(1.0)
            placed = relocate_and_grow(
                self.optimiser, wanted, pull, self.unseen(iteration), density, fitting.generator, held
            )
            count = len(self.optimiser.tensors["means"])
            self.pull, self.shown = torch.zeros(2, count).unbind()
            self.last_shown = torch.nn.functional.pad(self.last_shown, (0, count - len(self.last_shown)))
            self.last_shown[placed] = iteration
            held = fitting.held_of(count)
        if done < density.end:
            walk(self.scene(), means_rate / fitting.extent**2, density, fitting.generator, held)

    def state_dict(self) -> dict[str, Any]:
        """See `Learner.state_dict`."""
        seen = {"pull": self.pull, "shown": self.shown, "last_shown": self.last_shown}
        return {"optimiser": self.optimiser.state_dict(), **seen}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from `state_dict`."""
        self.optimiser.load_state_dict(state["optimiser"])
        self.pull, self.shown, self.last_shown = state["pull"], state["shown"], state["last_shown"]


def learner_of(scene: Representation, fitting: Fitting) -> Learner:
    """The learner of a scene, which it starts from a copy of."""
    if isinstance(scene, Gaussians):
        return GaussianLearner(scene, fitting)
    from diga3d_warp.gaussians.scaffold.anchors import Scaffold
    from diga3d_warp.gaussians.scaffold.learner import ScaffoldLearner

    assert isinstance(scene, Scaffold)
    return ScaffoldLearner(scene, fitting)
