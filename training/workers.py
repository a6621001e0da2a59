"""Several processes that train one network, each on a part of every batch.

On a processor that is shared with other work, threads of one process wait for each other at every layer, and
whoever waits for its turn holds up all. Processes wait once a step, for the mean of their gradients.
"""

from __future__ import annotations

import datetime
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import torch
import torch.distributed
import torch.multiprocessing

from diga3d_warp.errors import InputError

PATIENCE = datetime.timedelta(hours=6)
"""How long a process waits for another: processes may be stopped while something is timed."""


class Workers:
    """The processes, seen from one of them.

    Args:
        rank: Number of this one; 0 writes checkpoints.
        count: How many there are.
    """

    def __init__(self, rank: int = 0, count: int = 1) -> None:
        self.rank, self.count = rank, count

    def agree(self, value: float) -> float:
        """What the first process gives."""
        if self.count == 1:
            return value
        given = torch.tensor(value, dtype=torch.float64)
        torch.distributed.broadcast(given, 0)
        return float(given)

    @torch.no_grad()
    def average(self, tensors: Sequence[torch.Tensor]) -> None:
        """Replace tensors by their mean over the processes."""
        if self.count == 1:
            return
        flat = torch.cat([tensor.reshape(-1) for tensor in tensors])
        torch.distributed.all_reduce(flat)
        flat /= self.count
        start = 0
        for tensor in tensors:
            tensor.copy_(flat[start : start + tensor.numel()].view_as(tensor))
            start += tensor.numel()


def run_workers(count: int, task: Callable[[Workers], None]) -> None:
    """Run a task in several processes, this one among them.

    Args:
        count: How many; 1 starts none.
        task: Can be pickled; given its view of the processes.
    """
    if count == 1:
        task(Workers())
        return
    with tempfile.TemporaryDirectory() as folder:
        meeting = str(Path(folder) / "meeting")
        context = torch.multiprocessing.get_context("spawn")
        others = [
            context.Process(target=_join, args=(rank, count, meeting, task), daemon=True)
            for rank in range(1, count)
        ]
        for process in others:
            process.start()
        _join(0, count, meeting, task)
        for process in others:
            process.join()


def _join(rank: int, count: int, meeting: str, task: Callable[[Workers], None]) -> None:
    torch.distributed.init_process_group(
        "gloo", init_method=f"file://{meeting}", rank=rank, world_size=count, timeout=PATIENCE
    )
    try:
        task(Workers(rank, count))
    except RuntimeError as error:
        if "gloo" not in str(error):
            raise
        raise InputError("another process of this training ended: run the command again") from error
    finally:
        torch.distributed.destroy_process_group()
