"""Formats that GaussForge converts: .spz and .sog to a standard .ply, and that to .splat.

It runs in a process of its own with a bound on memory and time: its readers of some formats crash on damaged
files.
"""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from diga3d_warp.errors import InputError
from diga3d_warp.scene.formats import gaussforge_child

INSTALL = "pip install 'diga3d-warp[formats]'"


@dataclass(frozen=True)
class ChildLimits:
    """Bounds of the process that converts.

    Attributes:
        memory: Address space beside that of the gaussians [bytes]. Python and the library take 0.2 GB.
        per_gaussian: Address space for each gaussian [bytes]: the file, unpacked parameters in float32, the
            .ply and copies of each while vectors grow.
        seconds: Time beside that of the gaussians [s].
        seconds_per_gaussian: Time for each [s]. It takes some microseconds.
    """

    memory: int = 1 << 30
    per_gaussian: int = 2500
    seconds: float = 60.0
    seconds_per_gaussian: float = 1e-3


LIMITS = ChildLimits()


def require(package: str, path: Path) -> None:
    """Refuse a file whose format needs a package that is not installed.

    Raises:
        InputError: it is not.
    """
    if find_spec(package) is None:
        raise InputError(f"{path}: files of this format need the package {package}: {INSTALL}")


def convert(data: bytes, source: str, target: str, path: Path, count: int) -> bytes:
    """Convert a file with GaussForge.

    Args:
        data: Contents of the file.
        source: Its format, in GaussForge's words: "ply", "spz" or "sog".
        target: The format to make: "ply" or "splat".
        path: For error lines.
        count: Gaussians that the file announces.

    Raises:
        InputError: GaussForge is missing, or cannot convert the file.
    """
    require("gaussforge", path)
    memory = LIMITS.memory + LIMITS.per_gaussian * count + 2 * len(data)
    command = [sys.executable, gaussforge_child.__file__, source, target, str(memory)]
    seconds = LIMITS.seconds + LIMITS.seconds_per_gaussian * count
    try:
        done = subprocess.run(command, input=data, capture_output=True, timeout=seconds, check=False)
    except subprocess.TimeoutExpired:
        raise InputError(f"{path}: cannot be converted within {seconds:.0f} s; export it again") from None
    if done.returncode == 0 and done.stdout:
        return done.stdout
    reason = ""
    if done.returncode == gaussforge_child.REFUSED:
        reason = f" ({done.stderr.decode('utf-8', 'replace').strip().splitlines()[-1]})"
    raise InputError(f"{path}: cut short or damaged{reason}; export it again")
