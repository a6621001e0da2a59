"""How a kernel runs: compiler options, and one launch spread over all cores.

Invariants
- A kernel's first parameter is `offset: int`; its index is `wp.tid() + offset`. So one launch can be cut
  into ranges that run on different threads.
- Two indices never write to the same cell. On CPU `wp.atomic_add` is a plain addition: two threads adding
  to one cell would lose counts. Sums go through rows of their own, added in a fixed order; results therefore
  do not depend on the number of threads.
- Any Python thread may launch, set the number of threads, or fork at any time: results stay the same.
- No kernel here relies on NaN or infinity being absent: the floating-point flags allow fused
  multiply-add and reordered sums, never `-ffast-math`, which would remove the guards against 0/0.
"""

from __future__ import annotations

import copy
import os
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import pairwise
from threading import Lock
from typing import Any

import warp as wp

from diga3d_warp.kernels.processor import flags_here

wp.config.log_level = wp.LOG_WARNING
CPU_FLAGS = flags_here(wp.config.cpu_compiler_flags)
"""One flag string for the whole project: each distinct one costs a precompiled header of 4 to 5 s."""

OPTIONS: dict[str, Any] = {"enable_backward": False, "max_unroll": 0, "cpu_compiler_flags": CPU_FLAGS}
"""Module options of kernels with a hand-written adjoint, or none. `max_unroll` 0 keeps lane loops dynamic,
which is what lets the compiler vectorise them."""

DIFFERENTIABLE: dict[str, Any] = {**OPTIONS, "enable_backward": True}
"""Module options of kernels whose adjoint Warp derives. Only for kernels without sequential loops: Warp does
not replay dynamic loops, and their automatic adjoints are silently wrong."""

UNEVEN_RANGES = 4
"""Ranges per thread of a launch whose indices differ in cost: enough that a slow range does not keep the
other threads waiting. Even launches get one range per thread."""

SERIAL_BELOW = 2048
"""Indices under which one range runs on the calling thread: waking a worker costs about 50 us, as much as a
light kernel needs for this many indices."""

_OTHER_WARP = (
    f"Warp {wp.config.version} records launches in another form than 1.19, for which diga3d_warp is made: "
    "install warp-lang 1.19, or run on one thread, set_thread_count(1)"
)

_timings: list[tuple[str, float]] | None = None


class Workers:
    """The threads that help with launches, made when the first launch needs them.

    Attributes:
        count: Threads of a launch, the calling one among them.
    """

    def __init__(self) -> None:
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
        self.count = cores or 1
        self._pool: ThreadPoolExecutor | None = None
        self._lock = Lock()

    def set_count(self, count: int) -> None:
        """Use so many threads from now on. Launches that run keep the threads that they have."""
        with self._lock:
            retired, self._pool = self._pool, None
            self.count = count
        if retired is not None:
            retired.shutdown(wait=False)

    def run(self, work: Callable[[], None]) -> None:
        """Run `work` on all threads at once, and return when all have finished.

        A helper that has not started when this thread has finished is called off: work that is shared is
        done by then.
        """
        with self._lock:  # a pool that is retired takes no more work
            if self._pool is None and self.count > 1:
                self._pool = ThreadPoolExecutor(self.count - 1, "warp")
            helpers = [self._pool.submit(work) for _ in range(self.count - 1)] if self._pool else []
        try:
            work()
        finally:
            for helper in helpers:
                if not helper.cancel():
                    helper.result()


_workers = Workers()
_recording = Lock()
"""Warp loads and compiles a kernel when its first launch is recorded, on one thread at a time."""


def _after_fork() -> None:
    """A forked process has no thread but the one that forked, and maybe locks that others held."""
    global _workers, _recording
    count = _workers.count
    _workers, _recording = Workers(), Lock()
    _workers.count = count


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


def thread_count() -> int:
    """Number of threads a CPU launch may use; at first the cores this process may run on."""
    return _workers.count


