"""The variants of the method that are compared, as the paper's ablation does and a little further."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from diga3d_warp.pipelines.method import PAPER, WARPED, Method
from diga3d_warp.priors.attention import AFP_WEIGHT
from diga3d_warp.priors.distillation import DistillationSettings


@dataclass(frozen=True)
class Trial:
    """A removal by one variant of the method.

    Attributes:
        method: The switches.
        prior: As `priors.named.load_prior` takes it.
    """

    method: Method = PAPER
    prior: str = "exemplar"

    @property
    def coarse(self) -> Trial:
        """The same without the fine stage: trials that agree in it share their stages up to the refit."""
        return replace(self, method=replace(self.method, distillation=None))


def _without(method: Method = PAPER, *, attention: bool = False, distillation: bool = False) -> Trial:
    if attention:
        method = replace(method, propagation="none")
    return Trial(replace(method, distillation=None) if distillation else method)


def _propagated(weight: float) -> Trial:
    return Trial(replace(PAPER, afp_weight=weight))


def _distilled(weight: float) -> Trial:
    return Trial(replace(PAPER, distillation=DistillationSettings(weight)))


FULL = Trial()

GROUPS: Mapping[str, Mapping[str, Trial]] = {
    "Key components (paper, Table 3)": {
        "AFP and TG-SDS": FULL,
        "without TG-SDS": _without(distillation=True),
        "without AFP": _without(attention=True),
        "without both": _without(attention=True, distillation=True),
    },
    "How the fill reaches the other views": {
        "AFP, weight 0": _propagated(0.0),
        f"AFP, weight {AFP_WEIGHT} (usual)": FULL,
        "AFP, weight 1": _propagated(1.0),
        "warped by DIBR, TG-SDS": Trial(replace(PAPER, propagation="warp")),
        "warped by DIBR": Trial(WARPED),
    },
    "Weight of TG-SDS": {
        "weight 0: the fine stage without it": _distilled(0.0),
        f"weight {DistillationSettings.weight:g} (usual)": FULL,
        "weight 1e-03": _distilled(1e-3),
        "weight 1e-02": _distilled(1e-2),
    },
    "Number of references (paper, Table 4)": {
        "K = 1": Trial(replace(PAPER, references=1)),
        "K = 2": Trial(replace(PAPER, references=2)),
        "K = 3 (usual)": FULL,
    },
    "Choice of references (paper, appendix)": {
        "k-means (usual)": FULL,
        "random": Trial(replace(PAPER, selection="random")),
    },
    "Prior (paper, appendix)": {
        "exemplar": FULL,
        "exemplar, warped by DIBR (its default)": Trial(WARPED),
        "classical, warped by DIBR": Trial(WARPED, prior="classical"),
        "sd-inpainting": Trial(prior="sd-inpainting"),
        "powerpaint": Trial(prior="powerpaint"),
    },
}
"""Trials by table and name. A trial that stands in several tables is run once a seed."""
