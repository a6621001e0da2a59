"""Edits by free text: prior, prompts and method, and checks of the options."""

from __future__ import annotations

from dataclasses import dataclass, replace

from diga3d_warp.errors import InputError
from diga3d_warp.pipelines.choices import OF_METHODS, OF_NETWORKS, Choices
from diga3d_warp.pipelines.method import PAPER, Method
from diga3d_warp.priors.conditioning import Guidance
from diga3d_warp.priors.named import reads_prompts
from diga3d_warp.priors.protocol import DiffusionPrior, Prior, Task
from diga3d_warp.priors.settings import SamplingSettings


@dataclass(frozen=True, eq=False)
class FreeText:
    """An edit by free text: the prior, its prompts, and the method.

    Attributes:
        prior: The diffusion prior.
        guidance: Positive and negative prompt, and guidance scale.
        method: Propagation between views, and whether score distillation refines the edit.
    """

    prior: DiffusionPrior
    guidance: Guidance
    method: Method

    @staticmethod
    def of(prior: Prior, prompt: str, negative: str, task: Task, method: Method | None = None) -> FreeText:
        """Encode the prompts of an edit.

        Args:
            prior: The diffusion prior.
            prompt, negative: Tp and Tn, any text.
            task: Task of the prompts.
            method: The paper's if None.

        Raises:
            InputError: the prior does not understand a prompt, or the method propagates by warping.
        """
        if not isinstance(prior, DiffusionPrior):
            raise InputError(f"prior {prior.name} reads no prompts: use sd-inpainting or powerpaint")
        method = method or PAPER
        if method.propagation == "warp":
            raise InputError(
                "an edit by free text cannot be warped by depth, which it may change: "
                "use --propagation attention or none"
            )
        return FreeText(
            prior, replace(prior.guidance, prompts=prior.encode_prompts(prompt, negative, task)), method
        )

    @property
    def inverted(self) -> bool:
        """Whether sampling starts from the inverted views."""
        return self.method.inversion != "none"

    @property
    def sampling(self) -> SamplingSettings:
        """Settings of sampling the views."""
        return self.method.sampling_for(self.prior)


def reads_free_text(choices: Choices) -> bool:
    """Whether the chosen prior understands any prompt, not only the built-in words."""
    return reads_prompts(choices.prior_name)


def check_built_in(choices: Choices) -> None:
    """Refuse options that an edit by built-in materials would ignore.

    Raises:
        InputError: one of them was made.
    """
    choices.refuse_options(
        OF_NETWORKS + OF_METHODS,
        "the built-in materials are painted without it; leave it out, or give --prior sd-inpainting, "
        "powerpaint or a folder",
    )
