"""How a kernel runs: compiler options, and one launch spread over all cores.

Invariants
- A kernel's first parameter is `offset: int`; its index is `wp.tid() + offset`. So one launch can be cut
  into ranges that run on different threads.
- Two indices never write to the same cell. On CPU `wp.atomic_add` is a plain addition: two threads adding
  to one cell would lose counts. Sums go through rows of their own, added in a fixed order; results therefore
  do not depend on the number of threads.
- No kernel here relies on NaN or infinity being absent: the floating-point flags allow fused
  multiply-add and reordered sums, never `-ffast-math`, which would turn the guards against 0/0 into lies.
"""

from __future__ import annotations

import copy
import os
import time
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import pairwise
from threading import Lock
from typing import Any

import warp as wp

wp.config.log_level = wp.LOG_WARNING
if wp.config.cpu_compiler_flags is None:
    _BASE_FLAGS = "-march=native"
else:
    _BASE_FLAGS = wp.config.cpu_compiler_flags

CPU_FLAGS = (
    _BASE_FLAGS
    + " -ffp-contract=fast"  # fused multiply-add: Warp's fast_math emits none on CPU
    + " -mprefer-vector-width=512"  # 16 float lanes where the machine has them
    + " -fno-signed-zeros -mreassociate"  # lets sums over lanes become vector reductions
)
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

_pool: ThreadPoolExecutor | None = None
_timings: list[tuple[str, float]] | None = None
_thread_count = 0
_first_use = Lock()


def thread_count() -> int:
    """Number of threads a CPU launch may use; at first the cores this process may run on."""
    with _first_use:
        if _thread_count == 0:
            cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
            set_thread_count(cores or 1)
    return _thread_count


def set_thread_count(count: int) -> None:
    """Use `count` threads for CPU launches from now on. Results do not depend on it.

    Raises:
        ValueError: `count` is below one.
    """
    global _pool, _thread_count
    if count < 1:
        raise ValueError(f"thread count must be at least 1, not {count}")
    if _pool is not None:
        _pool.shutdown()
    _pool = ThreadPoolExecutor(count - 1, "warp") if count > 1 else None
    _thread_count = count


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
        _share(deque(_part(whole, start, end) for start, end in pairwise(edges)), threads)
    if _timings is not None:
        name = kernel.key.rpartition("__")[2]  # of a factory's kernel: FACTORY__locals__NAME
        name = f"{name} adjoint" if adjoint else name
        _timings.append((name, time.perf_counter() - started))


def _part(whole: wp.Launch, start: int, end: int) -> wp.Launch:
    """The same launch over indices from `start` to `end` alone.

    Recording it anew would pack every argument again, 50 to 100 us.
    """
    part = copy.copy(whole)
    part.params, part.fwd_args = list(whole.params), list(whole.fwd_args)
    part.set_dim(end - start)
    part.set_param_at_index(0, start)
    return part


def _share(parts: deque[wp.Launch], threads: int) -> None:
    """Run all parts, each on the thread that is free first, this one among them."""

    def drain() -> None:
        while True:
            try:
                part = parts.popleft()
            except IndexError:
                return
            part.launch()

    assert _pool is not None
    helpers = [_pool.submit(drain) for _ in range(threads - 1)]
    drain()
    for helper in helpers:
        helper.result()


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
