"""What a user chooses of prior and method; what is left open suits the prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from diga3d_warp.errors import InputError
from diga3d_warp.pipelines.method import Inversion, Method, Propagation, check_method, usual_method
from diga3d_warp.priors.conditioning import ControlKind
from diga3d_warp.priors.distillation import DistillationSettings
from diga3d_warp.priors.named import load_prior, reads_prompts
from diga3d_warp.priors.protocol import DiffusionPrior, Prior, Task
from diga3d_warp.priors.settings import SamplingSettings

OF_NETWORKS = ("steps", "guidance", "image_encoder", "ip_adapter")
"""Options that only a network of the Stable Diffusion family reads."""

OF_METHODS = (
    "negative", "propagation", "afp_weight", "inversion", "tg_sds", "sds_weight", "edges_scale",
    "depth_scale",
)  # fmt: skip
"""Options of propagation and score distillation."""


@dataclass(frozen=True, kw_only=True)
class Choices:
    """Options of prior and method; None stands for the default of the prior.

    Attributes:
        prior: A name or folder as `priors.named.load_prior` takes it, or a prior.
        negative: Tn, the negative prompt.
        references, selection: As in `Method`.
        propagation, inversion: As in `Method`.
        tg_sds: Whether score distillation refines the edit.
        surfaces: As in `Method`.
        steps: DDIM steps of a network, as in `SamplingSettings`.
        guidance: Guidance scale of a network [1].
        afp_weight: lambda_a of "attention", as in `Method`.
        sds_weight: lambda of score distillation, as in `DistillationSettings`.
        edges_scale, depth_scale: Weights of the controls, as in `ControlScales`.
        image_encoder: Folder of CLIP's vision model, which tells a network what inpainted references show.
        ip_adapter: Weights file of an IP-Adapter, through which it does.
    """

    prior: str | Prior = "exemplar"
    negative: str = ""
    references: int = Method.references
    selection: Literal["kmeans", "random"] = Method.selection
    propagation: Propagation | None = None
    tg_sds: bool | None = None
    surfaces: bool = Method.surfaces
    steps: int | None = None
    guidance: float | None = None
    afp_weight: float | None = None
    inversion: Inversion | None = None
    sds_weight: float | None = None
    edges_scale: float | None = None
    depth_scale: float | None = None
    image_encoder: str | Path | None = None
    ip_adapter: str | Path | None = None

    @property
    def prior_name(self) -> str:
        """Name or folder of the prior."""
        return self.prior if isinstance(self.prior, str) else self.prior.name

    def refuse_options(self, names: Sequence[str], reason: str) -> None:
        """Refuse options that would be ignored.

        Args:
            names: Attributes.
            reason: Why nothing would read them, and what to do.

        Raises:
            InputError: one of them is set.
        """
        made = [f"--{name.replace('_', '-')}" for name in names if _made(getattr(self, name))]
        if made:
            raise InputError(f"{' and '.join(made)}: {reason}")

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
            InputError: see `priors.named.load_prior`; or options that the prior would ignore.
        """
        if not isinstance(self.prior, str):
            self.refuse_options(OF_NETWORKS, "a prior that is given has its own")
            return self.prior
        network: dict[str, Any] = {}
        if reads_prompts(self.prior):
            network = {"image_encoder": self.image_encoder, "ip_adapter": self.ip_adapter}
            network |= {"sampling": SamplingSettings(steps=self.steps)} if self.steps else {}
            network |= {} if self.guidance is None else {"scale": self.guidance}
        else:
            self.refuse_options(OF_NETWORKS, f"prior {self.prior} is no network that reads it: leave it out")
        wanted: tuple[ControlKind, ...] = () if self.tg_sds is False else ("edges", "depth")
        return load_prior(
            self.prior,
            task=task,
            positive=positive,
            negative=self.negative if negative is None else negative,
            controls=wanted if controls is None else controls,
            **network,
        )

    def choose_method(self, prior: Prior, *, controlled: bool = False) -> Method:
        """The default method of a prior, with the user's options applied.

        Args:
            prior: From `load_prior`.
            controlled: Whether the task follows edges and depth without score distillation, too.

        Raises:
            InputError: the prior cannot do what was chosen, or an option would be ignored.
        """
        method = replace(
            usual_method(prior),
            references=self.references,
            selection=self.selection,
            surfaces=self.surfaces,
            inversion=self.inversion,
        )
        if self.propagation is not None:
            method = replace(method, propagation=self.propagation)
        if self.tg_sds is not None:
            method = replace(method, distillation=DistillationSettings() if self.tg_sds else None)
        check_method(method, prior)
        self._check_read(method, prior, controlled)
        if self.afp_weight is not None:
            method = replace(method, afp_weight=self.afp_weight)
        if self.sds_weight is not None and method.distillation:
            method = replace(method, distillation=replace(method.distillation, weight=self.sds_weight))
        chosen = {"edges": self.edges_scale, "depth": self.depth_scale}
        scales = {kind: scale for kind, scale in chosen.items() if scale is not None}
        return replace(method, scales=replace(method.scales, **scales))

    def _check_read(self, method: Method, prior: Prior, controlled: bool) -> None:
        """Refuse what the method would ignore: without noise estimates, `fill` reads no prompt."""
        if method.propagation != "attention":
            self.refuse_options(["afp_weight"], "only --propagation attention reads it")
        if method.propagation == "warp":
            self.refuse_options(
                ["inversion"], "--propagation warp samples no view: add --propagation attention"
            )
        if method.distillation is None:
            self.refuse_options(["sds_weight"], "without score distillation nothing reads it: add --tg-sds")
            if not controlled:
                self.refuse_options(
                    ["edges_scale", "depth_scale"],
                    "without score distillation this edit follows no controls: add --tg-sds",
                )
        if not self.negative or (isinstance(prior, DiffusionPrior) and prior.learned):
            return
        if not isinstance(prior, DiffusionPrior):
            raise InputError(f"prior {prior.name} reads no prompts: leave --negative out")
        if method.propagation == "warp" and method.distillation is None:
            raise InputError(
                f"--negative is heeded where prior {prior.name} estimates noise: "
                "add --propagation attention or --tg-sds, or leave it out"
            )


def _made(value: object) -> bool:
    """Whether an option was chosen: 0 is a choice, an empty prompt and `--no-tg-sds` are none."""
    return value is not None and value is not False and value != ""
