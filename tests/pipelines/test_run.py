"""A run folder: killed at any stage it resumes to the same bytes; bad outputs are refused in one line."""

import json
import mmap
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.record import MANIFEST, read_manifest, read_metrics
from diga3d_warp.files import temporary_name
from diga3d_warp.gaussians.fit import FitSettings
from diga3d_warp.gaussians.optimiser import LearningRates
from diga3d_warp.pipelines import machine
from diga3d_warp.pipelines.contents import everything
from diga3d_warp.pipelines.method import PAPER
from diga3d_warp.pipelines.remove import RemoveSettings
from diga3d_warp.pipelines.run import Run
from diga3d_warp.pipelines.run_folder import LOCK
from diga3d_warp.priors.exemplar.prior import ExemplarPrior
from diga3d_warp.priors.exemplar.settings import FillSettings, PatchSettings
from diga3d_warp.priors.settings import SamplingSettings
from diga3d_warp.scene.load import load_scene
from diga3d_warp.scene.scene import Scene

STAGES = ("scene", "fit", "remove")
STEPS = 4

# Each stage extends a list from its own checkpoint; `die` names the stage and moment of the kill.
TOY = """
import json, os, signal, sys
from pathlib import Path
from diga3d_warp.files import write_json
from diga3d_warp.pipelines import run as runs

folder, die, steps = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])

def kill_at(moment):
    if moment == die:
        os.kill(os.getpid(), signal.SIGKILL)

run = runs.Run(folder, "remove", {"seed": 7}, resume="--resume" in sys.argv)
previous = None
for name in ("scene", "fit", "remove"):
    def compute(partial, name=name, previous=previous):
        checkpoint = partial / "numbers.json"
        numbers = json.loads(checkpoint.read_text()) if checkpoint.exists() else []
        value = json.loads((previous / "numbers.json").read_text())[-1] if previous else 7
        for step in range(len(numbers), steps):
            numbers.append(((numbers[-1] if numbers else value) * 1103515245 + 12345) % 2**31)
            write_json(checkpoint, numbers)
            kill_at(f"{name}:{step}")
        with (folder / "work.log").open("a") as log:
            log.write(name + "\\n")
    previous = run.stage(name, compute)
    kill_at(f"{name}:done")
run.publish(previous / "numbers.json", "point_cloud.ply")
"""


def toy(folder: Path, die: str = "", *more: str) -> int:
    arguments = [sys.executable, "-c", TOY, str(folder), die, str(STEPS), *more]
    return subprocess.run(arguments, capture_output=True, timeout=60).returncode


@pytest.mark.parametrize("moment", [f"{name}:{when}" for name in STAGES for when in (1, "done")])
def test_killed_run_resumes_to_the_same_bytes(tmp_path, moment):
    assert toy(tmp_path / "whole") == 0
    assert toy(tmp_path / "killed", moment) == -signal.SIGKILL
    assert not (tmp_path / "killed" / "point_cloud.ply").exists()
    assert toy(tmp_path / "killed", "", "--resume") == 0
    expected = (tmp_path / "whole" / "point_cloud.ply").read_bytes()
    assert (tmp_path / "killed" / "point_cloud.ply").read_bytes() == expected
    log = (tmp_path / "killed" / "work.log").read_text().split()
    assert log == list(STAGES), "a finished stage is not computed again"
    stages = read_manifest(tmp_path / "killed")["stages"]
    assert [stage["name"] for stage in stages] == list(STAGES)
    name, when = moment.split(":")
    assert [stage["name"] for stage in stages if stage["resumed"]] == ([name] if when == "1" else [])


def test_manifest_says_how_the_result_came_about(tmp_path):
    run = Run(tmp_path / "run", "fit", {"seed": 3, "scene": Path("scene"), "sizes": (1, 2)})
    block = 64 << 20

    def compute(folder: Path) -> None:
        # Mapped memory goes back to the system at once; freed memory stays with the process (`process`).
        with mmap.mmap(-1, block) as memory:
            for page in range(0, block, mmap.PAGESIZE):
                memory[page] = 1

    run.stage("light", lambda folder: None)
    run.stage("heavy", compute)
    run.stage("light again", lambda folder: None)
    run.note("two images are missing")
    run.note("two images are missing")
    manifest = read_manifest(tmp_path / "run")
    assert manifest["command"] == "fit"
    assert manifest["settings"] == {"seed": 3, "scene": str(Path("scene").resolve()), "sizes": [1, 2]}
    assert {"python", "warp", "torch", "numpy", "opencv", "pycolmap", "diga3d_warp"} <= set(
        manifest["versions"]
    )
    assert manifest["machine"]["cores"] >= 1
    assert manifest["notes"] == ["two images are missing"]
    assert 0 < sum(stage["seconds"] for stage in manifest["stages"]) <= manifest["seconds"]
    peaks = [stage["peak_mib"] for stage in manifest["stages"]]
    assert peaks[1] >= peaks[0] + 50, "the heavy stage shows"
    if Path("/proc/self/clear_refs").exists():
        assert peaks[2] <= peaks[1] - 50, "a peak belongs to its own stage"


