"""The folder of a run: one process at a time, apart from the capture, no links, nothing damaged taken up."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.record import MANIFEST, read_manifest
from diga3d_warp.pipelines import run_folder
from diga3d_warp.pipelines.run import Run

HOLDER = """
import sys
from pathlib import Path
from diga3d_warp.pipelines.run import Run

run = Run(Path(sys.argv[1]), "fit", {})
print("held", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def holder(tmp_path):
    """Another process that has begun a run in `tmp_path / "run"` and holds it."""
    words = [sys.executable, "-c", HOLDER, str(tmp_path / "run")]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stdout.readline() == "held\n"
        yield process
        process.kill()


def test_two_processes_do_not_share_a_run(holder, tmp_path):
    before = {path: path.read_bytes() for path in (tmp_path / "run").iterdir()}
    with pytest.raises(InputError, match=f"is in use by process {holder.pid}: wait until it has ended"):
        Run(tmp_path / "run", "fit", {}, resume=True)
    assert {path: path.read_bytes() for path in (tmp_path / "run").iterdir()} == before
    holder.kill()
    holder.wait()
    Run(tmp_path / "run", "fit", {}, resume=True)  # the lock of a dead process is free


def test_a_run_may_be_opened_again_by_its_own_process(tmp_path):
    first = Run(tmp_path, "fit", {})
    second = Run(tmp_path, "fit", {}, resume=True)
    first.close()
    words = [sys.executable, "-c", HOLDER.replace("{})", "{}, resume=True)"), str(tmp_path)]
    assert "is in use by process" in subprocess.run(words, capture_output=True, text=True, input="").stderr
    second.close()
    assert subprocess.run(words, capture_output=True, text=True, input="").returncode == 0


def test_a_file_system_without_locks_is_noted(tmp_path, monkeypatch):
    def unable(folder: Path) -> None:
        raise OSError(37, "No locks available")

    monkeypatch.setattr(run_folder, "hold", unable)
    Run(tmp_path, "fit", {})
    assert read_manifest(tmp_path)["notes"] == [f"{tmp_path} cannot be locked: let no second process use it"]


@pytest.mark.parametrize(
    "out",
    [
        "", "images", "images/run", "images_2/run", "images/deeper/run", "masks", "masks/run", "sparse/0/run",
        "sparse/run", "colmap/run", "photos/run", "my masks/run",
    ],
)  # fmt: skip
def test_a_run_in_a_folder_of_the_capture_is_refused(tmp_path, out):
    for name in ("images/a.png", "images_2/a.png", "photos/a.JPG", "my masks/a", "sparse/0/cameras.bin"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(b"")
    before = sorted(tmp_path.rglob("*"))
    settings = {"scene": tmp_path, "masks": tmp_path / "my masks"}
    with pytest.raises(InputError, match="choose another --out"):
        Run(tmp_path / out, "fit", settings)
    with pytest.raises(InputError, match="choose another --out"):
        Run(tmp_path / "photos" / ".." / out, "fit", settings)
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("out", ["run", "runs/first", "../run"])
def test_a_run_beside_the_photographs_is_fine(tmp_path, out):
    capture = tmp_path / "capture"
    (capture / "images").mkdir(parents=True)
    (capture / "photo.png").write_bytes(b"")  # a capture may be nothing but a folder of photographs
    Run(capture / out, "fit", {"scene": capture})
    again = Run(capture / out, "fit", {"scene": capture}, resume=True)
    again.publish(capture / "photo.png", "mask_sheet.png")
    again.close()
    Run(capture / out, "fit", {"scene": capture}, resume=True)


def test_a_name_that_is_too_long_is_one_line(tmp_path):
    with pytest.raises(
        InputError, match=r"cannot be written \(its name is too long\): choose a shorter name"
    ):
        Run(tmp_path / ("a" * 300), "fit", {})


def begun(folder: Path) -> Path:
    """A run with one finished stage, and one that was interrupted."""
    run = Run(folder, "fit", {})

    def interrupted(partial: Path) -> None:
        (partial / "half.txt").write_text("half")
        raise RuntimeError

    run.stage("first", lambda partial: (partial / "product.txt").write_text("made") and None)
    with pytest.raises(RuntimeError):
        run.stage("second", interrupted)
    run.close()
    return folder


def resumed(folder: Path) -> None:
    run = Run(folder, "fit", {}, resume=True)
    try:
        done = run.stage("first", lambda partial: (partial / "product.txt").write_text("made") and None)
        assert (done / "product.txt").read_text() == "made"
        run.stage("second", lambda partial: (partial / "half.txt").write_text("whole") and None)
        run.publish(done / "product.txt", "views/product.txt")
    finally:
        run.close()


def test_a_link_in_the_stages_is_not_followed(tmp_path):
    begun(tmp_path / "run")
    mine = tmp_path / "mine"
    for place in ("stages/.second.partial", "stages/first", "stages", "stages/.second.partial/half.txt"):
        shutil.copytree(tmp_path / "run", tmp_path / "copy")
        link = tmp_path / "copy" / place
        link.rename(mine)
        link.symlink_to(mine)
        kept = sorted((path, path.is_file() and path.read_bytes()) for path in [mine, *mine.rglob("*")])
        with pytest.raises(InputError, match=f"{link} is (a link|no folder): delete it and use --resume"):
            resumed(tmp_path / "copy")
        assert kept == sorted(
            (path, path.is_file() and path.read_bytes()) for path in [mine, *mine.rglob("*")]
        )
        link.unlink()
        resumed(tmp_path / "copy")
        for folder in (tmp_path / "copy", mine):
            shutil.rmtree(folder) if folder.is_dir() else folder.unlink()


def test_pictures_are_not_published_through_a_link(tmp_path):
    begun(tmp_path / "run")
    (tmp_path / "mine").mkdir()
    (tmp_path / "run" / "views").symlink_to(tmp_path / "mine")
    with pytest.raises(InputError, match="views is a link: delete it"):
        resumed(tmp_path / "run")
    assert list((tmp_path / "mine").iterdir()) == []


@pytest.mark.parametrize("place", ["stages", "stages/first", "stages/.second.partial"])
def test_a_file_in_the_place_of_a_folder_is_named(tmp_path, place):
    begun(tmp_path)
    shutil.rmtree(tmp_path / place)
    (tmp_path / place).write_text("")
    with pytest.raises(InputError, match=rf"{tmp_path / place} is no folder: delete"):
        resumed(tmp_path)
    (tmp_path / place).unlink()
    resumed(tmp_path)


@pytest.mark.parametrize("name", ["product.txt", "stage.json"])
@pytest.mark.parametrize("spoil", ["changed", "gone", "a folder"])
def test_a_damaged_product_is_named_and_what_to_delete(tmp_path, name, spoil):
    begun(tmp_path)
    path = tmp_path / "stages" / "first" / name
    path.unlink()
    if spoil == "changed":
        path.write_text("mabe")
    elif spoil == "a folder":
        path.mkdir()
    with pytest.raises(InputError) as error:
        resumed(tmp_path)
    said = str(error.value)
    assert said.startswith(f"{path} ") and said.endswith(
        f": delete {path.parent} and use --resume to compute it again"
    )
    shutil.rmtree(path.parent)
    resumed(tmp_path)


def test_files_that_a_desktop_drops_do_no_harm(tmp_path):
    begun(tmp_path)
    for folder in (tmp_path / "stages", tmp_path / "stages" / "first"):
        (folder / ".DS_Store").write_text("")
    resumed(tmp_path)


def test_a_run_without_its_manifest_is_not_taken_up(tmp_path):
    begun(tmp_path)
    (tmp_path / MANIFEST).unlink()
    with pytest.raises(InputError, match=rf"holds a run without its {MANIFEST}: delete {tmp_path} and run"):
        resumed(tmp_path)


KEYS = ["command", "command_line", "settings", "versions", "machine", "seconds", "stages", "notes"]


@pytest.mark.parametrize("key", KEYS)
@pytest.mark.parametrize("value", ["absent", None, True, -1.5, "text", [1], {"a": 1}])
def test_a_damaged_manifest_is_one_line(tmp_path, key, value):
    begun(tmp_path)
    manifest = json.loads((tmp_path / MANIFEST).read_text())
    good = type(value) is type(manifest[key]) and not isinstance(value, (list, dict))
    manifest[key] = value
    if value == "absent":
        del manifest[key]
    (tmp_path / MANIFEST).write_text(json.dumps(manifest))
    try:
        resumed(tmp_path)
        assert good or (key, value) in [("machine", {"a": 1})]
    except InputError as error:
        assert MANIFEST in str(error) or "other settings" in str(error)
        assert "\n" not in str(error)
