"""The doctor: all well on the machine that runs the tests, and each trouble told with its remedy."""

import sys
from importlib.metadata import requires
from pathlib import Path

import cv2
import pytest

from diga3d_warp import cli, doctor
from diga3d_warp.kernels.launch import thread_count


def test_this_machine_is_well(capsys):
    threads = thread_count()
    assert cli.main(["doctor"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert all(line.startswith(("ok    ", "warn  ")) for line in lines)
    for expected in ("warp-lang", "torch", "Warp on", "times as fast", "xphoto", ".webm", "memory", "disk"):
        assert sum(expected in line for line in lines) >= 1
    assert thread_count() == threads


@pytest.mark.parametrize(
    ("found", "state"),
    [
        ("1.18.2", "fail"),
        ("1.19", "ok"),
        ("1.19.0+cpu", "ok"),
        ("1.99.5", "ok"),
        ("2.0", "fail"),
        (None, "fail"),
    ],
)
def test_versions(monkeypatch, found, state):
    def version(name):
        if found is None:
            raise doctor.PackageNotFoundError(name)
        return found

    monkeypatch.setattr(doctor, "requires", lambda name: ["warp-lang<2,>=1.19", 'ruff>=1; extra == "dev"'])
    monkeypatch.setattr(doctor, "version", version)
    (check,) = doctor.check_packages()
    assert check.state == state
    assert ("pip install 'warp-lang<2,>=1.19'" in check.line) == (state == "fail")


def test_every_required_package_is_checked():
    """However its versions are bound."""
    needed = [line for line in requires("diga3d-warp") if ";" not in line]
    assert len(list(doctor.check_packages())) == len(needed) > 5


def test_missing_package_stops_what_needs_it(monkeypatch, capsys):
    monkeypatch.setattr(doctor, "requires", lambda name: ["no-such-package>=1.0"])
    assert doctor.examine() == 1
    assert "Warp on" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("simd", "target", "said"),
    [
        ({"AVX2", "AVX512F"}, None, "use AVX-512"),
        ({"SSE2", "AVX2"}, "", "use AVX2: slower than AVX-512"),
        ({"NEON", "ASIMD"}, None, "slower than AVX2 and AVX-512"),
        ({"AVX2"}, "x86-64-v3", "compiled for x86-64-v3 (DIGA3D_CPU)"),
    ],
)
def test_what_slows_kernels_is_said(simd, target, said):
    check = doctor.check_vectors(simd, target)
    assert check.state == "ok" and said in check.line


@pytest.mark.parametrize("system", ["linux", "darwin", "win32"])
def test_what_is_slower_on_other_systems_is_said(system):
    check = doctor.check_memory_kept(system)
    assert check.state == "ok" and ("slower than on Linux" in check.line) == (system != "linux")


def test_little_room_is_a_warning():
    assert doctor.check_memory(100, 4096).state == "warn"
    assert doctor.check_memory(5000, 4096).state == "ok"
    assert doctor.check_disk(Path.cwd(), sys.maxsize).state == "warn"
    assert doctor.check_disk(Path.cwd(), 0).state == "ok"


def test_opencv_without_contrib(monkeypatch):
    monkeypatch.delattr(cv2, "xphoto")
    check = doctor.check_shift_map()
    assert check.state == "fail"
    assert "opencv-contrib-python-headless" in check.line


def test_kernel_with_wrong_results(monkeypatch):
    from diga3d_warp.kernels import probe

    right = probe.roots_of
    monkeypatch.setattr(probe, "roots_of", lambda count, steps, device: right(count, 1, device))
    assert [check.state for check in doctor.check_kernels()] == ["fail"] * len(list(doctor.check_kernels()))
    assert "wrong" in next(doctor.check_kernels()).line
