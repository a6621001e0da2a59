"""The method: choice of references, propagation to the other views, score distillation."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Literal

from diga3d_warp.errors import InputError
from diga3d_warp.priors.attention import AFP_WEIGHT
from diga3d_warp.priors.conditioning import ControlScales
from diga3d_warp.priors.distillation import DistillationSettings
from diga3d_warp.priors.protocol import DiffusionPrior, Prior
from diga3d_warp.priors.settings import SamplingSettings

Propagation = Literal["attention", "warp", "none"]
Inversion = Literal["none", "photograph", "fill"]


@dataclass(frozen=True)
class Method:
    """Options of the method, which the ablation varies.

    Attributes:
        references: Number K of references. Paper: 3.
        selection: "kmeans", or "random" to compare.
        propagation: How the other views are made consistent with the references: "attention" (AFP, paper
            Sec. 3.3), "warp" (the references' fill warped by its depth), or "none": each view, references
            too, is filled on its own.
        afp_weight: lambda_a of "attention" (Eq. 4) [1].
        afp_joined: One softmax over all references in place of the mean of K (Eq. 4), of networks only.
        resampled: References keep one sampling trajectory, see `SamplingSettings`.
        sampling: Sampling of the other views with "attention" and "none"; None for the prior's default. Below
            full strength, "attention" starts from the warped fill.
        inversion: What sampling starts from: noise, the DDIM inversion of the photographs with their object
            (paper Sec. 3.3), or that of the references' fill warped to the view. None is the photographs in
            edits by free text, which keep shape and light, and noise in removals. An edit has no fill.
        distillation: TG-SDS (paper Sec. 3.4); None leaves the fine stage out.
        scales: Weights of the controls that edits by free text and TG-SDS follow.
        surfaces: Whether surfaces behind the object are filled in their own coordinates, before the
            references are.
    """

    references: int = 3
    selection: Literal["kmeans", "random"] = "kmeans"
    propagation: Propagation = "attention"
    afp_weight: float = AFP_WEIGHT
    afp_joined: bool = False
    resampled: bool = False
    sampling: SamplingSettings | None = None
    inversion: Inversion | None = None
    distillation: DistillationSettings | None = field(default_factory=DistillationSettings)
    scales: ControlScales = field(default_factory=ControlScales)
    surfaces: bool = True

    def sampling_for(self, prior: DiffusionPrior) -> SamplingSettings:
        """Sampling settings to use with a prior."""
        sampling = self.sampling or prior.sampling
        if self.propagation == "none":
            return replace(sampling, strength=1.0, afp_weight=0.0)
        return replace(
            sampling,
            afp_weight=self.afp_weight,
            afp_joined=self.afp_joined,
            resampled=self.resampled,
        )

    def summary(self) -> dict[str, Any]:
        """The method as JSON data for the manifest of a run."""
        return {
            "references": self.references,
            "selection": self.selection,
            "propagation": self.propagation,
            "inversion": self.inversion,
            "tg_sds": self.distillation is not None,
            "surfaces": self.surfaces,
        }


PAPER = Method()
"""As the paper describes it."""

WARPED = replace(PAPER, propagation="warp", distillation=None)
"""The references' fill warped by its depth, without diffusion in the other views."""


def usual_method(prior: Prior) -> Method:
    """Default method of a prior: the paper's for a trained network, warping by depth for others.

    Patches can be attended to and distilled, too, but a mean over the patches of several views is smoother
    than each: lawns lose their blades. `diga3d bench ablation` measures it.
    """
    return PAPER if isinstance(prior, DiffusionPrior) and prior.learned else WARPED


def check_method(method: Method, prior: Prior) -> None:
    """Refuse a method that a prior does not support.

    Raises:
        InputError: attention or score distillation with a prior that has neither.
    """
    if (method.propagation != "warp" or method.distillation) and not isinstance(prior, DiffusionPrior):
        raise InputError(
            f"prior {prior.name} estimates no noise: give it --propagation warp --no-tg-sds, or another prior"
        )
    if (
        method.inversion == "photograph"
        and isinstance(prior, DiffusionPrior)
        and prior.sampling.strength < 1.0
    ):
        raise InputError(
            f"prior {prior.name} only redraws details of what it starts from, which would be the object: "
            "give it --inversion fill or none"
        )
