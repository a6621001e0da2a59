"""Settings of the whole process, which a program may choose but a library must not."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
from types import ModuleType

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # glibc's malloc.h
KEPT_BYTES = 1 << 30
"""Freed memory up to this stays with the process. By default glibc gives every image-sized block back to the
system and gets it anew, page by page: clearing 11 MB takes 0.9 ms with it and 4.6 ms without."""


def tune_process() -> None:
    """Make torch's worker threads sleep when idle, and keep freed memory.

    OpenMP threads spin while they wait for work. Beside Warp's own threads they take its cores away: small
    tensor operations then cost several times their time. Must run before torch is imported.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")  # what it says of an image is said by our own errors
    if sys.platform == "linux":
        libc = ctypes.CDLL(None)
        if hasattr(libc, "mallopt"):
            libc.mallopt(M_MMAP_THRESHOLD, KEPT_BYTES)
            libc.mallopt(M_TRIM_THRESHOLD, KEPT_BYTES)


def load_pycolmap() -> ModuleType:
    """Import pycolmap, and let signals end this process as before.

    On import it takes SIGTERM for its own and prints a stack trace of C++ then.
    """
    import pycolmap

    if threading.current_thread() is threading.main_thread():
        handler = signal.getsignal(signal.SIGTERM)
        signal.signal(signal.SIGTERM, signal.SIG_DFL if handler is None else handler)
    return pycolmap


def give_memory_back() -> None:
    """Give freed memory to the system after all, so that what comes next is seen in the process's size."""
    if sys.platform == "linux":
        libc = ctypes.CDLL(None)
        if hasattr(libc, "malloc_trim"):
            libc.malloc_trim(0)
