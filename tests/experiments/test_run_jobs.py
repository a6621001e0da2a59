"""Jobs are done once, whatever dies in between."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from quick_work import files_of, quick_job, quick_work

from diga3d_warp.errors import InputError
from diga3d_warp.experiments.job import JobFolder
from diga3d_warp.experiments.processes import LocalCrew
from diga3d_warp.experiments.run import ATTEMPTS, Ended, run_jobs
from diga3d_warp.experiments.work import attempt


def here(folders, work, tick):
    """A crew of this process."""
    for folder in folders:
        attempt(str(folder.path), work, 1)
        tick()
        yield Ended(folder)


def test_outcomes_of_all_jobs(tmp_path):
    jobs = [quick_job("a"), quick_job("bb"), quick_job("a")]
    outcomes = run_jobs(jobs, tmp_path / "out", here, quick_work)
    assert list(outcomes) == [jobs[0].name, jobs[1].name]
    assert [outcome["figures"]["PSNR"]["whole"] for outcome in outcomes.values()] == [9.0, 10.0]
    worked = []
    again = run_jobs(jobs, tmp_path / "out", lambda folders, *_: worked.extend(folders) or [], quick_work)
    assert again == outcomes and not worked


def test_an_error_is_kept_and_tried_again(tmp_path, capsys):
    jobs = [quick_job("bad", fails="no view has a mask"), quick_job("odd", breaks=1), quick_job("good")]
    for _ in range(2):
        bad, odd, good = run_jobs(jobs, tmp_path / "out", here, quick_work).values()
        assert bad["error"] == "/scenes/bad: no view has a mask" and good["error"] is None
        assert odd["error"].startswith("ZeroDivisionError: a | b and more (a fault of this program")
        said = capsys.readouterr().err
        assert f"{jobs[0].name}: /scenes/bad: no view has a mask" in said
    assert "Traceback" in (JobFolder(tmp_path / "out", jobs[1]).path / "log.txt").read_text()
    assert (
        "Traceback" not in said and f"{jobs[2].name}: done" not in said and "1 of them done earlier" in said
    )


def test_other_options_are_another_job():
    names = {quick_job("a").name, quick_job("a", seed=1).name, quick_job("b").name}
    assert len(names) == 3
    assert quick_job("a", seed=1, more=2).name == quick_job("a", more=2, seed=1).name
    assert all(len(quick_job("x" * 200, prompt="a/b\\c: " * 50).name) < 80 for _ in range(1))


def test_killed_workers_are_replaced(tmp_path):
    """Jobs go on where a killed process was, with the same bytes; one that always dies is given up."""
    names = ["a", "b", "c"]
    run_jobs([quick_job(name) for name in names], tmp_path / "calm", here, quick_work)
    jobs = [quick_job("a"), quick_job("b", dies=1), quick_job("c", always=True)]
    outcomes = list(run_jobs(jobs, tmp_path / "out", LocalCrew(workers=2), quick_work).values())
    assert [outcome["error"] is None for outcome in outcomes] == [True, True, False]
    assert f"its process ended {ATTEMPTS} times (SIGKILL, as when memory runs out)" in outcomes[2]["error"]
    for name, job in zip(names[:2], jobs, strict=False):
        calm, rough = JobFolder(tmp_path / "calm", quick_job(name)), JobFolder(tmp_path / "out", job)
        assert files_of(calm.run) == files_of(rough.run)


DRIVER = """
import sys
from pathlib import Path
from quick_work import quick_job, quick_work
from diga3d_warp.experiments.processes import LocalCrew
from diga3d_warp.experiments.run import run_jobs
if __name__ == "__main__":
    out, gate = sys.argv[1:]
    run_jobs([quick_job(name, waits=gate) for name in "abcd"], Path(out), LocalCrew(workers=2), quick_work)
"""


def test_a_killed_driver_takes_its_workers_along(tmp_path):
    """The command is given again while its workers may still live, and ends with the same bytes."""
    gate = tmp_path / "gate"
    (tmp_path / "driver.py").write_text(DRIVER)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([*sys.path, str(Path(__file__).parent)])}
    words = [sys.executable, str(tmp_path / "driver.py")]
    driver = subprocess.Popen([*words, str(tmp_path / "out"), str(gate)], env=environment)
    jobs = [quick_job(name, waits=str(gate)) for name in "abcd"]
    folders = [JobFolder(tmp_path / "out", job) for job in jobs]
    until = time.monotonic() + 60
    while sum(folder.run.exists() for folder in folders) < 2 and time.monotonic() < until:
        time.sleep(0.02)
    driver.send_signal(signal.SIGKILL)
    driver.wait()
    workers = [folder.worker["process"] for folder in folders if folder.worker]
    gate.touch()
    assert len(workers) == 2 and not any(folder.outcome for folder in folders)
    run_jobs(jobs, tmp_path / "out", LocalCrew(workers=2), quick_work)
    run_jobs(jobs, tmp_path / "calm", here, quick_work)
    assert files_of(tmp_path / "out") == files_of(tmp_path / "calm")


def test_two_experiments_with_one_folder(tmp_path):
    """The second is refused in one line, and the first is not disturbed."""
    out = tmp_path / "out"

    def crew(folders, work, tick):
        words = "from pathlib import Path; from diga3d_warp.experiments.run import run_jobs, InputError\n"
        words += f"try: run_jobs([], Path({str(out)!r}), None)\nexcept InputError as error: print(error)"
        said = subprocess.run([sys.executable, "-c", words], capture_output=True, text=True, check=True)
        assert said.stdout.startswith(f"{out} is in use by"), said.stdout
        return here(folders, work, tick)

    (outcome,) = run_jobs([quick_job("a")], out, crew, quick_work).values()
    assert outcome["error"] is None


def test_folders_with_other_things_are_refused(tmp_path):
    (tmp_path / "photo.jpg").touch()
    with pytest.raises(InputError, match="holds no experiment, but other things"):
        run_jobs([quick_job("a")], tmp_path, here, quick_work)
    assert [path.name for path in tmp_path.iterdir()] == ["photo.jpg"]


def test_damaged_files_are_named(tmp_path):
    job = quick_job("a")
    run_jobs([job], tmp_path, here, quick_work)
    folder = JobFolder(tmp_path, job)
    (folder.path / "outcome.json").write_text('{"error": 1}')
    with pytest.raises(InputError, match=r"outcome.json is damaged .*: delete it and give the same command"):
        run_jobs([job], tmp_path, here, quick_work)
    described = json.loads((folder.path / "job.json").read_text()) | {"scene": "/scenes/other"}
    (folder.path / "job.json").write_text(json.dumps(described))
    with pytest.raises(InputError, match=r"job.json was edited: delete"):
        JobFolder.open(folder.path)
