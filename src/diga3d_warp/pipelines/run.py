"""Run: a folder of named stages that can be resumed after being killed at any moment.

A stage writes into `stages/.NAME.partial`, which is renamed to `stages/NAME` when the stage is done. The
partial folder of a killed stage is kept, so that the stage can continue from its own checkpoint. Renaming a
folder is atomic, so `stages/NAME` exists exactly if the stage is finished.
"""

from __future__ import annotations

import os
import platform
import shlex
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from diga3d_warp.config import NO_EFFECT, Effects
from diga3d_warp.errors import InputError, explained, out_of_memory
from diga3d_warp.evaluation.record import MANIFEST, add_metrics, read_manifest
from diga3d_warp.files import whole_file, write_json
from diga3d_warp.pipelines import run_folder, stage_folder
from diga3d_warp.pipelines.machine import describe_machine, package_versions, peak_mib, reset_peak
from diga3d_warp.scene.working_frame import IDENTITY
from diga3d_warp.state import STAGES, compute_again

if TYPE_CHECKING:
    from filelock import FileLock


NAMED = 6
"""Most settings that the error names if those of a resumed run differ."""


class Run:
    """A run folder, locked by this process.

    Attributes:
        folder: The run folder.
        command: What is run: the name of the subcommand.
        settings: Everything that the result depends on, as JSON data; a path in it is absolute.
        effects: Effects that its stages simulate; set by `stages.begin`.
        frame: Working frame of its stages; set by `stages.begin`.
    """

    _held: FileLock | None = None

    def __init__(
        self, folder: Path, command: str, settings: Mapping[str, Any], *, resume: bool = False
    ) -> None:
        """Start a run, or resume one.

        Args:
            folder: Made if absent.
            command: What is run: the name of the subcommand.
            settings: Everything that the result depends on: numbers, strings, None, paths, and lists of them.
                `diga3d eval` and `diga3d render` read "scene", "masks", "image_scale" and "hold_out".
            resume: Resume the run in `folder`; start one if there is none.

        Raises:
            InputError: the folder cannot be written, holds other things or another run, belongs to the
                capture, is in use by another process, or is damaged; or the run in it was started with other
                settings.
        """
        self.folder = folder
        self.command = command
        self.effects = Effects()
        self.frame = IDENTITY
        self.settings = {key: _json_value(value) for key, value in settings.items()}
        self._began = time.perf_counter()
        if settings.get("scene"):
            masks = settings.get("masks")
            run_folder.check_apart(folder, Path(settings["scene"]), Path(masks) if masks else None)
        run_folder.make_writable(folder)
        self._check_place(resume)
        unlocked = self._lock()
        begun = self._check_place(resume)  # another process may have started or ended meanwhile
        if begun:
            self._manifest = read_manifest(folder)
            self._check_same_run()
            run_folder.refuse_links(folder)
        else:
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
        self._manifest["process"] = {"number": os.getpid(), "host": platform.node()}
        self._manifest["reading_mib"] = max(peak_mib(), self._manifest.get("reading_mib", 0))
        self._write_manifest()
        say(f"reading: peak memory {peak_mib()} MiB")
        if unlocked:
            self.note(unlocked)
        if begun:
            self._note_other_versions()

    def hold_to(self, **further: Any) -> None:
        """Record further settings that the result depends on; on resuming, compare them with the manifest.

        Args:
            further: As the settings in `__init__`, and dataclasses and mappings of such.

        Raises:
            InputError: the run was started with other ones.
        """
        now = {key: _json_value(value) for key, value in further.items()}
        begun = self._manifest.setdefault("held_to", {})
        known = now.keys() & begun.keys()
        self._refuse_other({key: begun[key] for key in known}, {key: now[key] for key in known})
        begun.update(now)
        self._write_manifest()

    def stage(self, name: str, compute: Callable[[Path], None]) -> Path:
        """Run a stage, unless it is finished already.

        Args:
            name: Names the stage and its folder; lower case, unique in the run.
            compute: Writes the stage's products into the folder it is given. The folder holds what a killed
                attempt left there. It must give the same bytes whether it was interrupted or not.

        Returns:
            The folder of the finished stage.

        Raises:
            InputError: the files of the stage from an earlier process are damaged, or the system refuses a
                file or memory. The partial folder of the stage is kept.
        """
        done = self.folder / STAGES / name
        partial = done.with_name(f".{name}.partial")
        for place in (done, partial):
            if place.exists() and not place.is_dir():
                raise InputError(f"{place} is no folder: {compute_again(place)}")
        if done.is_dir():
            say(f"{name}: finished earlier")
            timing = stage_folder.take_up(done)
        else:
            resumed = partial.is_dir()
            say(f"{name}: going on" if resumed else name)
            timing = self._compute(compute, partial, done, resumed)
            say(f"{name}: {timing['seconds']:.1f} s, peak memory {timing['peak_mib']} MiB")
        others = [stage for stage in self._manifest["stages"] if stage["name"] != name]
        self._manifest["stages"] = [*others, {"name": name, **timing}]
        self._write_manifest()
        return done

    def note(self, line: str) -> None:
        """Print a warning, once, and keep it in the manifest."""
        if line not in self._manifest["notes"]:
            say(f"note: {line}")
            self._manifest["notes"].append(line)
            self._write_manifest()

    def record(self, subject: str, data: Any) -> None:
        """Put JSON data under `subject` into the manifest."""
        self._manifest[subject] = data
        self._write_manifest()

    def recorded(self, subject: str) -> Any:
        """What `record` put there."""
        return self._manifest[subject]

    def publish(self, source: Path, name: str) -> Path:
        """Copy a stage's product to `name` in the run folder."""
        target = self.folder / name
        run_folder.refuse_link_above(target, self.folder)
        with whole_file(target) as partial:
            shutil.copyfile(source, partial)
        return target

    def add_metrics(self, subject: str, figures: Any) -> None:
        """Put measured figures into metrics.json under `subject`."""
        add_metrics(self.folder, subject, figures)

    def close(self) -> None:
        """Release the lock of the folder."""
        if self._held is not None:
            self._held.release()
            self._held = None

    def __del__(self) -> None:
        self.close()

    def _lock(self) -> str | None:
        """Lock the folder; returns a note if the file system has no locks, else None."""
        try:
            self._held = run_folder.hold(self.folder)
        except (OSError, NotImplementedError):
            return f"{self.folder} cannot be locked: let no second process use it"
        return None

    def _check_place(self, resume: bool) -> bool:
        """Whether the folder holds a run already."""
        if not (self.folder / MANIFEST).exists():
            run_folder.check_empty(self.folder)
            return False
        if not resume:
            raise InputError(
                f"{self.folder} already holds a run: add --resume to go on with it, or choose another --out"
            )
        return True

    def _compute(
        self, compute: Callable[[Path], None], partial: Path, done: Path, resumed: bool
    ) -> stage_folder.Timing:
        self._note_peak()
        reset_peak()
        start = time.perf_counter()
        try:
            partial.mkdir(parents=True, exist_ok=True)
            compute(partial)
            timing = stage_folder.Timing(
                seconds=round(time.perf_counter() - start, 3), peak_mib=peak_mib(), resumed=resumed
            )
            stage_folder.finish(partial, done, timing)
        except Exception as error:
            if lacking := out_of_memory(error):
                raise InputError(
                    f"stage {done.name}: {lacking}: close other programs and go on with --resume, or begin "
                    "anew with a smaller --image-scale"
                ) from error
            if isinstance(error, OSError) and not isinstance(error, BrokenPipeError):
                raise explained(error, self._owns, partial) from error
            raise
        return timing

    def _owns(self, path: Path) -> bool:
        return path.absolute().is_relative_to(self.folder.absolute())

    def _note_peak(self) -> None:
        self._manifest["peak_mib"] = max(peak_mib(), self._manifest.get("peak_mib", 0))

    def _write_manifest(self) -> None:
        seconds = self._earlier_seconds + time.perf_counter() - self._began
        self._manifest["seconds"] = round(seconds, 3)
        self._note_peak()
        write_json(self.folder / MANIFEST, self._manifest)

    def _check_same_run(self) -> None:
        self._refuse_other(
            {"command": self._manifest["command"], **self._manifest["settings"]},
            {"command": self.command, **self.settings},
        )

    def _refuse_other(self, before: Mapping[str, Any], now: Mapping[str, Any]) -> None:
        """Refuse settings that differ from those that the run was started with."""
        first, second = dict(_leaves(before)), dict(_leaves(now))
        different = [
            f"{key} = {first.get(key)!r} (now {second.get(key)!r})"
            for key in dict.fromkeys([*first, *second])
            if first.get(key) != second.get(key)
        ]
        if different:
            more = f" and {len(different) - NAMED} more" if len(different) > NAMED else ""
            raise InputError(
                f"{self.folder} was begun with other settings: {', '.join(different[:NAMED])}{more}; "
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
    """A setting as JSON stores it, so that it compares equal when read back.

    Fields of dataclasses that are marked `NO_EFFECT` are left out.
    """
    if isinstance(value, os.PathLike):
        return str(Path(value).resolve())
    if is_dataclass(value) and not isinstance(value, type):
        bearing = [each.name for each in fields(value) if each.metadata != NO_EFFECT]
        return {name: _json_value(getattr(value, name)) for name in bearing}
    if isinstance(value, Mapping):
        return {str(key): _json_value(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_json_value(item) for item in value]
    return value


def _leaves(data: Mapping[str, Any], place: str = "") -> Iterator[tuple[str, Any]]:
    """Values in nested settings, by their place, such as "settings.fit.budget"."""
    for key, value in data.items():
        name = f"{place}.{key}" if place else key
        if isinstance(value, Mapping) and value:
            yield from _leaves(value, name)
        else:
            yield name, value
