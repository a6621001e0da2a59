"""A job: one run of one scene and its figures, and the folder that keeps both.

    jobs/NAME/
        job.json      what is run
        worker.json   process that works on it, or did last
        log.txt       what it said
        run/          an ordinary run folder
        outcome.json  figures or an error; written last, so the job is done exactly if it is there

The name ends with a digest of everything that the result depends on: another setting is another job, and
jobs of several experiments in one folder never mix.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, TypedDict

from diga3d_warp.errors import InputError
from diga3d_warp.files import write_json
from diga3d_warp.state import misfit, read_state

Command = Literal["fit", "remove", "retexture", "replace"]

Size = Literal["published"] | int | None
"""Image size of a job: that on which the figures of the scene's data set are measured, a length of the short
side [px], or None for the option `image_scale`."""

JOBS = "jobs"
RUN = "run"
LOG = "log.txt"

NAME_LENGTH = 60
"""Letters of a job's name before its digest: with the names of a run's files below it, paths stay shorter
than Windows' 260."""


class JobRecord(TypedDict):
    """A job in job.json; see `Job`."""

    command: Command
    scene: str
    options: dict[str, Any]
    size: Any
    source_prompt: str | None
    edit_prompt: str | None
    weights: str | None


class WorkerRecord(TypedDict):
    """The process that works on a job."""

    process: int
    host: str


class Outcome(TypedDict):
    """What came of a job.

    Attributes:
        error: Why there are no figures, in one line; None if there are.
        figures: Means over the test views by metric and region; None for an infinite PSNR.
        missing: Metrics that were not measured, and what each lacks.
        protocol: As in `evaluation.protocols`; None without test views.
        views: Number of test views.
        size: Width and height of the first view [px]; empty after an error.
        version: Version of this program.
    """

    error: str | None
    figures: dict[str, dict[str, float | None]]
    missing: dict[str, str]
    protocol: str | None
    views: int
    size: list[int]
    version: str


@dataclass(frozen=True)
class Job:
    """One run of one scene.

    Attributes:
        command: The subcommand of `diga3d`.
        scene: Folder or file of the capture, absolute.
        options: Attributes of `FitRequest` or `EditRequest`, as JSON data; paths are absolute.
        size: Image size.
        source_prompt, edit_prompt: What the scene shows before and after the edit, for CLIP_dir.
        weights: Folder with the weights of the metrics.
    """

    command: Command
    scene: str
    options: Mapping[str, Any] = field(default_factory=dict)
    size: Size = None
    source_prompt: str | None = None
    edit_prompt: str | None = None
    weights: str | None = None

    @property
    def scene_name(self) -> str:
        """The scene in tables."""
        return Path(self.scene).name or self.scene

    @property
    def name(self) -> str:
        """Name of the job's folder."""
        described = json.dumps(asdict(self), sort_keys=True).encode()
        words = " ".join([self.scene_name, self.command, str(self.options.get("prompt") or "")])
        readable = re.sub(r"[^\w.]+", "-", words, flags=re.ASCII).strip("-.").lower()
        return (
            f"{readable[:NAME_LENGTH].rstrip('-.')}-{hashlib.blake2b(described, digest_size=5).hexdigest()}"
        )


class JobFolder:
    """The folder of a job.

    Args:
        out: Folder of all jobs.
        job: The job.
    """

    def __init__(self, out: Path, job: Job) -> None:
        self.job = job
        self.path = out / JOBS / job.name
        self.run = self.path / RUN

    @classmethod
    def open(cls, path: Path) -> JobFolder:
        """The folder at a path, with the job that it describes.

        Raises:
            InputError: it describes none, or is not visible from this machine.
        """
        again = f"delete {path} and give the same command again"
        if not (path / "job.json").is_file():
            raise InputError(
                f"{path} is not there on this machine: choose an --out that all machines of the cluster share"
            )
        folder = cls(path.parent.parent, Job(**read_state(path / "job.json", JobRecord, again)))
        if folder.path.name != path.name:
            raise InputError(f"{path / 'job.json'} was edited: {again}")
        return folder

    def describe(self) -> None:
        """Write job.json, unless it is there."""
        if not (self.path / "job.json").is_file():
            write_json(self.path / "job.json", asdict(self.job))

    @property
    def outcome(self) -> Outcome | None:
        """What came of the job; None if it is not done.

        Raises:
            InputError: the file is damaged.
        """
        path = self.path / "outcome.json"
        if not path.is_file():
            return None
        return read_state(path, Outcome, "delete it and give the same command again")

    def end(self, outcome: Outcome) -> None:
        """Write what came of the job."""
        write_json(self.path / "outcome.json", outcome)

    def reopen(self) -> None:
        """Forget an error, and who worked on it, so that the job is tried again; its run goes on."""
        for name in ("outcome.json", "worker.json"):
            (self.path / name).unlink(missing_ok=True)

    @property
    def worker(self) -> WorkerRecord | None:
        """The process that works on the job; None if none has started."""
        try:
            record = json.loads((self.path / "worker.json").read_bytes())
        except (OSError, ValueError):
            return None
        return record if misfit(record, WorkerRecord) is None else None

    @property
    def stage(self) -> str:
        """The stage that its run is in; empty between stages."""
        partial = next((self.run / "stages").glob(".*.partial"), None)
        return "" if partial is None else partial.name.removeprefix(".").removesuffix(".partial")


def failed(error: str, version: str) -> Outcome:
    """The outcome of a job that ended with an error."""
    return Outcome(
        error=" ".join(error.split()), figures={}, missing={}, protocol=None, views=0, size=[],
        version=version,
    )  # fmt: skip
