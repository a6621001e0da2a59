"""Files: whole or absent, also on a full disk, under long names, where links lie in wait, and on Windows."""

from __future__ import annotations

import errno
import os
import stat
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from diga3d_warp import files
from diga3d_warp.errors import InputError, cannot_read, out_of_memory
from diga3d_warp.files import (
    put_in_place,
    read_json,
    temporary_name,
    whole_file,
    write_array,
    write_arrays,
    write_json,
    write_text,
)
from scenes import random_gaussians

FULL = Path("/dev/full")

WRITERS = {
    "a.txt": lambda path: write_text(path, "x" * 100_000),
    "a.npy": lambda path: write_array(path, np.ones(100_000)),
    "a.ply": lambda path: random_gaussians(200).save_ply(path),
    "a.npz": lambda path: write_arrays(path, a=np.random.default_rng(0).random(100_000)),
}


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX limits")
def test_a_full_disk_leaves_the_old_file_and_says_so(tmp_path):
    """A limit on the size of files is what a full disk is to a writer."""
    code = (
        "import resource, signal, sys; from pathlib import Path\n"
        f"sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
        "from test_files import WRITERS\n"
        "from diga3d_warp.errors import InputError\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))\n"
        "for name, write in WRITERS.items():\n"
        "    try: write(Path(sys.argv[1]) / name)\n"
        "    except InputError as error: print(error)\n"
    )
    for name in WRITERS:
        (tmp_path / name).write_text("old")
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True)
    lines = done.stdout.splitlines()
    assert lines == [
        f"{tmp_path / name} cannot be written (it would be larger than the system allows): "
        "make room there or choose another place"
        for name in WRITERS
    ], done.stderr
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == dict.fromkeys(WRITERS, "old")


@pytest.mark.skipif(not FULL.exists(), reason="needs a device that is always full")
def test_no_space_left_is_told_with_the_file(tmp_path):
    said = r"a\.txt cannot be written \(the disk is full\): make room"
    with (
        pytest.raises(InputError, match=said),
        whole_file(tmp_path / "a.txt"),
        FULL.open("wb", buffering=0) as full,
    ):
        full.write(b"x")
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_be_read_is_not_called_unwritable(tmp_path):
    said = r"source\.txt cannot be read \(no such file or folder\)"
    with pytest.raises(InputError, match=said), whole_file(tmp_path / "a.txt") as partial:
        partial.write_bytes((tmp_path / "elsewhere" / "source.txt").read_bytes())
    denied = PermissionError(errno.EACCES, "Permission denied", "photo.jpg")
    assert str(cannot_read("photo.jpg", denied)) == (
        "photo.jpg cannot be read (permission denied): allow this user to read it"
    )


def test_a_link_under_the_temporary_name_is_not_followed(tmp_path):
    mine = tmp_path / "mine.txt"
    mine.write_text("mine")
    temporary_name(tmp_path / "a.txt").symlink_to(mine)
    write_text(tmp_path / "a.txt", "new")
    assert (mine.read_text(), (tmp_path / "a.txt").read_text()) == ("mine", "new")
    assert not (tmp_path / "a.txt").is_symlink()


@pytest.mark.parametrize("stem", ["a" * 251, "ä" * 125])
def test_the_longest_names_can_be_written(tmp_path, stem):
    write_text(tmp_path / f"{stem}.txt", "x")
    assert [path.name for path in tmp_path.iterdir()] == [f"{stem}.txt"]


def test_a_folder_in_the_place_of_a_file_is_named(tmp_path):
    (tmp_path / "a.txt").mkdir()
    with pytest.raises(
        InputError, match=rf"^{tmp_path / 'a.txt'} cannot be written \(it is a folder\): delete"
    ):
        write_text(tmp_path / "a.txt", "x")


def test_a_name_that_is_too_long_is_one_line(tmp_path):
    with pytest.raises(
        InputError, match=r"cannot be written \(its name is too long\): choose a shorter name"
    ):
        write_text(tmp_path / ("a" * 300), "x")


def test_a_name_that_is_no_text_can_stand_in_a_file(tmp_path):
    write_text(tmp_path / "a.html", f"<p>{os.fsdecode(bytes([0x66, 0xFC]))}</p>")
    assert (tmp_path / "a.html").read_text(encoding="utf-8") == "<p>f\\udcfc</p>"


def test_archives_hold_no_time(tmp_path, monkeypatch):
    monkeypatch.setattr(time, "time", lambda: 1.0e9)
    for name in ("a.npz", "b.npz"):
        write_arrays(tmp_path / name, values=np.arange(9), mask=np.eye(3, dtype=bool))
        monkeypatch.setattr(time, "time", lambda: 1.7e9)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    with np.load(tmp_path / "a.npz") as archive:
        assert np.array_equal(archive["values"], np.arange(9)) and archive["mask"].sum() == 3


