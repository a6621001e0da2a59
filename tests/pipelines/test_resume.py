"""A removal killed in every stage, with each resumed run killed in the next, ends with the same bytes."""

from __future__ import annotations

import errno
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from tiny_removal import SETTINGS

from diga3d_warp import files
from diga3d_warp.errors import InputError
from diga3d_warp.gaussians import fit as fitting
from diga3d_warp.pipelines.remove import remove_object
from diga3d_warp.pipelines.run import Run

KILLED = """
import os, signal, sys
from importlib import import_module
from pathlib import Path

from diga3d_warp.process import tune_process

tune_process()
folder, room, tests, module, name, call = sys.argv[1:]
sys.path.insert(0, tests)

from dataclasses import replace

from tiny_removal import SETTINGS

from diga3d_warp.pipelines.remove import remove_object
from diga3d_warp.pipelines.run import Run
from diga3d_warp.scene.load import load_scene

if module:
    *owners, attribute = name.split(".")
    owner = import_module(module)
    for each in owners:
        owner = getattr(owner, each)
    original, calls = getattr(owner, attribute), []

    def deadly(*arguments, **options):
        calls.append(1)
        if len(calls) == int(call):
            os.kill(os.getpid(), signal.SIGKILL)
        return original(*arguments, **options)

    setattr(owner, attribute, deadly)

often = {"checkpoint_seconds": 0.2}
settings = replace(SETTINGS, fit=replace(SETTINGS.fit, **often), refit=replace(SETTINGS.refit, **often))
settings = replace(settings, distil=replace(SETTINGS.distil, checkpoint_seconds=0.0))
remove_object(load_scene(Path(room)), Run(Path(folder), "remove", {"seed": 0}, resume=True), settings)
"""

# Where each process dies: a function, and at which call of it. Every process finishes the stage that the one
# before it died in, so that calls count from there.
DEATHS = {
    "fit": ("diga3d_warp.gaussians.fit", "_Fit._record", 120),
    "lift": ("diga3d_warp.pipelines.clearing", "write_image", 3),
    "clear": ("diga3d_warp.pipelines.clearing", "write_array", 2),
    "look-behind": ("diga3d_warp.pipelines.clearing", "write_array", 4),
    "references": ("diga3d_warp.pipelines.stages", "select_references", 1),
    "fill": ("diga3d_warp.pipelines.coarse", "write_arrays", 2),
    "propagate": ("diga3d_warp.pipelines.coarse", "write_arrays", 9),
    "refit": ("diga3d_warp.gaussians.fit", "_Fit._record", 50),
    "distil": ("diga3d_warp.priors.distillation", "TextureGeometryGuide.__call__", 7),
    "views": ("diga3d_warp.pipelines.stages", "write_image", 5),
    "publishing": ("shutil", "copyfile", 19),
}


def remove_in_a_process(room: Path, folder: Path, death=("", "", 0)) -> int:
    words = [str(folder), str(room), str(Path(__file__).parent), *map(str, death)]
    finished = subprocess.run([sys.executable, "-c", KILLED, *words], capture_output=True, timeout=120)
    assert finished.returncode in (0, -signal.SIGKILL), finished.stderr.decode()[-2000:]
    return finished.returncode


@pytest.fixture(scope="module")
def often_killed(room, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("killed") / "run"
    for stage, death in DEATHS.items():
        assert remove_in_a_process(room, folder, death) == -signal.SIGKILL
        stages = {entry.name for entry in (folder / "stages").iterdir()}
        if stage == "publishing":
            assert not any(name.startswith(".") for name in stages)
        else:
            assert f".{stage}.partial" in stages and stage not in stages
        if stage in ("fit", "refit", "distil"):
            assert (folder / "stages" / f".{stage}.partial" / "checkpoint.pt").is_file(), "goes on from there"
        assert not (folder / "point_cloud.ply").exists()
    assert remove_in_a_process(room, folder) == 0
    return folder


def test_the_splats_have_the_same_bytes(often_killed, removed):
    for name in ("point_cloud.ply", "source.ply"):
        assert (often_killed / name).read_bytes() == (removed.folder / name).read_bytes(), name


@pytest.mark.parametrize("stage", [stage for stage in DEATHS if stage != "publishing"])
def test_each_stage_made_the_same(often_killed, removed, stage):
    mine, theirs = (folder / "stages" / stage for folder in (often_killed, removed.folder))
    names = sorted(str(path.relative_to(theirs)) for path in theirs.rglob("*") if path.is_file())
    assert sorted(str(path.relative_to(mine)) for path in mine.rglob("*") if path.is_file()) == names
    for name in names:
        if name != "stage.json":
            assert (mine / name).read_bytes() == (theirs / name).read_bytes(), name


def test_nothing_temporary_stays(often_killed, removed):
    mine, theirs = (
        {str(path.relative_to(folder)) for path in folder.rglob("*")}
        for folder in (often_killed, removed.folder)
    )
    assert mine == theirs


def full_at(stage: str, nth: int) -> Callable[[Path], None]:
    """In place of `files.sync`: the disk is full at the nth file of a stage."""
    write = files.sync
    tried: list[Path] = []

    def sync(path: Path) -> None:
        if path.parent.name == f".{stage}.partial" and path.is_file():
            tried.append(path)
            if len(tried) == nth:
                raise OSError(errno.ENOSPC, "No space left on device")
        write(path)

    return sync


FULL = [("effects", 1), ("fit", 1), ("fit", 2), ("lift", 1), ("clear", 2), ("look-behind", 7),
        ("references", 1), ("fill", 4), ("propagate", 3), ("refit", 1), ("distil", 2)]  # fmt: skip


def no_memory(fit: fitting._Fit) -> None:
    raise RuntimeError(
        "[enforce fail] DefaultCPUAllocator: can't allocate memory: you tried to allocate 8589934592 bytes."
    )


def test_a_full_disk_and_lack_of_memory_in_any_stage_cost_no_byte(room, removed, tmp_path, monkeypatch):
    def go_on() -> None:
        run = Run(tmp_path / "run", "remove", {"seed": 0}, resume=True)
        try:
            remove_object(removed.scene, run, SETTINGS)
        finally:
            run.close()

    for stage, nth in FULL:
        with monkeypatch.context() as patched:
            patched.setattr(files, "sync", full_at(stage, nth))
            with pytest.raises(
                InputError, match=rf"{stage}\.partial/.* cannot be written \(the disk is full\)"
            ):
                go_on()
        if stage in ("fit", "refit") and nth == 1:
            with monkeypatch.context() as patched:
                patched.setattr(fitting._Fit, "step", no_memory)
                said = rf"stage {stage}: not enough memory \(8\.00 GiB more were asked for\): .* --resume"
                with pytest.raises(InputError, match=said):
                    go_on()
        assert not (tmp_path / "run" / "point_cloud.ply").exists()
    go_on()
    for name in ("point_cloud.ply", "source.ply"):
        assert (tmp_path / "run" / name).read_bytes() == (removed.folder / name).read_bytes(), name
    assert not list((tmp_path / "run").rglob("*.partial*"))