def test_stage_that_raises_is_not_finished(tmp_path):
    run = Run(tmp_path, "fit", {})

    def fail(folder: Path) -> None:
        (folder / "half").write_text("half")
        raise RuntimeError

    with pytest.raises(RuntimeError):
        run.stage("fit", fail)
    assert not (tmp_path / "stages" / "fit").exists()
    done = Run(tmp_path, "fit", {}, resume=True).stage("fit", lambda folder: None)
    assert (done / "half").read_text() == "half", "the stage continues from what it left"


def test_metrics_of_several_subjects_stand_together(tmp_path):
    run = Run(tmp_path, "fit", {})
    run.add_metrics("fit", {"psnr": 21.5})
    run.add_metrics("refit", {"psnr": None})
    assert read_metrics(tmp_path) == {"fit": {"psnr": 21.5}, "refit": {"psnr": None}}
    with pytest.raises(InputError, match=r"fit\.psnr is not a finite number"):
        run.add_metrics("fit", {"psnr": float("inf")})
    assert read_metrics(tmp_path)["fit"] == {"psnr": 21.5}


def test_resume_refuses_other_settings_and_names_them(tmp_path):
    Run(tmp_path, "remove", {"seed": 1, "iterations": 3000})
    with pytest.raises(InputError, match=r"iterations = 3000 \(now 500\)"):
        Run(tmp_path, "remove", {"seed": 1, "iterations": 500}, resume=True)
    with pytest.raises(InputError, match=r"command = 'remove' \(now 'fit'\)"):
        Run(tmp_path, "fit", {"seed": 1, "iterations": 3000}, resume=True)
    with pytest.raises(InputError, match=r"extra = None \(now 2\)"):
        Run(tmp_path, "remove", {"seed": 1, "iterations": 3000, "extra": 2}, resume=True)


def test_resume_with_another_version_is_noted(tmp_path):
    Run(tmp_path, "fit", {})
    manifest = json.loads((tmp_path / MANIFEST).read_text())
    manifest["versions"]["warp"] = "0.1"
    (tmp_path / MANIFEST).write_text(json.dumps(manifest))
    Run(tmp_path, "fit", {}, resume=True)
    assert "begun with 0.1" in read_manifest(tmp_path)["notes"][0]


def test_the_peak_of_a_run_is_that_of_the_process(tmp_path):
    """Reading the capture counts, too, which is no stage."""
    block = bytearray(200 << 20)
    run = Run(tmp_path, "fit", {})
    del block
    run.stage("fit", lambda folder: None)
    manifest = read_manifest(tmp_path)
    assert manifest["peak_mib"] >= manifest["reading_mib"] > 200
    assert manifest["peak_mib"] >= manifest["stages"][0]["peak_mib"] > 0


def test_the_version_of_the_code_changes_with_its_files(tmp_path, monkeypatch):
    (tmp_path / "__init__.py").write_text("")
    (tmp_path / "kernels").mkdir()
    found = []
    for code in ("alpha_min = 1 / 255", "alpha_min = 1 / 64"):
        (tmp_path / "kernels" / "blending.py").write_text(code)
        monkeypatch.setattr(machine.diga3d_warp, "__file__", str(tmp_path / "__init__.py"))
        machine._code_digest.cache_clear()
        found.append(machine.package_versions()["diga3d_warp"])
        monkeypatch.undo()
    machine._code_digest.cache_clear()
    assert found[0] != found[1] and found[0].split("+")[0] == found[1].split("+")[0]
    assert machine.package_versions()["diga3d_warp"] not in found


def test_resume_where_nothing_began_starts(tmp_path):
    Run(tmp_path / "new", "fit", {}, resume=True)
    assert read_manifest(tmp_path / "new")["stages"] == []


def test_run_killed_before_its_manifest_starts_again(tmp_path):
    temporary_name(tmp_path / MANIFEST).write_text('{"comm')
    Run(tmp_path, "fit", {}, resume=True)
    assert read_manifest(tmp_path)["command"] == "fit"