def set_thread_count(count: int) -> None:
    """Use `count` threads for CPU launches from now on. Results do not depend on it.

    Raises:
        ValueError: `count` is below one.
    """
    if count < 1:
        raise ValueError(f"thread count must be at least 1, not {count}")
    _workers.set_count(count)


def launch(
    kernel: wp.Kernel,
    dim: int,
    inputs: Sequence[Any],
    outputs: Sequence[Any] = (),
    *,
    device: Any,
    adj_inputs: Sequence[Any] = (),
    adj_outputs: Sequence[Any] = (),
    adjoint: bool = False,
    work: int = 1,
    uneven: bool = False,
) -> None:
    """Run `kernel` over `dim` indices, on CPU spread over all threads.

    Args:
        kernel: Its first parameter is `offset: int`, given here, not in `inputs`.
        dim: Number of indices. Nothing runs for 0.
        inputs, outputs: Arguments after `offset`, in order.
        device: Warp device or its name.
        adj_inputs, adj_outputs: Gradient arrays in the order of `inputs` and `outputs`, None where an
            argument has none. Only with `adjoint`.
        adjoint: Run the adjoint that Warp derived. Each index must write gradients to cells of its own.
        work: How many times heavier an index is than a light one (about 20 ns); decides when a launch is
            worth spreading.
        uneven: Indices differ much in cost.
    """
    if dim == 0:
        return
    started = time.perf_counter()
    device = wp.get_device(device)
    zero = [0] if adjoint else []
    with _recording:
        whole = wp.launch(
            kernel, dim, inputs=[0, *inputs], outputs=list(outputs),
            adj_inputs=zero + list(adj_inputs), adj_outputs=list(adj_outputs), adjoint=adjoint,
            device=device, record_tape=False, record_cmd=True,
        )  # fmt: skip
    threads = thread_count() if device.is_cpu else 1
    if threads == 1 or dim * work < SERIAL_BELOW:
        whole.launch()
    else:
        count = min(dim, threads * (UNEVEN_RANGES if uneven else 1))
        edges = [dim * k // count for k in range(count + 1)]
        _share(deque(_part(whole, start, end) for start, end in pairwise(edges)))
    if _timings is not None:
        name = kernel.key.rpartition("__")[2]  # of a factory's kernel: FACTORY__locals__NAME
        name = f"{name} adjoint" if adjoint else name
        _timings.append((name, time.perf_counter() - started))


def _part(whole: wp.Launch, start: int, end: int) -> wp.Launch:
    """The same launch over indices from `start` to `end` alone.

    Recording it anew would pack every argument again, 50 to 100 us. So this reaches into Warp's recorded
    launch, whose parameters are its bounds and then the packed arguments.

    Raises:
        RuntimeError: a recorded launch of the installed Warp is made otherwise.
    """
    try:
        part = copy.copy(whole)
        part.params, part.fwd_args = list(whole.params), list(whole.fwd_args)
        part.set_dim(end - start)
        part.set_param_at_index(0, start)
        as_expected = part.params[0].size == end - start and part.params[1].value == start
    except (AttributeError, TypeError, IndexError) as error:
        raise RuntimeError(_OTHER_WARP) from error
    if not as_expected:
        raise RuntimeError(_OTHER_WARP)
    return part


def _share(parts: deque[wp.Launch]) -> None:
    """Run all parts on all threads, the calling one included; each takes the next part when it is free."""

    def drain() -> None:
        while True:
            try:
                part = parts.popleft()
            except IndexError:
                return
            part.launch()

    _workers.run(drain)


@contextmanager
def timed_launches() -> Iterator[list[tuple[str, float]]]:
    """Collect name and wall time [s] of every launch in the block; adjoints are called "NAME adjoint".

    For measurements on CPU: on CUDA a launch returns before its kernel has run.
    """
    global _timings
    before, _timings = _timings, []
    try:
        yield _timings
    finally:
        _timings = before
