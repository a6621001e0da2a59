"""What a run folder records, and how to read it back: manifest and metrics.

The folder holds
    point_cloud.ply   the result, standard 3DGS
    source.ply        the splat before the edit, where there was one
    cameras.json      the training and test cameras, for 3DGS viewers too
    views/            pictures: before/NAME.png, after/NAME.png
    masks/            the masks that were used: NAME.png, white = edited
    stages/           products of each finished stage, what --resume needs
    metrics.json      measured figures by subject
    manifest.json     command, settings, effects and why, versions, machine, notes, stages with seconds and
                      peak memory
    report.html       all of it on one page
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, Literal, TypedDict

from diga3d_warp.config import Effects
from diga3d_warp.errors import InputError
from diga3d_warp.files import write_json
from diga3d_warp.state import misfit, read_state

RESULT = "point_cloud.ply"
SOURCE = "source.ply"
CAMERAS = "cameras.json"
METRICS = "metrics.json"
MANIFEST = "manifest.json"
REPORT = "report.html"

REMEDY = "give the --out folder of a finished run, such as that of `diga3d remove`"


class StageRecord(TypedDict):
    """A finished stage in the manifest.

    Attributes:
        name: Name of the stage.
        seconds: Time spent [s].
        peak_mib: Peak resident memory of the process during the stage [MiB].
        resumed: Whether it continued from the files of an interrupted process.
    """

    name: str
    seconds: float
    peak_mib: float
    resumed: bool


class TableRecord(TypedDict):
    """A table, see `tables.Table`."""

    title: str
    columns: list[str]
    rows: list[list[str]]


class ChoiceRecord(TypedDict):
    """An effect and what was chosen, see `effects.plan.Choice`."""

    effect: str
    value: bool | Literal[0, 1, 2, 3]


class EffectsChosen(TypedDict):
    """What a run simulates."""

    choices: list[ChoiceRecord]


class EffectsRecord(EffectsChosen, total=False):
    """What a scene called for and why, see `effects.plan.EffectsPlan`."""

    notes: list[str]
    table: TableRecord


class SettingsRecord(TypedDict, total=False):
    """Those settings of a run that commands read back."""

    scene: str
    masks: str | None
    image_scale: float
    hold_out: int
    prompt: str | None
    asset: str | None


class ProcessRecord(TypedDict):
    """A process, by its number and the name of its machine."""

    number: int
    host: str


class ManifestBegun(TypedDict):
    """Keys that a manifest has from the start of a run."""

    command: str
    command_line: str
    settings: SettingsRecord
    versions: dict[str, str]
    machine: dict[str, Any]
    seconds: float
    stages: list[StageRecord]
    notes: list[str]


class Manifest(ManifestBegun, total=False):
    """The manifest of a run. Other keys are allowed and not read.

    Attributes:
        process: The one that wrote it last.
        peak_mib: Largest resident memory of all processes of the run, from their start on [MiB].
        reading_mib: The same until the first stage: mostly that of reading the capture.
        effects: What the scene called for.
        held_to: All settings, and digests of the capture: --resume refuses other ones.
    """

    process: ProcessRecord
    peak_mib: float
    reading_mib: float
    effects: EffectsRecord
    held_to: dict[str, Any]


class ScoreRecord(TypedDict):
    """Figures of one comparison, see `metrics.Score`."""

    psnr: float | None
    ssim: float


class ComparisonRecord(TypedDict):
    """Pictures compared view by view, see `protocols.Comparison`."""

    title: str
    mean: dict[str, ScoreRecord]
    views: dict[str, dict[str, ScoreRecord]]


class EvaluationBegun(TypedDict):
    """Keys that every evaluation has, see `protocols.evaluate`."""

    protocol: str
    image_scale: float
    comparisons: list[ComparisonRecord]


class GatheringRecord(TypedDict):
    """Perceptual figures by metric and region, see `perceptual.Gathering`; `pictures` are those of FID."""

    mean: dict[str, dict[str, float]]
    views: dict[str, dict[str, dict[str, float]]]
    pictures: int


class CorrsRecord(TypedDict):
    """Correspondences of frames, see `correspondences.Corrs`."""

    whole: float
    masked: float | None


class FramesRecord(TypedDict):
    """Correspondences of the frames of one splat or fill, by matcher."""

    title: str
    pairs: int
    matches: dict[str, CorrsRecord]


class FramesRecords(TypedDict):
    """What `frames.corrs_of_run` counted; the size is width and height [px]."""

    size: list[int]
    rows: list[FramesRecord]


class PerceptualRecord(TypedDict):
    """Perceptual figures of an evaluation by comparison, and what each metric that is missing lacks."""

    missing: dict[str, str]
    comparisons: dict[str, GatheringRecord]
    corrs: FramesRecords


class EvaluationRecord(EvaluationBegun, total=False):
    """Figures of an evaluation.

    Attributes:
        unmasked_loss_db: PSNR that the edit cost where it should have changed nothing [dB].
        perceptual: What `diga3d eval` measures beside PSNR and SSIM.
    """

    unmasked_loss_db: float | None
    perceptual: PerceptualRecord


class PointRecord(TypedDict):
    """A point of a curve; its other keys are what the curves show."""

    iteration: float


class CurveRecord(TypedDict, total=False):
    """Figures of a stage, a curve among them if it was a fit."""

    curve: list[PointRecord]


class MetricsRecord(TypedDict, total=False):
    """Figures by subject; subjects that are not named here may have a curve."""

    evaluation: EvaluationRecord
    tables: list[TableRecord]


def read_manifest(folder: Path) -> dict[str, Any]:
    """The manifest of a run, a `Manifest`.

    Raises:
        InputError: the folder is absent or holds no run, or its manifest is damaged.
    """
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder: {REMEDY}")
    path = folder / MANIFEST
    if not path.exists():
        raise InputError(f"{folder} holds no run ({MANIFEST} is missing): {REMEDY}")
    again = f"delete {folder} and run again; nothing says how its stages came about"
    manifest: dict[str, Any] = dict(read_state(path, Manifest, again))
    if "table" in manifest.get("effects", {}):
        _check_rows(path, manifest["effects"]["table"], again)
    return manifest


def running_process(folder: Path) -> ProcessRecord | None:
    """The process that wrote the manifest of a run last; None if that cannot be read."""
    try:
        process = json.loads((folder / MANIFEST).read_bytes())["process"]
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        return None
    return process if misfit(process, ProcessRecord) is None else None


def run_effects(manifest: Mapping[str, Any]) -> Effects:
    """The effects with which a run's splats were fitted and are to be rendered, without depth.

    Args:
        manifest: Of the run; one that names no effects was rendered with the defaults and nothing behind.
    """
    choices = manifest.get("effects", {}).get("choices", [])
    chosen = {choice["effect"]: choice["value"] for choice in choices}
    unknown = sorted(chosen.keys() - {effect.name for effect in fields(Effects)})
    if unknown:
        raise InputError(f"the run has an effect that is not known here ({unknown[0]}): {REMEDY}")
    return Effects(**{"background": False, **chosen, "depth": False})


def read_metrics(folder: Path) -> dict[str, Any]:
    """The figures measured so far by subject, a `MetricsRecord`; empty if none were.

    Raises:
        InputError: the file is damaged.
    """
    path = folder / METRICS
    if not path.exists():
        return {}
    again = f"delete it, then measure again with --resume or `diga3d eval {folder}`"
    metrics: dict[str, Any] = dict(read_state(path, MetricsRecord, again))
    for subject, figures in metrics.items():
        wrong = misfit(figures, CurveRecord, subject) if isinstance(figures, dict) else None
        if wrong is not None:
            raise InputError(f"{path} is damaged ({wrong}): {again}")
    for table in metrics.get("tables", []):
        _check_rows(path, table, again)
    return metrics


def _check_rows(path: Path, table: TableRecord, remedy: str) -> None:
    if any(len(row) != len(table["columns"]) for row in table["rows"]):
        raise InputError(f"{path} is damaged (a row of a table has too many or too few cells): {remedy}")


def add_metrics(folder: Path, subject: str, figures: Any) -> None:
    """Put the figures of one subject into metrics.json and keep those of the others.

    Args:
        folder: The run folder.
        subject: "fit", "evaluation", "tables" and so on.
        figures: JSON data, no NaN or infinity.
    """
    write_json(folder / METRICS, {**read_metrics(folder), subject: figures})
