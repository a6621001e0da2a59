"""Load a prior by its name on the command line, or from a file or folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from diga3d_warp.errors import InputError
from diga3d_warp.priors.classical import ClassicalPrior
from diga3d_warp.priors.conditioning import ControlKind
from diga3d_warp.priors.exemplar.prior import ExemplarPrior
from diga3d_warp.priors.lama import load_lama
from diga3d_warp.priors.protocol import Prior, Task

BUILT_IN = ("exemplar", "classical")
"""Priors that need no weights."""

ROOM = Path(__file__).parents[3] / "models" / "room"
"""The room prior, which `python -m training all ... models/room` trains on synthetic rooms."""

_OTHERS = "lama, sd-inpainting, powerpaint, room, an .onnx file of LaMa, or a folder in diffusers format"


def reads_prompts(name: str) -> bool:
    """Whether the prior of this name understands any prompt, not only the built-in words."""
    return name not in BUILT_IN and not _is_lama(name)


def _is_lama(name: str) -> bool:
    return name == "lama" or Path(name).suffix.lower() == ".onnx"


def load_prior(
    name: str,
    *,
    task: Task = "remove",
    positive: str = "",
    negative: str = "",
    controls: Sequence[ControlKind] = (),
    device: str = "auto",
    **network: Any,
) -> Prior:
    """Load a prior with its prompts.

    Args:
        name: "exemplar", "classical", "room", "lama", "sd-inpainting", "powerpaint", an .onnx file of LaMa,
            or a folder in diffusers format.
        task, positive, negative: What the prompts are for, Tp and Tn. "classical" and LaMa read none of them.
            "exemplar" reads the negative one only: it continues the surroundings.
        controls: Kinds of control that a Stable Diffusion prior loads a ControlNet for.
        device: "auto", "cpu" or "cuda". The built-in priors and LaMa compute on the CPU.
        network: Further arguments of `load_stable_diffusion`, which other priors have no use for.

    Raises:
        InputError: no such prior, missing weights, or prompts that it does not understand.
    """
    if not name.strip():
        raise InputError(f"the name of the prior is empty: give {', '.join(BUILT_IN)}, {_OTHERS}")
    if name == "classical":
        return ClassicalPrior()
    if name == "exemplar":
        return ExemplarPrior(negative=negative)
    if _is_lama(name):
        return load_lama(name)
    from diga3d_warp.priors.stable_diffusion.load import PRIORS, load_stable_diffusion

    if name == "room":
        if not ROOM.is_dir():
            raise InputError(
                f"the room prior is not in {ROOM}: train it in a checkout of the repository "
                "(docs/room_prior.md), or give the folder that its training exported"
            )
        name = str(ROOM)
    if name not in PRIORS and not Path(name).expanduser().exists():
        raise InputError(f"there is no prior or folder {name}: give {', '.join(BUILT_IN)}, {_OTHERS}")
    return load_stable_diffusion(
        name, controls=controls, device=device, positive=positive, negative=negative, task=task, **network
    )
