"""Weights files of the metrics' networks: where each is looked for, and what to say of one that is missing.

Nothing is downloaded. A file is looked for in the folder of `diga3d eval --weights`, then where the programs
that published it leave it: torch.hub's cache. Only tensors are read (`weights_only`): these files are
pickles, which could otherwise run code.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from diga3d_warp.errors import InputError

if TYPE_CHECKING:
    import torch

INSTALL = "pip install 'diga3d-warp[metrics]'"


@dataclass(frozen=True)
class WeightsFile:
    """A published file of weights.

    Attributes:
        name: Name of the file.
        url: Address of the file or, without the name, of the folder that it lies in.
        size: Its size [MB].
        cache: Folder of torch.hub's cache in which the publisher's own program leaves it.
    """

    name: str
    url: str
    size: int
    cache: str = "checkpoints"

    @property
    def home(self) -> Path:
        """Path of the file in torch.hub's cache, as torch.hub finds it itself."""
        cache = Path(os.environ.get("XDG_CACHE_HOME", "~/.cache"), "torch")
        return Path(os.environ.get("TORCH_HOME", cache)).expanduser() / "hub" / self.cache / self.name

    @property
    def command(self) -> str:
        """Command that downloads it to `home`."""
        address = self.url + self.name if self.url.endswith("/") else self.url
        return f"curl -L --create-dirs -o {self.home} {address}"

    def find(self, folder: Path | None = None) -> Path:
        """The file in a folder or, failing that, in torch.hub's cache.

        Raises:
            InputError: it is in neither; the line names the file, its size and the command for it.
        """
        for path in ([] if folder is None else [folder / self.name]) + [self.home]:
            if path.is_file():
                return path
        raise InputError(f"{self.name} ({self.size} MB) is not on this machine: {self.command}")


def require(*libraries: str) -> None:
    """Check that libraries of the extra [metrics] are installed.

    Raises:
        InputError: one is not.
    """
    missing = [name for name in libraries if find_spec(name) is None]
    if missing:
        raise InputError(f"{' and '.join(missing)} not installed: {INSTALL}")


def read_tensors(path: Path, part: str | None = None) -> Mapping[str, Any]:
    """A state dictionary, its tensors mapped from the file on the CPU.

    Args:
        path: File of torch.save.
        part: Key under which the file holds the dictionary; it may also hold the dictionary alone.

    Raises:
        InputError: the file cannot be read, or holds other things than tensors.
    """
    import torch

    try:
        with path.open("rb") as file:
            mapped = file.read(2) == b"PK"  # an older form of file than zip cannot be mapped
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            state = torch.load(path, map_location="cpu", weights_only=True, mmap=mapped)
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror or error})") from error
    except Exception as error:  # of a damaged file torch's reader raises anything
        raise InputError(f"{path} cannot be read: it is damaged, or holds more than tensors") from error
    if isinstance(state, dict) and isinstance(state.get(part), dict):
        state = state[part]
    if not isinstance(state, dict):
        raise InputError(f"{path} holds no state dictionary: download it again")
    return state


def fill(network: torch.nn.Module, state: Mapping[str, Any], path: Path) -> None:
    """Put a state dictionary into a network, which may lie on the device "meta", and freeze it.

    Args:
        network: Receives the weights, in float32.
        state: Tensors by name; those that the network does not have are left out.
        path: File that they are from, for messages.

    Raises:
        InputError: a tensor is missing, has the wrong shape, or holds numbers that are not finite.
    """
    import torch

    wanted = network.state_dict()
    chosen = {}
    for name, own in wanted.items():
        given = state.get(name)
        if not isinstance(given, torch.Tensor):
            raise InputError(f"{path} lacks {name}: it is another network's, download it again")
        if given.shape != own.shape:
            shapes = f"{tuple(given.shape)}, not {tuple(own.shape)}"
            raise InputError(f"{path} has {name} of shape {shapes}: it is another network's")
        if not given.isfinite().all():
            raise InputError(f"{path} holds numbers that are not finite ({name}): download it again")
        chosen[name] = given.float() if given.is_floating_point() else given
    network.load_state_dict(chosen, assign=True)
    network.eval().requires_grad_(False)
