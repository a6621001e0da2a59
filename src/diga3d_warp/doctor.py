"""Doctor: is everything in place on this machine? A line for each check, and what to do about it."""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
import time
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Literal

from packaging.requirements import Requirement

from diga3d_warp.kernels.processor import TARGET_VARIABLE, simd_of_machine
from diga3d_warp.pipelines.machine import MIB, available_mib, core_count, describe_machine

State = Literal["ok", "warn", "fail"]


@dataclass(frozen=True)
class Needs:
    """Requirements of the machine.

    Attributes:
        memory_mib: Free memory [MiB]. Removal from 29 photographs of 504 x 378 stays below 4 GB.
        disk_mib: Free space where runs are written [MiB]. A run with its stages takes up to about 1 GB.
        core_gain: Least part of the ideal speed-up over all cores [ratio]. Arithmetic alone scales nearly
            ideally; less means that other programs hold the cores, or that a container grants fewer.
    """

    memory_mib: int = 4096
    disk_mib: int = 2048
    core_gain: float = 0.6


NEEDS = Needs()

ROOTS, STEPS = 200_000, 200
"""Size of the timed kernel: about 0.2 s on one core, long against the milliseconds of waking threads."""


@dataclass(frozen=True)
class Check:
    """Result of a check.

    Attributes:
        state: "ok"; "warn": works, but not well; "fail": something will not work.
        line: Result and remedy.
    """

    state: State
    line: str


def examine() -> int:
    """Run all checks and print a line for each.

    Returns:
        Exit code: 1 if a check failed, else 0.
    """
    failed = False
    for check in checks():
        print(f"{check.state:4}  {check.line}", flush=True)
        failed |= check.state == "fail"
    return int(failed)


def checks() -> Iterator[Check]:
    """All checks, cheap ones first. Those that need the packages are left out where one is missing."""
    machine = describe_machine()
    yield Check("ok", f"{machine['processor']}, {machine['cores']} cores, {machine['system']}")
    packages = list(check_packages())
    yield from packages
    yield check_memory(available_mib(), NEEDS.memory_mib)
    yield check_disk(Path.cwd(), NEEDS.disk_mib)
    if any(check.state == "fail" for check in packages):
        return
    yield check_vectors(simd_of_machine(), os.environ.get(TARGET_VARIABLE))
    yield check_memory_kept(sys.platform)
    yield from check_kernels()
    yield check_cores()
    yield check_shift_map()
    yield check_video()


def check_packages() -> Iterator[Check]:
    """Each package that this one requires: present, and of a version that suits."""
    for line in requires("diga3d-warp") or []:
        needed = Requirement(line)
        if needed.marker is not None and not needed.marker.evaluate({"extra": ""}):
            continue  # an extra, which nothing here depends on
        remedy = f"pip install '{needed.name}{needed.specifier}'"
        try:
            found = version(needed.name)
        except PackageNotFoundError:
            yield Check("fail", f"{needed.name} is missing: {remedy}")
            continue
        if needed.specifier.contains(found, prereleases=True):
            yield Check("ok", f"{needed.name} {found}")
        else:
            yield Check("fail", f"{needed.name} {found} does not suit: {remedy}")


def check_memory(available: int, needed: int) -> Check:
    """Free memory [MiB] against what a removal needs."""
    line = f"{available / 1024:.1f} GiB of memory free"
    if available < needed:
        return Check("warn", f"{line}: close other programs, or use --image-scale 0.5")
    return Check("ok", line)


def check_disk(folder: Path, needed: int) -> Check:
    """Free space [MiB] where `folder` is against what a run needs."""
    free = shutil.disk_usage(folder).free // MIB
    line = f"{free / 1024:.1f} GiB of disk free in {folder}"
    return Check("warn", f"{line}: make room for runs") if free < needed else Check("ok", line)


def check_vectors(simd: Collection[str], target: str | None = None) -> Check:
    """Which vector instructions kernels use, and what is slower for want of others.

    Args:
        simd: Of the processor, as `kernels.processor.simd_of_machine` gives them.
        target: Another processor that kernels are compiled for; None or "" for this one.
    """
    if target:
        return Check("ok", f"kernels are compiled for {target} ({TARGET_VARIABLE}), not for this processor")
    if "AVX512F" in simd:
        return Check("ok", "kernels use AVX-512")
    if "AVX2" in simd:
        return Check("ok", "kernels use AVX2: slower than AVX-512, with half as many numbers at a time")
    return Check("ok", "kernels use vectors of 128 bits: slower than AVX2 and AVX-512")


def check_memory_kept(system: str) -> Check:
    """Whether freed memory stays with the process (`process.tune_process`) on a system, by `sys.platform`."""
    if system == "linux":
        return Check("ok", "freed memory is kept for the next image")
    return Check(
        "ok",
        "freed memory goes back to the system, which makes work on images slower than on Linux; "
        "peak memory counts from the start of a run, not of a stage",
    )


def check_kernels() -> Iterator[Check]:
    """Warp compiles a kernel for each device and the device computes it rightly."""
    import numpy as np
    import warp as wp

    from diga3d_warp.kernels.probe import roots_of

    expected = np.sqrt(np.arange(1, 1001))
    for device in wp.get_devices():
        start = time.perf_counter()
        try:
            right = np.allclose(roots_of(1000, 30, device).numpy(), expected, rtol=1e-5)
        except RuntimeError as error:
            reason = " ".join(str(error).split())
            yield Check("fail", f"Warp on {device.name} ({device}): {reason}; reinstall warp-lang")
            continue
        line = f"Warp on {device.name} ({device}): kernel ready in {time.perf_counter() - start:.1f} s"
        yield Check("ok", line) if right else Check("fail", f"{line}, but its results are wrong")


def check_cores() -> Check:
    """Kernels run faster on all cores than on one."""
    from diga3d_warp.kernels.launch import set_thread_count, thread_count
    from diga3d_warp.kernels.probe import roots_of

    cores, threads = core_count(), thread_count()
    seconds = {}
    try:
        for count in (1, cores):
            set_thread_count(count)
            attempts = []
            for _ in range(3):
                start = time.perf_counter()
                roots_of(ROOTS, STEPS, "cpu")
                attempts.append(time.perf_counter() - start)
            seconds[count] = min(attempts)
    finally:
        set_thread_count(threads)
    gain = seconds[1] / seconds[cores]
    line = f"kernels are {gain:.1f} times as fast on {cores} cores as on one"
    if gain < NEEDS.core_gain * cores:
        return Check("warn", f"{line}: other programs use the cores, or this process may use fewer")
    return Check("ok", line)


def check_shift_map() -> Check:
    """OpenCV brings xphoto, which fills views with `--prior classical`."""
    import cv2

    if hasattr(cv2, "xphoto"):
        return Check("ok", "OpenCV has xphoto, the classical prior")
    return Check(
        "fail",
        "OpenCV has no xphoto, the classical prior: pip uninstall opencv-python opencv-python-headless, "
        "then pip install --force-reinstall opencv-contrib-python-headless",
    )


def check_video() -> Check:
    """OpenCV can write each kind of video."""
    from diga3d_warp.pipelines.render import CODECS, open_video

    lacking = []
    with tempfile.TemporaryDirectory() as folder:
        for ending in CODECS:
            video = open_video(Path(folder) / f"video{ending}", (64, 48))
            if not video.isOpened():
                lacking.append(ending)
            video.release()
    if lacking:
        return Check(
            "warn", f"OpenCV cannot write {', '.join(lacking)}: render to a folder of frames instead"
        )
    return Check("ok", f"videos can be written: {', '.join(CODECS)}")
