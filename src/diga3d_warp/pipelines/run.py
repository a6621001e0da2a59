"""Run: a folder of named stages that survives a kill at any moment and resumes.

A stage writes into `stages/.NAME.partial` and is renamed to `stages/NAME` when it is done. What a killed
stage left in its partial folder stays, so that it can go on from its own checkpoint. Renaming a folder is
atomic, so `stages/NAME` exists exactly if the stage is finished; its seconds and memory lie inside it.
"""

from __future__ import annotations

import os
import shlex
import shutil
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from diga3d_warp.config import Effects
from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.record import MANIFEST, add_metrics, read_manifest
from diga3d_warp.files import cannot_write, read_json, sync, whole_file, write_json
from diga3d_warp.pipelines.machine import describe_machine, package_versions, peak_mib, reset_peak

PROBE = ".manifest.partial.json"
"""What a process killed at its very start may leave: the manifest's temporary name (see `files`)."""

TIMING = "stage.json"
"""Seconds and memory of a stage, inside its folder, so that they become final together with it."""


class Run:
    """A run folder being filled.

    Attributes:
        folder: Where everything goes.
        command: What is run: the name of the subcommand.
        settings: Everything that the result depends on, as JSON data; a path in it is absolute.
        effects: What its stages simulate; `stages.begin` decides.
    """

    def __init__(
        self, folder: Path, command: str, settings: Mapping[str, Any], *, resume: bool = False
    ) -> None:
        """Begin a run, or go on with one.

        Args:
            folder: Made if absent.
            command: What is run: the name of the subcommand.
            settings: Everything that the result depends on: numbers, strings, None, paths, and lists of them.
                `diga3d eval` and `diga3d render` read "scene", "masks", "image_scale" and "hold_out".
            resume: Go on with the run in `folder`; where none has begun, begin one.

        Raises:
            InputError: the folder cannot be written, holds other things or another run, or the run in it was
                begun with other settings.
        """
        self.folder = folder
        self.command = command
        self.effects = Effects()
        self.settings = {key: _json_value(value) for key, value in settings.items()}
        self._began = time.perf_counter()
        _make_writable(folder)
        begun = (folder / MANIFEST).exists()
        if begun and not resume:
            raise InputError(
                f"{folder} already holds a run: add --resume to go on with it, or choose another --out"
            )
        if begun:
            self._manifest = read_manifest(folder)
            self._check_same_run()
        else:
            _check_empty(folder)
            if resume:
                say(f"nothing to resume in {folder}: starting")
            self._manifest = {
                "command": command,
                "command_line": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
                "settings": self.settings,
                "versions": package_versions(),
                "machine": describe_machine(),
                "started": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
                "seconds": 0.0,
                "stages": [],
                "notes": [],
            }
        self._earlier_seconds = float(self._manifest["seconds"])
        self._write_manifest()
        if begun:
            self._note_other_versions()

    def stage(self, name: str, compute: Callable[[Path], None]) -> Path:
        """Run a stage, unless it is finished already.

        Args:
            name: Names the stage and its folder; lower case, unique in the run.
            compute: Writes the stage's products into the folder it is given. The folder holds what a killed
                attempt left there. It must give the same bytes whether it was interrupted or not.

        Returns:
            The folder of the finished stage.
        """
        done = self.folder / "stages" / name
        if done.is_dir():
            say(f"{name}: finished earlier")
        else:
            partial = done.with_name(f".{name}.partial")
            resumed = partial.is_dir()
            say(f"{name}: going on" if resumed else name)
            self._compute(compute, partial, done, resumed)
        timing = read_json(done / TIMING, f"delete {done} and use --resume to compute it again")
        others = [stage for stage in self._manifest["stages"] if stage["name"] != name]
        self._manifest["stages"] = [*others, {"name": name, **timing}]
        self._write_manifest()
        return done

    def note(self, line: str) -> None:
        """Tell the user a warning, once, and keep it in the manifest."""
        if line not in self._manifest["notes"]:
            say(f"note: {line}")
            self._manifest["notes"].append(line)
            self._write_manifest()

    def record(self, subject: str, data: Any) -> None:
        """Put what was decided on the way, JSON data, into the manifest."""
        self._manifest[subject] = data
        self._write_manifest()

    def publish(self, source: Path, name: str) -> Path:
        """Copy a stage's product to `name` in the run folder."""
        target = self.folder / name
        with whole_file(target) as partial:
            shutil.copyfile(source, partial)
        return target

    def add_metrics(self, subject: str, figures: Any) -> None:
        """Put measured figures into metrics.json under `subject`."""
        add_metrics(self.folder, subject, figures)

    def _compute(self, compute: Callable[[Path], None], partial: Path, done: Path, resumed: bool) -> None:
        partial.mkdir(parents=True, exist_ok=True)
        reset_peak()
        start = time.perf_counter()
        try:
            compute(partial)
        except OSError as error:
            raise cannot_write(Path(error.filename or partial), error) from error
        timing = {
            "seconds": round(time.perf_counter() - start, 3),
            "peak_mib": peak_mib(),
            "resumed": resumed,
        }
        write_json(partial / TIMING, timing)
        sync(partial)
        partial.rename(done)
        say(f"{done.name}: {timing['seconds']:.1f} s, peak memory {timing['peak_mib']} MiB")

    def _write_manifest(self) -> None:
        seconds = self._earlier_seconds + time.perf_counter() - self._began
        self._manifest["seconds"] = round(seconds, 3)
        write_json(self.folder / MANIFEST, self._manifest)

    def _check_same_run(self) -> None:
        before: dict[str, Any] = {"command": self._manifest.get("command"), **self._manifest["settings"]}
        now: dict[str, Any] = {"command": self.command, **self.settings}
        different = [
            f"{key} = {before.get(key)!r} (now {now.get(key)!r})"
            for key in [*before, *(key for key in now if key not in before)]
            if before.get(key) != now.get(key)
        ]
        if different:
            raise InputError(
                f"{self.folder} was begun with other settings: {', '.join(different)}; "
                "resume with the same ones, or choose another --out"
            )

    def _note_other_versions(self) -> None:
        for name, version in package_versions().items():
            before = self._manifest["versions"].get(name)
            if before != version:
                self.note(f"resumed with {name} {version}, begun with {before}: bytes may differ")