def test_finished_run_is_not_overwritten(tmp_path):
    Run(tmp_path, "fit", {})
    with pytest.raises(InputError, match="--resume"):
        Run(tmp_path, "fit", {})


def test_foreign_folder_is_left_alone(tmp_path):
    (tmp_path / "holiday.jpg").write_text("")
    for resume in (False, True):
        with pytest.raises(InputError, match=r"holiday\.jpg"):
            Run(tmp_path, "fit", {}, resume=resume)
    assert [entry.name for entry in tmp_path.iterdir()] == ["holiday.jpg"]


def test_output_that_is_a_file(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="is a file"):
        Run(tmp_path / "file", "fit", {})
    with pytest.raises(InputError, match="cannot be written"):
        Run(tmp_path / "file" / "run", "fit", {})


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs a folder that nobody can write to")
def test_unwritable_output():
    with pytest.raises(InputError, match="cannot be written"):
        Run(Path("/proc/self/run"), "fit", {})


def test_broken_manifest_is_one_line(tmp_path):
    (tmp_path / MANIFEST).write_text("{")
    with pytest.raises(InputError, match="not valid JSON") as error:
        Run(tmp_path, "fit", {}, resume=True)
    assert "\n" not in str(error.value)
    assert {entry.name for entry in tmp_path.iterdir()} == {MANIFEST, LOCK}


def test_a_full_disk_ends_a_stage_in_one_line(tmp_path):
    def compute(folder: Path) -> None:
        raise OSError(28, "No space left on device", str(folder / "big.npy"))

    run = Run(tmp_path / "run", "fit", {"seed": 0})
    with pytest.raises(InputError, match=r"big\.npy.*disk is full"):
        run.stage("fit", compute)
    assert not (tmp_path / "run" / "stages" / "fit").exists()


def test_resume_is_held_to_every_setting_and_to_the_capture(tmp_path, room):
    scene = load_scene(room)
    settings = RemoveSettings(fit=FitSettings(budget=4000))

    def begin(settings: RemoveSettings = settings, scene: Scene = scene, **options) -> Run:
        given = {"seed": 1, "effects": {}, "prior": ExemplarPrior(), "method": PAPER, **options}
        run = Run(tmp_path, "remove", {"seed": 1}, resume=True)
        run.hold_to(**everything(scene, settings, **given))
        return run

    begin()
    begin(replace(settings, fit=replace(settings.fit, checkpoint_seconds=1.0)))  # on it no result depends
    view = scene.views[2]
    retouched, moved = view.pixels.copy(), view.camera.pose.copy()
    retouched[0, 0] ^= 1
    moved[0, 3] += 1e-3

    def with_view(**changes) -> Scene:
        views = [replace(each, **changes) if each is view else each for each in scene.views]
        return replace(scene, views=views)

    sampled = ExemplarPrior()
    sampled.sampling = SamplingSettings(steps=5, strength=0.3)
    others = {
        r"settings\.fit\.budget = 4000 \(now 5000\)": {
            "settings": replace(settings, fit=replace(settings.fit, budget=5000))
        },
        r"budget = 0 \(now 60000\).* and 1 more;": {"settings": replace(settings, refit=FitSettings())},
        r"settings\.fit\.rates\.sh_dc = 0\.005 \(now 0\.1\);": {
            "settings": replace(settings, fit=replace(settings.fit, rates=LearningRates(sh_dc=0.1)))
        },
        r"method\.sampling\.steps = None \(now 3\)": {
            "method": replace(PAPER, sampling=SamplingSettings(steps=3))
        },
        r"method\.distillation": {"method": replace(PAPER, distillation=None)},
        r"prior\.own\.steps_first = ": {"prior": ExemplarPrior(settings=FillSettings(steps_first=2))},
        r"prior\.sampling\.steps = 20 \(now 5\)": {"prior": sampled},
        r"prior\.guidance = ": {"prior": ExemplarPrior(negative="a vase")},
        r"prior\.patches\.radius = 3 \(now 2\)": {"prior": ExemplarPrior(patches=PatchSettings(radius=2))},
        r"effects\.lens = None \(now False\)": {"effects": {"lens": False}},
        r"capture\.photographs = ": {"scene": with_view(pixels=retouched)},
        r"capture\.masks = ": {"scene": with_view(mask=~view.mask)},
        r"capture\.cameras = ": {"scene": with_view(camera=view.camera.with_pose(torch.from_numpy(moved)))},
    }
    for said, other in others.items():
        with pytest.raises(InputError, match=said):
            begin(**other)
    begin()
