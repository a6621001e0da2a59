"""Anchors while they are fitted: Adam, and growing and pruning where they are due."""

from __future__ import annotations

from typing import Any

import torch

from diga3d_warp.gaussians.learner import Fitting, Seen
from diga3d_warp.gaussians.scaffold.anchors import Scaffold
from diga3d_warp.gaussians.scaffold.growing import asked_for, new_anchors
from diga3d_warp.gaussians.scaffold.optimiser import AnchorAdam
from diga3d_warp.gaussians.scaffold.settings import SCAFFOLD


class ScaffoldLearner:
    """Anchors while they are fitted, see `learner.Learner`.

    Attributes:
        optimiser: Holds the anchors.
        pull, shown: Summed pull of images on each gaussian [1 / half images], and number of images that
            showed it, since the last round, shape (N * k,).
        opacity, visits: Summed mean opacity of each anchor's gaussians, and number of images that may have
            shown one, since the last round, shape (N,).
        last_shown: Iteration of the last image that may have shown it, shape (N,), int64.
    """

    def __init__(self, scaffold: Scaffold, fitting: Fitting) -> None:
        self.fitting = fitting
        self.settings = fitting.settings.scaffold or SCAFFOLD
        held = fitting.held
        if held is not None:
            scaffold = scaffold.parted(~held)
        self.optimiser = AnchorAdam(scaffold, self.settings.rates)
        self.slots, self.first_count = scaffold.slots, len(scaffold)
        # Rows up to the last one that is held keep their place: others know them by it.
        self.fixed = 0 if held is None or not held.any() else int(torch.nonzero(held)[-1]) + 1
        self.last_shown = torch.zeros(len(scaffold), dtype=torch.int64)
        self._begin_round()

    def _begin_round(self) -> None:
        count = len(self.optimiser.parts)
        self.pull, self.shown = torch.zeros(2, count * self.slots).unbind()
        self.opacity, self.visits = torch.zeros(2, count).unbind()

    def scene(self) -> Scaffold:
        """The anchors as leaf tensors."""
        return self.optimiser.scaffold()

    def _free(self) -> torch.Tensor:
        count = len(self.optimiser.parts)
        held = self.fitting.held_of(count)
        return torch.ones(count, dtype=torch.bool) if held is None else ~held

    def learn(self, seen: Seen, iteration: int) -> None:
        """See `Learner.learn`. As in the paper, moments move anchors that the image does not show, too."""
        done = iteration / self.fitting.settings.iterations
        free = self._free()
        decoder_parts = len(self.optimiser.tensors["decoder.opacity.inner"])
        parts = torch.ones(decoder_parts, dtype=torch.bool)
        parts[self.optimiser.parts[~free]] = False
        self.optimiser.step(seen.gradients, done, free, parts)
        self._note(seen, iteration)
        growth = self.settings.growth
        due = iteration > 0 and iteration % growth.interval == 0
        if due and growth.begin <= done < growth.end:
            self._grow_and_prune(iteration, done)

    def _note(self, seen: Seen, iteration: int) -> None:
        owners, slots = seen.drawn.owners, seen.drawn.slots
        assert owners is not None and slots is not None
        visible = slots[seen.visible]
        self.pull[visible] += seen.pull[seen.visible] * (0.5 * max(seen.camera.width, seen.camera.height))
        self.shown[visible] += 1.0
        with torch.no_grad():
            opacities = seen.drawn.gaussians.opacities.detach() / self.slots
        self.opacity += seen.drawn.by_row(opacities, len(self.opacity))
        near = torch.unique(owners)
        self.visits[near] += 1.0
        self.last_shown[torch.unique(owners[seen.visible])] = iteration

    def _grow_and_prune(self, iteration: int, done: float) -> None:
        fitting, growth = self.fitting, self.settings.growth
        budget = self.settings.most(fitting.settings.budget)
        wanted = fitting.wanted(self.first_count, budget, growth.begin, growth.end, done)
        free, scaffold = self._free(), self.scene()
        may_ask = (self.shown >= growth.visits) & free.repeat_interleave(self.slots)
        grown = asked_for(scaffold, self.pull / self.shown.clamp_min(1.0), may_ask, growth, fitting.generator)
        faint = (self.visits >= growth.visits) & (self.opacity < growth.faint * self.visits)
        unseen = iteration - self.last_shown >= 2 * fitting.images
        gone = free & (faint | unseen)
        gone[: self.fixed] = False
        if gone.all():  # something must be left to learn
            gone[0] = False
        added = max(0, min(len(grown.means), wanted - int((~gone).sum())))
        chosen = type(grown)(*(each[:added] for each in grown))
        anchors = new_anchors(scaffold, chosen, fitting.generator)
        parts = self.optimiser.parts[chosen.owners]
        self.optimiser.append(anchors, parts)
        self.optimiser.keep(torch.nn.functional.pad(~gone, (0, added), value=True))
        last = torch.nn.functional.pad(self.last_shown, (0, added), value=iteration)
        self.last_shown = last[torch.nn.functional.pad(~gone, (0, added), value=True)]
        self._begin_round()

    _PLAIN = ("pull", "shown", "opacity", "visits", "last_shown")

    def state_dict(self) -> dict[str, Any]:
        """See `Learner.state_dict`."""
        noted = {name: getattr(self, name) for name in self._PLAIN}
        return {"optimiser": self.optimiser.state_dict(), **noted}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from `state_dict`."""
        self.optimiser.load_state_dict(state["optimiser"])
        for name in self._PLAIN:
            setattr(self, name, state[name])
