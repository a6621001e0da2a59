"""Which of several fills is taken."""

import pytest
import torch
from known_textures import TEXTURES, hole

from diga3d_warp.priors.exemplar import proposals
from diga3d_warp.priors.exemplar.cascade import State, scales_of
from diga3d_warp.priors.exemplar.posterior import attend_all
from diga3d_warp.priors.exemplar.settings import FILL
from diga3d_warp.priors.exemplar.source import Source


def source_of(name: str) -> tuple[Source, torch.Tensor]:
    """A texture with a hole as a source, and its true colours in [-1, 1]."""
    truth, mask = TEXTURES[name](), hole()
    controls = torch.zeros(*mask.shape, 0)
    return Source(torch.where(mask[..., None], 0.0, 2.0 * truth - 1.0), ~mask, controls), 2.0 * truth - 1.0


def judged(name: str, colors) -> float:
    """Energy of a fill at full size; `colors` makes it of the truth."""
    source, truth = source_of(name)
    scale = scales_of(source)[-1]
    image = scale.query.pasted(colors(truth))
    estimate = attend_all(scale.query, scale.source, image, FILL.noise_last)
    return proposals.energy(State(scale, type(estimate)(image, estimate.candidates, estimate.distances)))


@pytest.mark.parametrize("name", ["stripes", "bricks", "boundary"])
def test_energy_tells_a_right_fill_from_wrong_ones(name):
    right = judged(name, lambda truth: truth)
    grey = judged(name, lambda truth: truth.mean((0, 1)).expand_as(truth))
    moved = judged(name, lambda truth: truth.roll((5, 11), (0, 1)))
    upside_down = judged(name, lambda truth: truth.flip(0).roll(7, 1))
    assert right < 0.8 * min(grey, moved, upside_down)


def test_the_proposal_of_least_energy_is_taken(monkeypatch):
    source, _ = source_of("boundary")
    scales = scales_of(source)[:1]
    seen = {}
    plain = proposals.energy

    def noted(state, settings):
        seen[id(state)] = plain(state, settings), state
        return seen[id(state)][0]

    monkeypatch.setattr(proposals, "energy", noted)
    taken = proposals.best_proposal(scales, seed=5)
    energies = [value for value, _ in seen.values()]
    assert len(set(energies)) == FILL.seeds
    assert seen[id(taken)][0] == min(energies)
