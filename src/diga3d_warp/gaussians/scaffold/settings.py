"""Settings of anchors: their number, their networks, growth, and learning rates."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class AnchorRates:
    """Adam's learning rates; the first number is that of the first iteration, and falls to the second.

    Those of anchors are twice those of Scaffold-GS (Lu et al. 2024, their code's defaults), which are made
    for 30,000 iterations: a fit on a CPU takes a tenth. Networks learn from all anchors at once, and twice
    their rates gave less. Anchors stay on their grid: the rate of `means` is 0, as in the paper.

    Attributes:
        offsets: In spans of the anchor. Scaffold-GS: 0.01 to 1e-4.
        features: In numbers whose standard deviation is `encode.DEVIATION`. Scaffold-GS: 0.0075.
        log_spans, log_sizes: In logarithms. Scaffold-GS: 0.007.
        opacity, color, shape: Of the weights of each network, as in Scaffold-GS.
    """

    offsets: tuple[float, float] = (0.02, 2e-4)
    features: tuple[float, float] = (0.015, 0.003)
    log_spans: tuple[float, float] = (0.014, 0.002)
    log_sizes: tuple[float, float] = (0.014, 0.002)
    opacity: tuple[float, float] = (0.002, 2e-5)
    color: tuple[float, float] = (0.008, 5e-5)
    shape: tuple[float, float] = (0.004, 0.004)

    def of(self, name: str, done: float) -> float:
        """Rate of a parameter of `Scaffold.named` after a part of the iterations in [0, 1]; 0 of others."""
        group = name.removeprefix("decoder.").split(".")[0]
        if group in ("means", "tints"):
            return 0.0
        first, last = getattr(self, group)
        return first * (last / first) ** done


@dataclass(frozen=True)
class GrowthSettings:
    """When anchors are added and taken out (Lu et al. 2024, Sec. 3.3).

    Attributes:
        interval: Iterations between two rounds. Paper: 100, in fits ten times as long.
        begin, end: Parts of the iterations between which there are rounds. Paper: 1/20 and 1/2.
        levels: Voxels that anchors grow in, coarse to fine [sizes of the first voxels]. Paper: factors of 4.
        pull: Mean gradient of the loss by a gaussian's projected centre from which it deserves another anchor
            in the coarsest voxels; twice as much in each finer level [1 / half images]. Paper: 2e-4.
        chance: Part of the gaussians that may ask for one in a round, halved by each finer level. Paper: 1/2.
        faint: Mean opacity of an anchor's gaussians under which it goes. Paper: 0.005.
        visits: Images since the last round that must have shown an anchor before it may ask or go. Paper:
            0.4 and 0.8 of the iterations of a round.
    """

    interval: int = 50
    begin: float = 0.05
    end: float = 0.6
    levels: tuple[float, ...] = (4.0, 1.0, 0.25)
    pull: float = 2e-4
    chance: float = 0.5
    faint: float = 0.005
    visits: int = 5


@dataclass(frozen=True)
class ScaffoldSettings:
    """Anchors of a fit.

    Attributes:
        slots: Gaussians k of an anchor. Paper: 10.
        width: Numbers F of a feature. Paper: 32.
        drawn: Gaussians that an anchor has on average once those of no opacity are not drawn [1]: the budget
            of gaussians divided by this is that of anchors.
        first: Part of that budget that the first anchors may take; their voxels are enlarged until they do.
        rates: Learning rates.
        growth: Growing and pruning.
    """

    slots: int = 10
    width: int = 32
    drawn: float = 4.0
    first: float = 0.5
    rates: AnchorRates = field(default_factory=AnchorRates)
    growth: GrowthSettings = field(default_factory=GrowthSettings)

    def most(self, budget: int) -> int:
        """Anchors that a budget of gaussians stands for."""
        return round(budget / self.drawn)


SCAFFOLD = ScaffoldSettings()
