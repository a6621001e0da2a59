"""Ray runs the same jobs, with the same bytes."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from quick_work import files_of, quick_job, quick_work

from diga3d_warp.errors import InputError
from diga3d_warp.experiments import cluster
from diga3d_warp.experiments.cluster import RayCrew, require_ray
from diga3d_warp.experiments.job import JobFolder
from diga3d_warp.experiments.processes import LocalCrew
from diga3d_warp.experiments.run import run_jobs

DRIVER = """
import sys
from pathlib import Path
from quick_work import quick_job, quick_work
from diga3d_warp.experiments.cluster import RayCrew
from diga3d_warp.experiments.run import run_jobs
if __name__ == "__main__":
    out, gate = map(Path, sys.argv[1:])
    run_jobs([quick_job(name, waits=str(gate)) for name in "abcd"], out, RayCrew(workers=2), quick_work)
"""


@pytest.mark.ray
def test_a_worker_and_the_driver_of_ray_are_killed(tmp_path):
    """First a worker, which Ray replaces, then the driver; the same command then ends with the same bytes."""
    pytest.importorskip("ray")
    gate, out = tmp_path / "gate", tmp_path / "out"
    (tmp_path / "driver.py").write_text(DRIVER)
    path = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    words = [sys.executable, str(tmp_path / "driver.py"), str(out), str(gate)]
    jobs = [quick_job(name, waits=str(gate)) for name in "abcd"]
    folders = [JobFolder(out, job) for job in jobs]

    def workers() -> set[int]:
        return {folder.worker["process"] for folder in folders if folder.worker is not None}

    driver = start(words, path)
    wait_until(lambda: len(workers()) == 2, driver)
    first = workers()
    os.kill(min(first), signal.SIGKILL)
    wait_until(lambda: len(workers() - first) == 1, driver)
    driver.send_signal(signal.SIGKILL)
    driver.wait()
    gate.touch()
    again = start(words, path)
    assert again.wait(120) == 0
    run_jobs(jobs, tmp_path / "calm", LocalCrew(workers=2), quick_work)
    assert files_of(out) == files_of(tmp_path / "calm")
    assert len(files_of(out)) == 4 * 5


def start(words: list[str], path: str) -> subprocess.Popen:
    return subprocess.Popen(words, env={**os.environ, "PYTHONPATH": path})


def wait_until(happened, driver: subprocess.Popen) -> None:
    until = time.monotonic() + 120
    while not happened():
        assert time.monotonic() < until and driver.poll() is None
        time.sleep(0.02)


def test_a_cluster_that_cannot_be_reached(monkeypatch):
    """One line within seconds."""
    monkeypatch.setattr(cluster, "REACH", 2.0)
    monkeypatch.setattr(cluster, "require_ray", lambda: None)
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{unused.getsockname()[1]}"
        with pytest.raises(InputError, match=f"^no cluster answers at {address} "):
            RayCrew(address=address).check()
    for wrong in ("nowhere", "host:", ":6379", "host:99999", "ray://host"):
        with pytest.raises(InputError, match="is not HOST:PORT"):
            RayCrew(address=wrong).check()


def test_ray_is_named_where_it_is_missing(monkeypatch):
    monkeypatch.setattr(cluster, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"Ray is not installed: pip install 'diga3d-warp\[cluster\]'"):
        require_ray()


class TwoMachines:
    """Of Ray, what is asked for the resources of a cluster."""

    @staticmethod
    def nodes() -> list[dict]:
        return [
            {"Alive": True, "Resources": {"CPU": 8.0}},
            {"Alive": True, "Resources": {"CPU": 2.0, "GPU": 1.0}},
            {"Alive": False, "Resources": {"CPU": 64.0, "GPU": 8.0}},
        ]


@pytest.mark.parametrize(
    ("threads", "gpus", "fits"), [(8, 0, True), (2, 0.5, True), (8, 1, False), (9, 0, False)]
)
def test_jobs_that_no_machine_can_run_are_refused(threads, gpus, fits):
    """They would wait for ever."""
    crew = RayCrew(address="auto", threads=threads, gpus=gpus)
    if fits:
        crew._check_resources(TwoMachines)
        return
    with pytest.raises(InputError, match="no machine of the cluster has more than 8 cores and 1 GPUs"):
        crew._check_resources(TwoMachines)