@pytest.mark.parametrize(
    ("data", "place"),
    [({"curve": [{"loss": 1.0}, {"loss": float("nan")}]}, r"curve\[1\]\.loss"), (float("inf"), "it")],
)
def test_figures_that_are_not_finite_are_named_and_nothing_is_written(tmp_path, data, place):
    write_json(tmp_path / "a.json", {"old": 1})
    with pytest.raises(InputError, match=rf"a\.json cannot be written \({place} is not a finite number\)"):
        write_json(tmp_path / "a.json", data)
    assert read_json(tmp_path / "a.json", "") == {"old": 1}


def test_json_with_a_byte_order_mark_is_read_and_without_end_is_refused(tmp_path):
    (tmp_path / "a.json").write_bytes(b"\xef\xbb\xbf[1]")
    assert read_json(tmp_path / "a.json", "") == [1]
    (tmp_path / "a.json").write_text("[" * 100_000)
    with pytest.raises(InputError, match=r"a\.json is nested too deep for JSON: export it again"):
        read_json(tmp_path / "a.json", "export it again")


@pytest.fixture
def windows(monkeypatch):
    """As far as `files` can tell, this is Windows: it refuses what Windows does."""
    opened = Path.open

    def checked(path: Path, mode: str = "r", *rest, **options):
        assert not path.is_dir(), "Windows opens no folder"
        return opened(path, mode, *rest, **options)

    real_fsync = os.fsync

    def fsync(number: int) -> None:
        import fcntl

        if fcntl.fcntl(number, fcntl.F_GETFL) & os.O_ACCMODE == os.O_RDONLY:
            raise OSError(errno.EBADF, "Bad file descriptor")
        real_fsync(number)

    monkeypatch.setattr(files, "IS_WINDOWS", True)
    monkeypatch.setattr(Path, "open", checked)
    monkeypatch.setattr(files.os, "fsync", fsync)


@pytest.mark.skipif(sys.platform == "win32", reason="stands in for Windows")
def test_files_are_whole_on_windows_too(windows, tmp_path, monkeypatch):
    write_text(tmp_path / "a.txt", "x")
    (tmp_path / "sub").mkdir()
    write_text(tmp_path / "sub" / "b.txt", "y")
    files.sync(tmp_path)
    replace, busy = Path.replace, [PermissionError(13, "used by another process")] * 2

    def refused_twice(path: Path, target: Path):
        if busy:
            raise busy.pop()
        return replace(path, target)

    monkeypatch.setattr(Path, "replace", refused_twice)
    monkeypatch.setattr(time, "sleep", lambda seconds: None)
    put_in_place(tmp_path / "sub", tmp_path / "done")
    assert (tmp_path / "done" / "b.txt").read_text() == "y"


def test_files_that_may_not_be_written_are_synced(tmp_path):
    (tmp_path / "a.txt").write_text("x")
    (tmp_path / "a.txt").chmod(stat.S_IRUSR)
    files.sync(tmp_path)


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (MemoryError(), "not enough memory"),
        (MemoryError("Unable to allocate 8.00 GiB for an array"), "not enough memory (8.00 GiB more"),
        (RuntimeError("DefaultCPUAllocator: not enough memory: you tried to allocate 8589934592 bytes."),
         "not enough memory (8.00 GiB more"),
        (RuntimeError("Failed to allocate 1073741824 bytes on device 'cpu'"), "not enough memory (1.00 GiB"),
        (RuntimeError("can't start new thread"), "not enough memory"),
        (OSError(errno.ENOMEM, "Cannot allocate memory"), "not enough memory"),
        (RuntimeError("size mismatch"), None),
        (ValueError("memory of the scene"), None),
        (KeyboardInterrupt(), None),
    ],
)  # fmt: skip
def test_lack_of_memory_is_recognised(error, said):
    found = out_of_memory(error)
    assert found is None if said is None else found is not None and found.startswith(said)


def test_lack_of_memory_is_recognised_behind_the_error_that_it_led_to():
    """A checkpoint that torch cannot finish writing ends with an error about its archive."""
    with pytest.raises(RuntimeError) as caught:
        try:
            raise MemoryError
        except MemoryError:
            raise RuntimeError("unexpected pos 11770816 vs 11770704")  # noqa: B904
    assert out_of_memory(caught.value) == "not enough memory"
    with pytest.raises(RuntimeError) as caught:
        try:
            raise MemoryError
        except MemoryError:
            raise RuntimeError("a fault of its own") from None
    assert out_of_memory(caught.value) is None


def test_lack_of_memory_is_recognised_as_the_libraries_say_it():
    import cv2
    import torch

    for allocate in (
        lambda: torch.empty(1 << 60, dtype=torch.uint8),
        lambda: np.empty(1 << 60, np.uint8),
        lambda: cv2.resize(np.zeros((9, 9), np.uint8), (2**31 - 2, 2**31 - 2)),
    ):
        with pytest.raises(Exception) as caught:
            allocate()
        assert out_of_memory(caught.value), caught.value