def say(line: str) -> None:
    """A line on stderr, as `diga3d` writes them."""
    print(f"diga3d: {line}", file=sys.stderr, flush=True)


def sampling_bar(label: str) -> Callable[[int, int], None]:
    """A bar on stderr, to be called after each timestep with how many are done and how many there are."""
    from tqdm import tqdm

    bar: tqdm | None = None

    def progress(done: int, total: int) -> None:
        nonlocal bar
        if bar is None:
            bar = tqdm(desc=label, unit="step", total=total, dynamic_ncols=True)
        bar.update(done - bar.n)
        if done == total:
            bar.close()
            bar = None

    return progress


def _json_value(value: Any) -> Any:
    """A setting as JSON stores it, so that it compares equal when read back."""
    if isinstance(value, os.PathLike):
        return str(Path(value).resolve())
    if isinstance(value, (list, tuple)):
        return [_json_value(item) for item in value]
    return value


def _make_writable(folder: Path) -> None:
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} is a file: choose a folder for --out")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # Permission bits do not tell of read-only file systems, nor what root may do: only writing does.
        probe = folder / PROBE
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise cannot_write(folder, error) from error


def _check_empty(folder: Path) -> None:
    foreign = sorted(entry.name for entry in folder.iterdir() if entry.name != PROBE)
    if foreign:
        raise InputError(
            f"{folder} holds no run, but other things ({foreign[0]}): choose a new or empty folder for --out"
        )
