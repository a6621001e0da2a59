"""The variants of the method that are compared, as the paper's ablation does and a little further."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from hashlib import blake2b

from diga3d_warp.pipelines.method import PAPER, WARPED, Method
from diga3d_warp.priors.attention import AFP_WEIGHT
from diga3d_warp.priors.distillation import DistillationSettings
from diga3d_warp.priors.named import reads_prompts

USUAL = replace(PAPER, surfaces=False)
"""The paper's method: charts of the surfaces behind the object would leave it little to fill."""

UNCHARTED = replace(WARPED, surfaces=False)


@dataclass(frozen=True)
class Trial:
    """A removal by one variant of the method.

    Attributes:
        method: The switches.
        prior: As `priors.named.load_prior` takes it.
    """

    method: Method = USUAL
    prior: str = "exemplar"

    @property
    def coarse(self) -> Trial:
        """The same without the fine stage: trials that agree in it share their stages up to the refit."""
        return replace(self, method=replace(self.method, distillation=None))

    @property
    def key(self) -> str:
        """A name for files, the same for equal trials."""
        return blake2b(repr(self).encode(), digest_size=6).hexdigest()


Groups = Mapping[str, Mapping[str, Trial]]
"""Trials by table and name. A trial that stands in several tables is run once a capture."""


def groups_of(prior: str) -> Groups:
    """The tables of a prior; that of a network asks what patches do not have.

    Args:
        prior: As `priors.named.load_prior` takes it.
    """
    full = Trial(prior=prior)

    def but(**changes: object) -> Trial:
        return replace(full, method=replace(full.method, **changes))  # type: ignore[arg-type]

    tables = {
        "Key components (paper, Table 3)": {
            "AFP and TG-SDS": full,
            "without TG-SDS": but(distillation=None),
            "without AFP": but(propagation="none"),
            "without both": but(propagation="none", distillation=None),
        },
        "How the fill reaches the other views": {
            "AFP, weight 0": but(afp_weight=0.0),
            f"AFP, weight {AFP_WEIGHT} (usual)": full,
            "AFP, weight 1": but(afp_weight=1.0),
            "warped by DIBR, TG-SDS": but(propagation="warp"),
            "warped by DIBR": Trial(UNCHARTED, prior),
        },
        "Weight of TG-SDS": {
            "weight 0: the fine stage without it": but(distillation=DistillationSettings(0.0)),
            f"weight {DistillationSettings.weight:g} (usual)": full,
            "weight 1e-03": but(distillation=DistillationSettings(1e-3)),
            "weight 1e-02": but(distillation=DistillationSettings(1e-2)),
        },
        "Number of references (paper, Table 4)": {
            "K = 1": but(references=1),
            "K = 2": but(references=2),
            "K = 3 (usual)": full,
        },
        "Choice of references (paper, appendix)": {
            "k-means (usual)": full,
            "random": but(selection="random"),
        },
    }
    if reads_prompts(prior):
        tables["Start of the sampling"] = {
            "noise (usual)": full,
            "inverted photographs": but(inversion="photograph"),
            "inverted fill": but(inversion="fill"),
            "inverted fill, references sampled once more": but(inversion="fill", resampled=True),
        }
        tables["Attention to the references"] = {
            "mean of K references (paper, usual)": full,
            "one softmax over all": but(afp_joined=True),
        }
    others = {
        f"{name}, warped by DIBR": Trial(UNCHARTED, name)
        for name in dict.fromkeys(["exemplar", "classical", prior])
    }
    tables["Prior (paper, appendix)"] = {
        "the paper's method": full,
        **others,
        "exemplar, warped by DIBR, with charts (default)": Trial(WARPED),
    }
    return tables
