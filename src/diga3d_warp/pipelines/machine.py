"""The machine a run ran on: versions, processor, memory, and the largest memory in use."""

from __future__ import annotations

import hashlib
import os
import platform
import re
import sys
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import psutil

import diga3d_warp

PACKAGES = {
    "warp": "warp-lang",
    "torch": "torch",
    "numpy": "numpy",
    "opencv": "opencv-contrib-python-headless",
    "pycolmap": "pycolmap",
    "kornia": "kornia",
}
"""Packages whose version can change a result: the name in the manifest and the one on PyPI."""

MIB = 1024 * 1024

PROC = Path("/proc")
"""Linux's folder of process, memory and processor information; absent on other systems."""


def package_versions() -> dict[str, str]:
    """Version of Python, of this code, and of each package that can change a result.

    A package that is not installed is "missing". The version of this code ends with a digest of its files,
    which distinguishes development states of one version.
    """
    code = f"{_version('diga3d-warp')}+{_code_digest()}"
    installed = {name: _version(distribution) for name, distribution in PACKAGES.items()}
    return {"python": platform.python_version(), "diga3d_warp": code, **installed}


def describe_machine() -> dict[str, Any]:
    """Processor, cores this process may use, memory [MiB] and system."""
    return {
        "processor": _processor(),
        "cores": core_count(),
        "memory_mib": psutil.virtual_memory().total // MIB,
        "system": platform.platform(),
    }


def available_mib() -> int:
    """Memory that programs can still take without swapping [MiB]."""
    return psutil.virtual_memory().available // MIB


def core_count() -> int:
    """Number of cores this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def reset_peak() -> None:
    """Let `peak_mib` count from now on, where the system can (Linux); elsewhere it counts from the start."""
    try:
        (PROC / "self" / "clear_refs").write_text("5", encoding="ascii")
    except OSError:
        return


def peak_mib() -> int:
    """Largest resident memory of this process since `reset_peak` [MiB]."""
    try:
        status = (PROC / "self" / "status").read_text(encoding="utf-8", errors="replace")
    except OSError:
        status = ""
    found = re.search(r"VmHWM:\s+(\d+) kB", status)
    return int(found[1]) // 1024 if found else _peak_since_start()


def _peak_since_start() -> int:
    if sys.platform == "win32":
        return psutil.Process().memory_info().peak_wset // MIB
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak // (MIB if sys.platform == "darwin" else 1024)


def _version(distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return "missing"


@cache
def _code_digest() -> str:
    """Digest of the source files of this package."""
    root, digest = Path(diga3d_warp.__file__).parent, hashlib.blake2b(digest_size=4)
    for file in sorted(root.rglob("*.py")):
        digest.update(file.relative_to(root).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()


def _processor() -> str:
    try:
        found = re.search(r"model name\s*:\s*(.+)", (PROC / "cpuinfo").read_text(encoding="utf-8"))
    except OSError:
        found = None
    return found[1] if found else platform.processor() or platform.machine()
