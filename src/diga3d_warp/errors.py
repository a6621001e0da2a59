"""InputError, the one exception that means: this is wrong, and this would mend it.

`cannot_read`, `cannot_write` and `out_of_memory` word what the system refuses: a file, a full disk, memory.
"""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Callable
from pathlib import Path


class InputError(ValueError):
    """Bad input from the user: one line that names the file, what is wrong, and what would mend it.

    The command line prints the line and exits with code 2, without a traceback.
    """


_FULL = {errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC), errno.EFBIG}  # EDQUOT: not on Windows

_REASONS = {
    errno.ENOSPC: "the disk is full",
    errno.EFBIG: "it would be larger than the system allows",
    errno.EROFS: "the file system is read-only",
    errno.EACCES: "permission denied",
    errno.EPERM: "permission denied",
    errno.ENOENT: "no such file or folder",
    errno.ENOTDIR: "a part of its path is a file",
    errno.EISDIR: "it is a folder",
    errno.ENAMETOOLONG: "its name is too long",
    errno.ELOOP: "its links lead in a circle",
    errno.EMFILE: "too many files are open",
    errno.EIO: "the disk reports an error",
}


def cannot_write(path: str | os.PathLike[str], error: OSError) -> InputError:
    """The one line for a file or folder that the system refuses to write."""
    if error.errno in _FULL:
        remedy = "make room there or choose another place"
    elif error.errno == errno.ENAMETOOLONG:
        remedy = "choose a shorter name"
    elif error.errno == errno.EISDIR:
        remedy = "delete it"
    else:
        remedy = "make it writable or choose another place"
    return InputError(f"{os.fspath(path)} cannot be written ({_reason(error)}): {remedy}")


def cannot_read(path: str | os.PathLike[str], error: OSError, remedy: str | None = None) -> InputError:
    """The one line for a file or folder that the system refuses to read.

    Args:
        path: The file that could not be read.
        error: Error of the system.
        remedy: Remedy; by default derived from the error.
    """
    if remedy is None:
        denied = error.errno in (errno.EACCES, errno.EPERM)
        remedy = "allow this user to read it" if denied else "check that it is there and whole"
    return InputError(f"{os.fspath(path)} cannot be read ({_reason(error)}): {remedy}")


def explained(error: OSError, writing: Callable[[Path], bool], place: Path) -> InputError:
    """The one line for an error that came up in the middle of something.

    Args:
        error: Error of the system.
        writing: Whether a file that the error names was to be written.
        place: Path that was being written, in case the error names no file.
    """
    named = (
        Path(os.fsdecode(error.filename)) if isinstance(error.filename, (str, bytes, os.PathLike)) else None
    )
    if error.errno in _FULL or error.errno == errno.EROFS:
        return cannot_write(named if named and writing(named) else place, error)
    absent = error.errno == errno.ENOENT and named is not None and named.parent.is_dir()
    if named is None or (writing(named) and not absent):
        return cannot_write(named or place, error)
    return cannot_read(named, error)


def _reason(error: OSError) -> str:
    fallback = error.strerror or str(error) or type(error).__name__
    return _REASONS.get(error.errno or 0, fallback.lower())


_ALLOCATION = re.compile(
    r"(can't|cannot|failed to|unable to) allocate|(not enough|out of|insufficient) memory|bad_alloc"
    r"|can't start new thread|failed to map segment",
    re.IGNORECASE,
)
"""How numpy, torch, Warp, OpenCV, COLMAP and the loader of libraries say that there is no more memory; torch
and Warp raise a plain RuntimeError."""

_AMOUNT = re.compile(r"allocate (\d+) bytes|allocate ([\d.]+ [KMGT]i?B)")


def out_of_memory(error: BaseException) -> str | None:
    """Description of a failed allocation; None if neither the error nor one that led to it is about that."""
    if isinstance(error, InputError) or not isinstance(error, Exception):
        return None
    text = str(error)
    full = isinstance(error, OSError) and error.errno == errno.ENOMEM
    if not (full or isinstance(error, MemoryError) or _ALLOCATION.search(text)):
        before = error.__cause__ or (None if error.__suppress_context__ else error.__context__)
        return None if before is None else out_of_memory(before)
    found = _AMOUNT.search(text)
    if found is None:
        return "not enough memory"
    amount = found[2] or f"{int(found[1]) / 2**30:.2f} GiB"
    return f"not enough memory ({amount} more were asked for)"
