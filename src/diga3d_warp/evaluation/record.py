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

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from diga3d_warp.config import Effects
from diga3d_warp.errors import InputError
from diga3d_warp.files import read_json, write_json

RESULT = "point_cloud.ply"
SOURCE = "source.ply"
CAMERAS = "cameras.json"
METRICS = "metrics.json"
MANIFEST = "manifest.json"
REPORT = "report.html"

REMEDY = "give the --out folder of a finished run, such as that of `diga3d remove`"


def read_manifest(folder: Path) -> dict[str, Any]:
    """The manifest of a run.

    Raises:
        InputError: the folder is absent or holds no run.
    """
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder: {REMEDY}")
    if not (folder / MANIFEST).is_file():
        raise InputError(f"{folder} holds no run ({MANIFEST} is missing): {REMEDY}")
    manifest = read_json(folder / MANIFEST, REMEDY)
    if not isinstance(manifest, dict) or not isinstance(manifest.get("settings"), dict):
        raise InputError(f"{folder / MANIFEST} is not the manifest of a run (no settings): {REMEDY}")
    return manifest


def run_effects(manifest: Mapping[str, Any]) -> Effects:
    """The effects with which a run's splats were fitted and are to be rendered, without depth.

    Args:
        manifest: Of the run; one that names no effects was rendered with the defaults and nothing behind.
    """
    choices = manifest.get("effects", {}).get("choices", [])
    chosen = {choice["effect"]: choice["value"] for choice in choices}
    return Effects(**{"background": False, **chosen, "depth": False})


def read_metrics(folder: Path) -> dict[str, Any]:
    """The figures measured so far, by subject; empty if none were."""
    if not (folder / METRICS).is_file():
        return {}
    return read_json(folder / METRICS, "delete it and evaluate again")


def add_metrics(folder: Path, subject: str, figures: Any) -> None:
    """Put the figures of one subject into metrics.json and keep those of the others.

    Args:
        folder: The run folder.
        subject: "fit", "evaluation", "tables" and so on.
        figures: JSON data, no NaN or infinity.
    """
    write_json(folder / METRICS, {**read_metrics(folder), subject: figures})
