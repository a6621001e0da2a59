"""The machine a run ran on: versions, processor, memory, and the largest memory in use."""

from __future__ import annotations

import os
import platform
import re
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

PACKAGES = {
    "diga3d_warp": "diga3d-warp",
    "warp": "warp-lang",
    "torch": "torch",
    "numpy": "numpy",
    "opencv": "opencv-contrib-python-headless",
    "pycolmap": "pycolmap",
    "kornia": "kornia",
}
"""Packages whose version can change a result: the name in the manifest and the one on PyPI."""

MIB = 1024 * 1024


def package_versions() -> dict[str, str]:
    """Version of Python and of each package that can change a result; "missing" if it is not installed."""
    versions = {"python": platform.python_version()}
    for name, distribution in PACKAGES.items():
        try:
            versions[name] = version(distribution)
        except PackageNotFoundError:
            versions[name] = "missing"
    return versions


def describe_machine() -> dict[str, Any]:
    """Processor, cores this process may use, memory [MiB] and system."""
    return {
        "processor": _processor(),
        "cores": core_count(),
        "memory_mib": os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // MIB,
        "system": platform.platform(),
    }


def available_mib() -> int:
    """Memory that programs can still take [MiB]; all of it where the system does not say (not Linux)."""
    try:
        found = re.search(r"MemAvailable:\s+(\d+) kB", Path("/proc/meminfo").read_text())
    except OSError:
        found = None
    return int(found[1]) // 1024 if found else describe_machine()["memory_mib"]


def core_count() -> int:
    """Number of cores this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def reset_peak() -> None:
    """Let `peak_mib` count from now on, where the system can (Linux); elsewhere it counts from the start."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return


def peak_mib() -> int:
    """Largest resident memory of this process since `reset_peak` [MiB]."""
    try:
        status = Path("/proc/self/status").read_text()
    except OSError:
        import resource

        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak // (MIB if sys.platform == "darwin" else 1024)
    found = re.search(r"VmHWM:\s+(\d+) kB", status)
    assert found, "Linux reports VmHWM"
    return int(found[1]) // 1024


def _processor() -> str:
    try:
        found = re.search(r"model name\s*:\s*(.+)", Path("/proc/cpuinfo").read_text())
    except OSError:
        found = None
    return found[1] if found else platform.processor() or platform.machine()
