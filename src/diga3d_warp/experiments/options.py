"""Options of jobs as files name them: attributes of the requests, checked, with paths made absolute."""

from __future__ import annotations

import functools
import operator
import types
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Union, get_args, get_origin, get_type_hints

from diga3d_warp.errors import InputError
from diga3d_warp.experiments.job import Command, Job
from diga3d_warp.experiments.yaml_file import refuse_unknown
from diga3d_warp.state import misfit

OWN = ("scene", "out", "resume")
"""Attributes of a request that a job sets itself."""

SCENE = "{scene}"
"""Stands for the scene's folder in a path."""


def checked_options(path: Path, command: Command, options: Mapping[str, Any]) -> dict[str, Any]:
    """Options of a job, with paths made absolute.

    Args:
        path: The file that names them; paths in them are relative to its folder.
        command: The subcommand that takes them.
        options: By name, as on the command line without the leading dashes or as in Python.

    Raises:
        InputError: an option is unknown, or its value is not of its kind.
    """
    hints = _hints(command)
    named = {name.replace("-", "_"): value for name, value in options.items()}
    refuse_unknown(path, named, hints, "option ")
    for name, value in named.items():
        wrong = misfit(value, _json_form(hints[name]), name)
        if wrong is not None:
            raise InputError(f"{path}: option {wrong}: see `diga3d {command} --help`")
    return {name: _placed(name, value, hints[name], path.parent) for name, value in named.items()}


def in_scene(options: Mapping[str, Any], scene: Path) -> dict[str, Any]:
    """Options with the folder of a scene put in for `SCENE`."""

    def put(value: Any) -> Any:
        if isinstance(value, list):
            return [put(each) for each in value]
        return value.replace(SCENE, str(scene)) if isinstance(value, str) else value

    return {name: put(value) for name, value in options.items()}


def check_jobs(jobs: Sequence[Job]) -> None:
    """Refuse options that no scene could be run with, before any is.

    Raises:
        InputError: a value is out of range, or a prior is not here or cannot do what is asked.
    """
    from diga3d_warp.pipelines.free_text import reads_free_text
    from diga3d_warp.pipelines.request import EditRequest, FitRequest

    seen = set()
    for job in jobs:
        alike = {name: value for name, value in job.options.items() if name not in ("prompt", "seed")}
        described = f"{job.command} {sorted(alike.items())}"
        if described in seen:
            continue
        seen.add(described)
        if job.command == "fit":
            FitRequest(scene=job.scene, out="run", **job.options)
            continue
        request = EditRequest(scene=job.scene, out="run", **job.options)
        if job.command == "remove":
            prompt = request.prompt if reads_free_text(request) else None
            request.choose_method(request.load_prior("remove", prompt or ""))


@cache
def _hints(command: Command) -> dict[str, Any]:
    from diga3d_warp.pipelines.request import EditRequest, FitRequest

    hints = get_type_hints(FitRequest if command == "fit" else EditRequest)
    return {name: hint for name, hint in hints.items() if name not in OWN}


def _json_form(hint: Any) -> Any:
    """The form that `misfit` knows of a type hint: lists for sequences, texts for paths."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        return functools.reduce(operator.or_, (_json_form(part) for part in parts))
    if origin is Sequence:
        return list[_json_form(parts[0])]  # type: ignore[misc]
    if origin is Mapping:
        return dict[str, _json_form(parts[1])]  # type: ignore[misc]
    if origin is None and hint not in (bool, int, float, str, type(None)):
        return str
    return hint


def _placed(name: str, value: Any, hint: Any, folder: Path) -> Any:
    """A value with its paths made absolute."""
    if isinstance(value, list) and name == "fill":
        return [_placed_fill(each, folder) for each in value]
    if not isinstance(value, str):
        return value
    path_only = Path in get_args(hint)
    if name == "prior":
        return placed_prior(value, folder)
    return _absolute(value, folder) if path_only else value


def placed_prior(value: str, folder: Path) -> str:
    """A prior as `load_prior` takes it, absolute if it is a folder or a file: workers may run elsewhere."""
    return _absolute(value, folder) if "/" in value or "\\" in value or value.endswith(".onnx") else value


def _placed_fill(value: str, folder: Path) -> str:
    view, equals, image = value.rpartition("=")
    return f"{view}{equals}{_absolute(image, folder)}"


def _absolute(value: str, folder: Path) -> str:
    return value if value.startswith(SCENE) else str((folder / Path(value).expanduser()).resolve())
