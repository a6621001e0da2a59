"""Kill a worker and then the driver of an experiment, and compare its bytes with an undisturbed one.

    python benchmarks/interrupted_experiment.py --work run/interrupted

Two synthetic situations in the layout of SPIn-NeRF; table1, table3 and table4 by one command, with two
workers on a local Ray. The undisturbed experiment is kept, as is the data: given again, the script goes on
with what is missing. `--no-ray` does the same with worker processes.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from diga3d_warp.experiments.job import JOBS, JobFolder

SITUATIONS = ("rug", "tiles")

DIFFERS = {
    "manifest.json",
    "report.html",
    "costs.md",
    "worker.json",
    "log.txt",
    "stage.json",
    "plan.json",
    ".lock",
}
"""Files that hold seconds, memory, or the number of a process; plan.json has the measured cost of effects."""

LONG = ("fit", "charts", "propagate", "refit", "distil")
"""Stages in which a process is killed."""


def main() -> int:
    options = arguments()
    data = options.work / "data"
    for name in SITUATIONS:
        if not (data / name).exists():
            width, height = options.size.split("x")
            size = ["--width", width, "--height", height, "--views", str(options.views)]
            diga3d("synthetic", str(data / name), "--situation", name, "--layout", "spin-nerf", *size).wait()
    calm, rough = options.work / "calm", options.work / "rough"
    shutil.rmtree(rough, ignore_errors=True)
    began = time.monotonic()
    if run(options, data, calm).wait() != 0:
        return failure("the undisturbed experiment has failed")
    print(f"undisturbed: {time.monotonic() - began:.0f} s")
    began = time.monotonic()
    driver = run(options, data, rough)
    done = len(outcomes(calm))
    victim = wait_until(lambda: len(outcomes(rough)) >= 1 and at_work(rough), driver)[0]
    print(f"killing the worker of {victim.path.name} in its stage {victim.stage}", flush=True)
    killed = victim.worker["process"]
    os.kill(killed, signal.SIGKILL)
    wait_until(lambda: victim.worker["process"] != killed, driver)
    wait_until(lambda: len(outcomes(rough)) >= done // 2 and at_work(rough), driver)
    stages = ", ".join(f"{folder.path.name} in {folder.stage}" for folder in busy(rough))
    print(f"killing the driver after {len(outcomes(rough))} of {done} jobs; at work: {stages}", flush=True)
    driver.send_signal(signal.SIGKILL)
    driver.wait()
    if run(options, data, rough).wait() != 0:
        return failure("the resumed experiment has failed")
    print(f"killed twice and resumed: {time.monotonic() - began:.0f} s")
    return compare(calm, rough)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--work", type=Path, default=Path("run/interrupted"), help="folder of data and experiments"
    )
    parser.add_argument("--size", default="160x120", help="of the images (default 160x120)")
    parser.add_argument("--views", type=int, default=15, help="of each situation (default 15)")
    parser.add_argument("--iterations", default="300", help="of each fit (default 300)")
    parser.add_argument("--workers", default="2", help="jobs at a time (default 2)")
    parser.add_argument("--no-ray", dest="ray", action="store_false", help="worker processes in place of Ray")
    return parser.parse_args()


def diga3d(*words: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, "-m", "diga3d_warp.cli", *words])


def run(options: argparse.Namespace, data: Path, out: Path) -> subprocess.Popen[bytes]:
    return diga3d(
        "experiment", "table1", "table3", "table4", "--data", str(data), "--out", str(out), "--iterations",
        options.iterations, "--workers", options.workers, "--ray" if options.ray else "--no-ray",
    )  # fmt: skip


def outcomes(out: Path) -> list[Path]:
    return list((out / JOBS).glob("*/outcome.json"))


def at_work(out: Path) -> list[JobFolder]:
    """Jobs in a stage that takes a while."""
    return [folder for folder in busy(out) if folder.stage in LONG]


def busy(out: Path) -> list[JobFolder]:
    """Jobs that a process works on, in one of their stages."""
    folders = [JobFolder.open(path.parent) for path in (out / JOBS).glob("*/worker.json")]
    return [folder for folder in folders if folder.stage and not (folder.path / "outcome.json").exists()]


def wait_until(happened: Callable[[], Any], driver: subprocess.Popen[bytes]) -> Any:
    while not (found := happened()):
        if driver.poll() is not None:
            raise SystemExit("the experiment ended before it could be killed: use larger images")
        time.sleep(0.1)
    return found


def compare(calm: Path, rough: Path) -> int:
    """Compare all files of two experiments."""
    files = [
        {
            path.relative_to(out): path.read_bytes()
            for path in out.rglob("*")
            if path.is_file() and path.name not in DIFFERS and not path.name.startswith(".")
        }
        for out in (calm, rough)
    ]
    only = sorted(files[0].keys() ^ files[1].keys())
    other = sorted(name for name in files[0].keys() & files[1].keys() if files[0][name] != files[1][name])
    for name in [*only, *other]:
        print(f"differs: {name}")
    if only or other:
        return failure(f"{len(only) + len(other)} of {len(files[0])} files differ")
    size = sum(map(len, files[0].values())) / 2**20
    print(f"{len(files[0])} files of {size:.0f} MiB are the same")
    return 0


def failure(line: str) -> int:
    print(line, file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
