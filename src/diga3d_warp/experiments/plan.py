"""Plan of a sweep: a file that names a grid of scenes, prompts, priors, seeds and options."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypedDict

from diga3d_warp.errors import InputError
from diga3d_warp.experiments.job import JOBS, Command, Job
from diga3d_warp.experiments.options import checked_options, in_scene
from diga3d_warp.experiments.yaml_file import read_yaml
from diga3d_warp.scene.photographs.folders import is_run

WHAT = {"retexture": ("prompt", "exemplar"), "replace": ("prompt", "asset", "fill")}
"""Options one of which says what the object becomes."""

GRID = {"prompts": "prompt", "priors": "prior", "seeds": "seed"}
"""Lists of a plan, and the option that each varies."""


class PlanBegun(TypedDict):
    """Keys that a plan must have."""

    command: Command
    scenes: list[str | int]


class PlanFile(PlanBegun, total=False):
    """A plan.

    Attributes:
        command: The subcommand that is run.
        scenes: Captures, as paths relative to the plan; `*` and `?` match names.
        prompts, priors, seeds: Values of these options.
        vary: Values of further options, by name.
        options: Options of all jobs, by name; `{scene}` in a path stands for the scene's folder.
        published_size: Use the image size on which the figures of a scene's data set are measured.
        source_prompt, edit_prompt: What the scenes show before and after the edit, for CLIP_dir.
        weights: Folder with the weights of the metrics.
    """

    prompts: list[str]
    priors: list[str]
    seeds: list[int]
    vary: dict[str, list[Any]]
    options: dict[str, Any]
    published_size: bool
    source_prompt: str
    edit_prompt: str
    weights: str


@dataclass(frozen=True)
class Plan:
    """What a sweep runs.

    Attributes:
        command: The subcommand.
        scenes: Captures, absolute.
        grid: Values by option, at least one each.
        options: Options of all jobs.
        shared: Further attributes of `Job` that all share.
    """

    command: Command
    scenes: Sequence[Path]
    grid: Mapping[str, Sequence[Any]]
    options: Mapping[str, Any]
    shared: Mapping[str, Any]

    def jobs(self) -> list[tuple[Mapping[str, Any], Job]]:
        """Every job, with the values of the grid that are its own."""
        return [
            (
                values,
                Job(self.command, str(scene), in_scene({**self.options, **values}, scene), **self.shared),
            )
            for scene in self.scenes
            for values in (
                dict(zip(self.grid, combination, strict=True))
                for combination in itertools.product(*self.grid.values())
            )
        ]


def read_plan(path: Path) -> Plan:
    """Read a plan.

    Raises:
        InputError: the file is no plan, a key or option is unknown, a list is empty, a value is of the wrong
            kind or stands twice, or a scene is not there.
    """
    data = read_yaml(path, PlanFile)
    command = data["command"]
    lists: dict[str, list[Any]] = {option: data[key] for key, option in GRID.items() if key in data}  # type: ignore[literal-required]
    for name, values in data.get("vary", {}).items():
        option = name.replace("-", "_")
        if option in lists:
            raise InputError(f"{path}: {option} is varied twice: leave one of the lists out")
        lists[option] = values
    if both := [name for name in data.get("options", {}) if name.replace("-", "_") in lists]:
        raise InputError(f"{path}: {both[0]} stands in options and is varied: leave one of the two out")
    empty = next((name for name, values in {"scenes": data["scenes"], **lists}.items() if not values), None)
    if empty is not None:
        raise InputError(f"{path}: the list of {empty} is empty, so there is nothing to run: give a value")
    grid = {
        option: _distinct(path, option, [checked_options(path, command, {option: v})[option] for v in values])
        for option, values in lists.items()
    }
    shared: dict[str, Any] = {"size": "published" if data.get("published_size") else None}
    for name in ("source_prompt", "edit_prompt"):
        shared[name] = data.get(name)
    if "weights" in data:
        shared["weights"] = str((path.parent / Path(data["weights"]).expanduser()).resolve())
    options = checked_options(path, command, data.get("options", {}))
    if shared["size"] and "image_scale" in {**options, **grid}:
        raise InputError(f"{path}: image_scale and published_size exclude each other: leave one out")
    if command == "fit" and ("source_prompt" in data or "edit_prompt" in data):
        raise InputError(f"{path}: a fit has no edit: leave out source_prompt and edit_prompt")
    if command in WHAT and not any({**options, **grid}.get(name) for name in WHAT[command]):
        raise InputError(f"{path}: a {command} needs {' or '.join(WHAT[command])}: give one")
    return Plan(command, _scenes(path, data["scenes"]), grid, options, shared)


def _scenes(path: Path, names: Sequence[str | int]) -> list[Path]:
    """The captures that the names of a plan mean, each once.

    Raises:
        InputError: one is not there.
    """
    found = []
    for name in map(str, names):
        if any(sign in name for sign in "*?["):
            folder, pattern = (Path(Path(name).anchor), Path(name).relative_to(Path(name).anchor))
            base = folder if Path(name).is_absolute() else path.parent
            matches = sorted(match for match in base.glob(str(pattern)) if _is_scene(match))
        else:
            place = path.parent / Path(name).expanduser()
            matches = [place] if place.exists() else []
        if not matches:
            raise InputError(f"{path}: there is no scene {name} (paths are relative to the plan's folder)")
        found += [match.resolve() for match in matches]
    return list(dict.fromkeys(found))


def _is_scene(path: Path) -> bool:
    """Whether a match of a pattern is no hidden file, run or earlier sweep."""
    return not (path.name.startswith(".") or is_run(path) or (path / JOBS).is_dir())


def _distinct(path: Path, option: str, values: list[Any]) -> list[Any]:
    seen: list[Any] = []
    for value in values:
        if value in seen:
            raise InputError(f"{path}: {value!r} stands twice in the list of {option}: leave one out")
        seen.append(value)
    return seen
