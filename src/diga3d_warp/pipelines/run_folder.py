"""Checks and lock of a run folder: writable, apart from the capture, used by one process at a time."""

from __future__ import annotations

import platform
import re
import tempfile
from pathlib import Path

import psutil
from filelock import FileLock, Timeout

from diga3d_warp.errors import InputError, cannot_write
from diga3d_warp.evaluation.record import MANIFEST, running_process
from diga3d_warp.files import temporary_name
from diga3d_warp.scene.photographs.names import IMAGE_SUFFIXES
from diga3d_warp.state import STAGES

LOCK = ".lock"
"""File that a process holds locked while it runs. It stays; the lock goes with the process."""

LEFT_BY_A_KILL = {LOCK, temporary_name(Path(MANIFEST)).name}
"""Files that a process killed at its start may leave in a run folder."""

CAPTURED = re.compile(r"(images|masks|depths?)(_\d+)?|input|sparse|colmap|distorted")
"""Names of folders in a capture that a reader takes files from, or may."""


def make_writable(folder: Path) -> None:
    """Make the folder if it is absent, and test that it can be written to.

    Raises:
        InputError: it is a file, or cannot be written to.
    """
    try:
        if folder.exists() and not folder.is_dir():
            raise InputError(f"{folder} is a file: choose a folder for --out")
        folder.mkdir(parents=True, exist_ok=True)
        # Permission bits do not show read-only file systems, nor what root may do: only writing does.
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise cannot_write(folder, error) from error


def check_empty(folder: Path) -> None:
    """Refuse a folder that holds other things than a run.

    Raises:
        InputError: it holds something.
    """
    foreign = sorted(entry.name for entry in folder.iterdir() if entry.name not in LEFT_BY_A_KILL)
    if STAGES in foreign:
        raise InputError(f"{folder} holds a run without its {MANIFEST}: delete {folder} and run again")
    if foreign:
        raise InputError(
            f"{folder} holds no run, but other things ({foreign[0]}): choose a new or empty folder for --out"
        )


def check_apart(folder: Path, capture: Path, masks: Path | None = None) -> None:
    """Refuse a run in a folder that the capture is read from: its pictures would be taken for photographs.

    Args:
        folder: Of the run; may be absent.
        capture: Folder or file of the capture.
        masks: Folder of its masks, where it is another one.

    Raises:
        InputError: the folder is the capture's, or lies among its photographs, masks or calibration.
    """
    if not capture.exists():
        return
    place = folder.resolve()
    root = (capture if capture.is_dir() else capture.parent).resolve()
    if place == root:
        raise InputError(f"{folder} is the capture's own folder: choose another --out")
    for part in [place, *place.parents]:
        if root in part.parents and (
            CAPTURED.fullmatch(part.name) or (part != place and _holds_images(part))
        ):
            raise InputError(f"{folder} lies in the capture's {part.name}/: choose another --out")
    if masks is not None and masks.resolve() in [place, *place.parents]:
        raise InputError(f"{folder} lies in the folder of the masks, {masks}: choose another --out")


def _holds_images(folder: Path) -> bool:
    return folder.is_dir() and any(entry.suffix.lower() in IMAGE_SUFFIXES for entry in folder.iterdir())


def refuse_links(folder: Path) -> None:
    """Refuse links in a run's stages: writing through one would write outside the run.

    Raises:
        InputError: there is a link, or a file in the place of a folder.
    """
    stages = folder / STAGES
    if stages.is_symlink() or (stages.exists() and not stages.is_dir()):
        raise InputError(f"{stages} is no folder: delete it and use --resume to compute the stages again")
    for entry in stages.rglob("*"):
        if entry.is_symlink():
            raise InputError(f"{entry} is a link: delete it and use --resume")


def refuse_link_above(path: Path, folder: Path) -> None:
    """Refuse to write to a path in a run folder that leads out of it.

    Raises:
        InputError: a folder between the two is a link.
    """
    for above in path.parents:
        if above == folder:
            return
        if above.is_symlink():
            raise InputError(f"{above} is a link: delete it and use --resume")


def hold(folder: Path) -> FileLock:
    """Lock a run folder against other processes until the lock is released or this process ends.

    A process may hold a folder more than once. The lock of a process that died is free.

    Raises:
        InputError: another process holds it.
        OSError: the file system has no locks.
    """
    lock = FileLock(folder / LOCK, is_singleton=True, thread_local=False)
    try:
        lock.acquire(blocking=False)
    except Timeout:
        raise InputError(
            f"{folder} is in use by {_holder(folder)}: wait until it has ended, or choose another --out"
        ) from None
    return lock


def _holder(folder: Path) -> str:
    process = running_process(folder)
    if process is None:
        return "another process"
    if process["host"] != platform.node():
        return f"process {process['number']} on {process['host']}"
    return f"process {process['number']}" if psutil.pid_exists(process["number"]) else "another process"
