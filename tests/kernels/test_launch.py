"""Launches cut into ranges: from several Python threads, after a fork, and by the internals of Warp."""

import multiprocessing
import multiprocessing.connection
import os
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
import torch
import warp as wp

from diga3d_warp.config import POSE_GROUP
from diga3d_warp.kernels import launch as launching
from diga3d_warp.kernels.launch import OPTIONS, launch, set_thread_count, thread_count
from diga3d_warp.splatting.render import render
from poison import rendered
from scenes import camera_at, random_gaussians

COUNT = 3 * POSE_GROUP + 17
PATIENCE = 120.0
"""Seconds after which a test takes a process for hung: a hundred times what it needs on a quiet machine."""


@wp.kernel(module="unique", module_options=OPTIONS)
def index_of(offset: int, indices: wp.array(dtype=int)):
    i = wp.tid() + offset
    indices[i] = i


class Pictures(torch.utils.data.Dataset):
    """A data set that renders its items."""

    def __len__(self) -> int:
        return 2

    def __getitem__(self, index: int) -> torch.Tensor:
        return render(random_gaussians(COUNT, seed=index), camera_at()).color.detach()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
def test_the_worker_of_a_data_loader_renders(threads):
    threads(3)
    here = [Pictures()[index] for index in range(2)]  # the threads are at work before the fork
    loader = torch.utils.data.DataLoader(
        Pictures(), batch_size=None, num_workers=1, multiprocessing_context="fork", timeout=PATIENCE
    )
    there = list(loader)
    assert all(picture.std() > 0.05 for picture in here)
    assert all(torch.equal(a, b) for a, b in zip(here, there, strict=True))
    assert torch.equal(Pictures()[0], here[0]), "the parent goes on"


def threads_at_work(answer: multiprocessing.connection.Connection) -> None:
    """Launch, and send how many threads took part."""
    parts: set[int] = set()
    gate = threading.Barrier(3)

    def work() -> None:
        gate.wait(PATIENCE)
        parts.add(threading.get_ident())

    indices = wp.zeros(10_000, dtype=int, device="cpu")
    launch(index_of, 10_000, [], [indices], device="cpu")
    launching._workers.run(work)
    answer.send((len(parts), indices.numpy().tolist() == list(range(10_000))))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
def test_a_fork_amid_a_launch_leaves_the_child_all_of_its_threads(threads):
    """Locks that another thread holds at that moment stay locked in the child, and the threads are gone."""
    threads(3)
    launch(index_of, 10_000, [], [wp.zeros(10_000, dtype=int, device="cpu")], device="cpu")
    here, there = multiprocessing.Pipe()
    child = multiprocessing.get_context("fork").Process(target=threads_at_work, args=(there,))
    with launching._recording, launching._workers._lock:
        child.start()
    try:
        assert here.poll(PATIENCE / 4), "the child hangs"
        assert here.recv() == (3, True)
    finally:
        child.kill()


def test_one_launch_is_recorded_at_a_time(threads, monkeypatch):
    """Warp loads modules, and compiles them, while it records."""
    threads(2)
    record, inside = wp.launch, []

    def watched(*arguments, **options):
        inside.append(1)
        assert len(inside) == 1
        time.sleep(0.01)
        recorded = record(*arguments, **options)
        inside.pop()
        return recorded

    monkeypatch.setattr(wp, "launch", watched)
    arrays = [wp.zeros(10_000, dtype=int, device="cpu") for _ in range(6)]
    with ThreadPoolExecutor(6) as pool:
        list(pool.map(lambda array: launch(index_of, 10_000, [], [array], device="cpu"), arrays))
    assert all(array.numpy()[-1] == 9_999 for array in arrays)


def test_launches_from_several_threads_give_the_same_bytes_while_their_number_changes(threads):
    gaussians, camera = random_gaussians(COUNT), camera_at()

    def work(_: int) -> list[torch.Tensor]:
        out, leaves = rendered(gaussians, camera)
        return [out.color, out.depth, *(leaf.grad for leaf in leaves.values())]

    threads(3)
    expected = work(0)
    assert expected[0].std() > 0.05
    with ThreadPoolExecutor(4) as pool:
        running = [pool.submit(work, k) for k in range(12)]
        changes, limit = 0, time.monotonic() + PATIENCE
        while not all(task.done() for task in running):
            assert time.monotonic() < limit
            changes += 1
            set_thread_count(1 + changes % 4)
            time.sleep(0.001)
    assert changes > 5
    for task in running:
        assert all(torch.equal(a, b) for a, b in zip(task.result(), expected, strict=True))


def test_the_number_of_threads_is_at_least_one(threads):
    threads(2)
    with pytest.raises(ValueError, match="at least 1"):
        set_thread_count(0)
    assert thread_count() == 2


def test_an_error_in_a_range_reaches_the_caller_and_the_next_launch_works(threads, monkeypatch):
    threads(3)
    indices = wp.zeros(10_000, dtype=int, device="cpu")
    part = launching._part

    def broken(whole, start, end):
        made = part(whole, start, end)
        if start > 0:
            made.hooks = None
        return made

    monkeypatch.setattr(launching, "_part", broken)
    with pytest.raises(AttributeError):
        launch(index_of, 10_000, [], [indices], device="cpu")
    monkeypatch.undo()
    launch(index_of, 10_000, [], [indices], device="cpu")
    assert indices.numpy().tolist() == list(range(10_000))


def test_a_range_of_a_launch_is_that_range_alone_and_leaves_the_whole_as_it_is():
    """Pins what `launch` expects of the launches that Warp records."""
    indices = wp.full(100, -1, dtype=int, device="cpu")
    whole = wp.launch(index_of, 100, [0], [indices], device="cpu", record_cmd=True)
    launching._part(whole, 30, 41).launch()
    assert indices.numpy().tolist() == [-1] * 30 + list(range(30, 41)) + [-1] * 59
    whole.launch()
    assert indices.numpy().tolist() == list(range(100))


@pytest.mark.parametrize("change", [{"fwd_args": None}, {"params": []}, {"set_param_at_index": print}])
def test_launches_of_another_form_are_an_error_that_says_what_to_do(change):
    indices = wp.zeros(100, dtype=int, device="cpu")
    whole = wp.launch(index_of, 100, [0], [indices], device="cpu", record_cmd=True)
    for name, value in change.items():
        setattr(whole, name, value)
    with pytest.raises(RuntimeError, match=r"in another form than 1\.19.*set_thread_count\(1\)"):
        launching._part(whole, 30, 41)
