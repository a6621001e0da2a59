"""What a machine tells of itself, also where it is no Linux: other systems are simulated."""

from __future__ import annotations

import os
import subprocess
import sys
from types import SimpleNamespace

import psutil
import pytest

from diga3d_warp.kernels.launch import Workers
from diga3d_warp.pipelines import machine

WINDOWS = """
import os, platform, sys
import cv2, filelock, kornia, numpy, psutil, pycolmap, torch, trimesh, warp  # those of this system

warp.init()

for name in ("sched_getaffinity", "register_at_fork", "sysconf", "O_DIRECTORY"):
    delattr(os, name)
sys.modules["fcntl"] = sys.modules["resource"] = None  # to import one fails
sys.platform, platform.machine = "win32", lambda: "ARM64"

import importlib, pkgutil

import diga3d_warp
from diga3d_warp.gaussians.fit import FitSettings, fit
from diga3d_warp.gaussians.target import Target

for module in pkgutil.walk_packages(diga3d_warp.__path__, "diga3d_warp."):
    if not module.name.endswith("__main__"):
        importlib.import_module(module.name)

torch.manual_seed(0)
gaussians = diga3d_warp.Gaussians(
    torch.randn(40, 3), torch.full((40, 3), -1.0), torch.randn(40, 4), torch.zeros(40), torch.zeros(40, 1, 3)
)
pose = torch.eye(4)
pose[2, 3] = 6.0
target = Target(diga3d_warp.Camera(32, 24, 30.0, 30.0, 16.0, 12.0, pose), torch.full((24, 32, 3), 0.8))
result = fit(gaussians, [target], 1.0, FitSettings(iterations=4, budget=40, coarse_part=0.0))
assert not torch.equal(result.gaussians.sh, gaussians.sh)
"""


@pytest.fixture
def no_linux(tmp_path, monkeypatch):
    """A system without /proc, affinities and sysconf."""
    monkeypatch.setattr(machine, "PROC", tmp_path / "absent")
    for name in ("sched_getaffinity", "sysconf"):
        monkeypatch.delattr(os, name, raising=False)


def test_this_machine():
    found = machine.describe_machine()
    assert found["cores"] >= 1 and found["memory_mib"] > 100 and found["processor"] and found["system"]
    assert 0 < machine.available_mib() <= found["memory_mib"]


def test_the_peak_counts_from_its_reset():
    block = bytearray(300 << 20)
    before = machine.peak_mib()
    assert before > 300
    del block
    machine.reset_peak()
    assert machine.peak_mib() <= before


def test_a_machine_without_proc(no_linux, monkeypatch):
    assert machine.describe_machine()["cores"] == machine.core_count() == os.cpu_count()
    assert Workers().count == os.cpu_count()
    machine.reset_peak()
    if sys.platform != "win32":
        assert 10 < machine.peak_mib() < 1 << 20


@pytest.mark.parametrize(("system", "unit"), [("darwin", 1), ("linux", 1024)])
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no rusage")
def test_the_peak_is_in_the_units_of_the_system(no_linux, monkeypatch, system, unit):
    """macOS counts bytes, Linux kilobytes."""
    import resource

    used = SimpleNamespace(ru_maxrss=(700 << 20) // unit)
    monkeypatch.setattr(resource, "getrusage", lambda who: used)
    monkeypatch.setattr(sys, "platform", system)
    assert machine.peak_mib() == 700


def test_the_peak_on_windows(no_linux, monkeypatch):
    process = SimpleNamespace(memory_info=lambda: SimpleNamespace(peak_wset=900 << 20))
    monkeypatch.setattr(psutil, "Process", lambda: process)
    monkeypatch.setattr(sys, "platform", "win32")
    assert machine.peak_mib() == 900


def test_windows_imports_everything_and_fits():
    """As far as that can be simulated: under its name, without what it lacks."""
    finished = subprocess.run([sys.executable, "-c", WINDOWS], capture_output=True, text=True, timeout=300)
    assert finished.returncode == 0, finished.stderr[-2000:]
