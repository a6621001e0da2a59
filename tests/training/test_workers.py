"""Processes that train together."""

import json
from functools import partial

import pytest
import torch
from training.workers import Workers, run_workers

from diga3d_warp.errors import InputError


def meet(folder, workers):
    tensors = [torch.full((2, 2), float(workers.rank)), torch.tensor([10.0 * workers.rank])]
    workers.average(tensors)
    agreed = workers.agree(5.0 + workers.rank)
    (folder / f"{workers.rank}.json").write_text(json.dumps([t.tolist() for t in tensors] + [agreed]))
    if workers.rank == 0:
        workers.average(tensors)  # the other has left


def test_processes_agree_and_whoever_is_left_alone_says_so(tmp_path):
    with pytest.raises(InputError, match="another process of this training ended: run the command again"):
        run_workers(2, partial(meet, tmp_path))
    told = [json.loads((tmp_path / f"{rank}.json").read_text()) for rank in (0, 1)]
    assert told[0] == told[1] == [[[0.5, 0.5], [0.5, 0.5]], [5.0], 5.0]


def test_one_process_is_alone():
    tensor = torch.ones(3)
    Workers().average([tensor])
    assert tensor.tolist() == [1, 1, 1] and Workers().agree(7.0) == 7.0
