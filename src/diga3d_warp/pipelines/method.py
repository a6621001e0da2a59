"""Options of the method: choice of references, propagation to the other views, score distillation."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Literal

from diga3d_warp.errors import InputError
from diga3d_warp.priors.attention import AFP_WEIGHT
from diga3d_warp.priors.conditioning import ControlKind
from diga3d_warp.priors.distillation import DistillationSettings
from diga3d_warp.priors.named import load_prior
from diga3d_warp.priors.protocol import DiffusionPrior, Prior, Task
from diga3d_warp.priors.settings import SamplingSettings

Propagation = Literal["attention", "warp", "none"]


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
        sampling: Sampling of the other views with "attention" and "none"; None for the prior's default. Below
            full strength, "attention" starts from the warped fill.
        distillation: TG-SDS (paper Sec. 3.4); None leaves the fine stage out.
        surfaces: Whether surfaces behind the object are filled in their own coordinates, before the
            references are.
    """

    references: int = 3
    selection: Literal["kmeans", "random"] = "kmeans"
    propagation: Propagation = "attention"
    afp_weight: float = AFP_WEIGHT
    sampling: SamplingSettings | None = None
    distillation: DistillationSettings | None = field(default_factory=DistillationSettings)
    surfaces: bool = True

    def sampling_for(self, prior: DiffusionPrior) -> SamplingSettings:
        """Sampling settings to use with a prior."""
        sampling = self.sampling or prior.sampling
        if self.propagation == "none":
            return replace(sampling, strength=1.0, afp_weight=0.0)
        return replace(sampling, afp_weight=self.afp_weight)

    def summary(self) -> dict[str, Any]:
        """The method as JSON data for the manifest of a run."""
        return {
            "references": self.references,
            "selection": self.selection,
            "propagation": self.propagation,
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


@dataclass(frozen=True, kw_only=True)
class Choices:
    """Options of prior and method; None stands for the default of the prior.

    Attributes:
        prior: A name or folder as `priors.named.load_prior` takes it, or a prior.
        negative: Tn, the negative prompt.
        references, selection: As in `Method`.
        propagation: As in `Method`.
        tg_sds: Whether score distillation refines the edit.
        surfaces: As in `Method`.
    """

    prior: str | Prior = "exemplar"
    negative: str = ""
    references: int = Method.references
    selection: Literal["kmeans", "random"] = Method.selection
    propagation: Propagation | None = None
    tg_sds: bool | None = None
    surfaces: bool = Method.surfaces

    @property
    def prior_name(self) -> str:
        """Name or folder of the prior."""
        return self.prior if isinstance(self.prior, str) else self.prior.name

    def load_prior(
        self,
        task: Task,
        positive: str = "",
        negative: str | None = None,
        controls: tuple[ControlKind, ...] | None = None,
    ) -> Prior:
        """The prior, with its prompts; one that was given has them already.

        Args:
            task, positive: Task of the prompts, and Tp.
            negative: Tn; the chosen one if None.
            controls: Kinds of control to load; if None, those that score distillation needs.

        Raises:
            InputError: see `priors.named.load_prior`.
        """
        if not isinstance(self.prior, str):
            return self.prior
        negative = self.negative if negative is None else negative
        wanted: tuple[ControlKind, ...] = () if self.tg_sds is False else ("edges", "depth")
        return load_prior(
            self.prior,
            task=task,
            positive=positive,
            negative=negative,
            controls=wanted if controls is None else controls,
        )

    def choose_method(self, prior: Prior) -> Method:
        """The default method of a prior, with the user's options applied.

        Raises:
            InputError: the prior cannot do what was chosen, or would read no negative prompt.
        """
        method = replace(
            usual_method(prior),
            references=self.references,
            selection=self.selection,
            surfaces=self.surfaces,
        )
        if self.propagation is not None:
            method = replace(method, propagation=self.propagation)
        if self.tg_sds is not None:
            method = replace(method, distillation=DistillationSettings() if self.tg_sds else None)
        check_method(method, prior)
        self._check_negative(method, prior)
        return method

    def _check_negative(self, method: Method, prior: Prior) -> None:
        """Refuse a negative prompt that would be ignored: without noise estimates, `fill` reads no prompt."""
        if not self.negative or (isinstance(prior, DiffusionPrior) and prior.learned):
            return
        if not isinstance(prior, DiffusionPrior):
            raise InputError(f"prior {prior.name} reads no prompts: leave --negative out")
        if method.propagation == "warp" and method.distillation is None:
            raise InputError(
                f"--negative is heeded where prior {prior.name} estimates noise: "
                "add --propagation attention or --tg-sds, or leave it out"
            )
