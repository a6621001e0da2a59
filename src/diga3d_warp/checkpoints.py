"""Weights that a user brings: found in a folder or in the Hugging Face cache, read only as safetensors.

Nothing is downloaded here: what is missing is named in one line, with its size and the command for it.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from diga3d_warp.errors import InputError

PICKLES = ("*.bin", "*.ckpt", "*.pt", "*.pth", "*.pkl")
"""Forms of weights that run code when they are read."""

TOKENIZERS = ("tokenizer.json", "vocab.json", "vocab.txt")
"""Files that hold the words of a tokenizer. Without any, transformers makes one that knows no word."""


@dataclass(frozen=True)
class Checkpoint:
    """A published model.

    Attributes:
        repository: Owner and name on huggingface.co.
        size: Of the files that are read [GB], from the number of parameters and their precision.
        include: Patterns of those files; repositories hold the same weights in several forms.
    """

    repository: str
    size: float
    include: tuple[str, ...] = ("*.json", "*.txt", "model.safetensors")

    @property
    def command(self) -> str:
        """Command that downloads it."""
        patterns = " ".join(f"--include '{pattern}'" for pattern in self.include)
        return f"hf download {self.repository} {patterns}"


def best_device(name: str) -> str:
    """The device that "auto" stands for: a GPU where there is one; other names are themselves."""
    import torch

    return ("cuda" if torch.cuda.is_available() else "cpu") if name == "auto" else name


def require_diffusion() -> None:
    """Check that the libraries of the diffusion priors are there.

    Raises:
        InputError: they are not installed.
    """
    missing = [name for name in ("diffusers", "transformers", "safetensors") if find_spec(name) is None]
    if missing:
        raise InputError(f"{' and '.join(missing)} not installed: pip install 'diga3d-warp[diffusion]'")


def _quiet() -> None:
    """No progress bars and no advice from the libraries: what matters, we say ourselves."""
    import diffusers.utils.logging
    import transformers.utils.logging

    for logging in (diffusers.utils.logging, transformers.utils.logging):
        logging.set_verbosity_error()
        logging.disable_progress_bar()


def locate(checkpoint: Checkpoint, folder: str | Path | None = None) -> Path:
    """Folder of a model: the given one, or the one in the Hugging Face cache.

    Raises:
        InputError: the folder does not exist, or nothing was downloaded.
    """
    if folder is not None:
        path = Path(folder).expanduser()
        if not path.is_dir():
            raise InputError(
                f"{path} is not a folder: give one in diffusers format, or: {checkpoint.command}"
            )
        return path
    if find_spec("huggingface_hub") is None:
        raise InputError("huggingface_hub is not installed, which finds weights: pip install huggingface_hub")
    from huggingface_hub import snapshot_download
    from huggingface_hub.errors import LocalEntryNotFoundError

    try:
        return Path(snapshot_download(checkpoint.repository, local_files_only=True))
    except LocalEntryNotFoundError as error:
        raise InputError(
            f"the weights of {checkpoint.repository} ({checkpoint.size:.1f} GB) are not on this machine: "
            f"run {checkpoint.command}, or give a folder that holds them"
        ) from error


def read_json(file: Path) -> dict[str, Any]:
    """A configuration of diffusers or transformers.

    Raises:
        InputError: it is missing or broken.
    """
    try:
        return json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{file} cannot be read: give a complete folder in diffusers format") from error


def read_config(folder: Path) -> dict[str, Any]:
    """The configuration of a model from its folder.

    Raises:
        InputError: it is missing or broken.
    """
    if not (folder / "config.json").is_file():
        raise InputError(f"{folder} lacks config.json: give a complete model folder in diffusers format")
    return read_json(folder / "config.json")


def check_model(folder: Path) -> None:
    """Refuse a folder whose configuration or weights are missing, pickles or cut short, without loading them.

    Raises:
        InputError: one of these; the line says what mends it.
    """
    from safetensors import SafetensorError, safe_open

    read_config(folder)
    half = _variant(folder) == "fp16"
    for file in sorted(folder.glob("*.safetensors")):
        if (".fp16" in file.name) != half:
            continue
        try:
            with safe_open(file, framework="pt"):
                pass
        except (OSError, SafetensorError) as error:
            raise InputError(f"{file} cannot be read ({error}): download it again") from error


def load_model(model_class: Any, folder: Path) -> Any:
    """A model of diffusers or transformers from its folder, frozen, in float32 on the CPU.

    Args:
        model_class: Class with `from_pretrained`.
        folder: Holds config.json and the weights.

    Raises:
        InputError: the folder or its weights are missing, are pickles, do not fit, hold numbers that are not
            finite, or lack parameters: those would be filled with random numbers.
    """
    from safetensors import SafetensorError

    _quiet()
    read_config(folder)
    try:
        model, info = model_class.from_pretrained(
            folder,
            local_files_only=True,
            use_safetensors=True,
            variant=_variant(folder),
            output_loading_info=True,
        )
    except (OSError, ValueError, RuntimeError, KeyError, TypeError, SafetensorError) as error:
        reason = str(error).strip().split("\n")[0]
        raise InputError(f"{folder} cannot be read ({reason}): download it again") from error
    missing = sorted(info["missing_keys"])
    if missing:
        raise InputError(f"{folder} lacks {len(missing)} parameters ({missing[0]}, ...): download it again")
    wrong = next((name for name, weights in model.state_dict().items() if not weights.isfinite().all()), None)
    if wrong is not None:
        raise InputError(f"{folder} holds numbers that are not finite ({wrong}): download it again")
    return model.float().eval().requires_grad_(False)


def load_tokenizer(tokenizer_class: Any, folder: Path) -> Any:
    """A tokenizer of transformers from its folder.

    Args:
        tokenizer_class: Class with `from_pretrained`.
        folder: Holds its words.

    Raises:
        InputError: its words are missing or broken.
    """
    if not any((folder / name).is_file() for name in TOKENIZERS):
        raise InputError(f"{folder} holds no tokenizer ({TOKENIZERS[0]}): download it again")
    _quiet()
    try:
        return tokenizer_class.from_pretrained(folder, local_files_only=True)
    except Exception as error:  # the library of tokenizers raises nothing narrower
        raise InputError(f"the tokenizer in {folder} cannot be read: download it again") from error


def _variant(folder: Path) -> str | None:
    """Which safetensors file to read: full precision if there, else "fp16".

    Raises:
        InputError: there is no safetensors file.
    """
    names = [path.name for path in folder.glob("*.safetensors")]
    if any(".fp16" not in name for name in names):
        return None
    if names:
        return "fp16"
    pickles = sorted(path.name for pattern in PICKLES for path in folder.glob(pattern))
    if pickles:
        raise InputError(
            f"{folder / pickles[0]} is a pickle, which can run code when it is read: "
            "give .safetensors files (save_pretrained writes them)"
        )
    raise InputError(f"{folder} holds no .safetensors file: download it again")
