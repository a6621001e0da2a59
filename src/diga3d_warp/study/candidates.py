"""Candidates: the results that a question of a study compares, read from run folders.

Another method's result is a plain folder of pictures with the names of the run's views.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.record import MANIFEST, RESULT, SOURCE, read_manifest
from diga3d_warp.scene.photographs.names import IMAGE_SUFFIXES, listed

FEWEST, MOST = 2, 4
"""Candidates of a question: the paper's has four."""

EDITS = ("remove", "retexture", "replace")


@dataclass(frozen=True)
class Candidate:
    """One result.

    Attributes:
        folder: The run folder, or a folder of another method's pictures.
        after: Pictures of the result by view name.
        manifest: Manifest of the run; None for another method's pictures.
    """

    folder: Path
    after: Mapping[str, Path]
    manifest: Mapping[str, Any] | None

    @property
    def before(self) -> dict[str, Path]:
        """Pictures of the scene before the edit, by view name."""
        return pictures_below(self.folder / "views" / "before")


@dataclass(frozen=True)
class Edit:
    """What was asked of every run of a question.

    Attributes:
        command: "remove", "retexture" or "replace".
        prompt: The prompt, or the name of the file that stands for it; empty for a removal.
    """

    command: str
    prompt: str

    @property
    def instruction(self) -> str:
        """The edit in words, for a participant."""
        return {
            "remove": "Remove the object.",
            "retexture": f"Give the object another material: “{self.prompt}”",
            "replace": f"Replace the object by: “{self.prompt}”",
        }[self.command]


def read_candidates(folders: Sequence[Path]) -> tuple[list[Candidate], Edit]:
    """The candidates of a question, in the order given, and the edit that all of them show.

    Raises:
        InputError: too few or too many; one is no edit with views; two are the same; scenes or edits differ.
    """
    if not FEWEST <= len(folders) <= MOST:
        raise InputError(
            f"a question compares {FEWEST} to {MOST} runs, not {len(folders)}: {_named(folders)}"
        )
    places: dict[Path, Path] = {}
    for folder in folders:
        if folder.resolve() in places:
            raise InputError(f"{folder} is given twice: give runs that differ")
        places[folder.resolve()] = folder
    candidates = [_read(folder) for folder in folders]
    runs = [candidate for candidate in candidates if candidate.manifest is not None]
    if not runs:
        raise InputError(
            f"{folders[0]} holds no run ({MANIFEST} is missing), nor do the others: give one at least"
        )
    edits = [_edit(run) for run in runs]
    for run, edit in zip(runs[1:], edits[1:], strict=True):
        if not _same_scene(runs[0], run):
            raise InputError(
                f"{run.folder} is of another scene than {runs[0].folder}: a question has one scene"
            )
        if edit.command != edits[0].command:
            raise InputError(
                f"{run.folder} is a {edit.command} and {runs[0].folder} a {edits[0].command}: compare runs "
                "of one edit"
            )
        if _plain(edit.prompt) != _plain(edits[0].prompt):
            raise InputError(
                f"{run.folder} has another prompt ({edit.prompt!r}) than {runs[0].folder} "
                f"({edits[0].prompt!r}): compare runs of one prompt"
            )
    return candidates, edits[0]


def shared_views(candidates: Sequence[Candidate]) -> tuple[list[str], list[str]]:
    """Names of the views that all candidates and the source have, and notes on those that are left out.

    Raises:
        InputError: there is none.
    """
    first = next(candidate for candidate in candidates if candidate.manifest is not None)
    names = set(first.before)
    for candidate in candidates:
        names &= set(candidate.after)
    if not names:
        raise InputError(
            f"{_named([candidate.folder for candidate in candidates])} have no view in common: give results "
            "of one scene, whose pictures have the views' names"
        )
    every = set(first.before).union(*(candidate.after for candidate in candidates))
    rest = sorted(every - names)
    notes = [f"{len(rest)} views that not all runs have are left out: {listed(rest)}"] if rest else []
    return sorted(names), notes


def pictures_below(folder: Path, suffixes: Sequence[str] = (".png",)) -> dict[str, Path]:
    """Pictures in a folder and below by name, without the ending; a view's name may hold folders."""
    if not folder.is_dir():
        return {}
    return {
        file.relative_to(folder).with_suffix("").as_posix(): file
        for file in sorted(folder.rglob("*"))
        if file.suffix.lower() in suffixes and not file.name.startswith(".")
    }


def _read(folder: Path) -> Candidate:
    if folder.is_dir() and not (folder / MANIFEST).exists():
        own = {file.stem: file for file in sorted(folder.iterdir()) if file.suffix.lower() in IMAGE_SUFFIXES}
        if own:
            return Candidate(folder, own, None)
    manifest = read_manifest(folder)
    if manifest["command"] not in EDITS:
        raise InputError(f"{folder} is a {manifest['command']}, which edits nothing: give runs of an edit")
    after = pictures_below(folder / "views" / "after")
    if not after or not pictures_below(folder / "views" / "before"):
        raise InputError(f"{folder} has no views: finish the run with --resume first")
    return Candidate(folder, after, manifest)


def has_splats(candidate: Candidate) -> bool:
    """Whether the result and the scene before the edit can be rendered."""
    return all((candidate.folder / name).is_file() for name in (RESULT, SOURCE))


def _edit(run: Candidate) -> Edit:
    assert run.manifest is not None
    command, settings = run.manifest["command"], run.manifest["settings"]
    if command == "remove":  # whose prompt says what is behind the object: a means, not the task
        return Edit(command, "")
    given = next((settings[key] for key in ("prompt", "asset", "exemplar") if settings.get(key)), None)
    if given is None:
        raise InputError(
            f"{run.folder}/{MANIFEST} names no prompt: a participant could not tell what was asked"
        )
    return Edit(command, given if settings.get("prompt") else Path(given).stem)


def _same_scene(one: Candidate, other: Candidate) -> bool:
    """By the digest of the photographs, or by the path of the capture, as image scales may differ."""
    assert one.manifest is not None and other.manifest is not None
    digests = [
        run.get("held_to", {}).get("capture", {}).get("photographs") for run in (one.manifest, other.manifest)
    ]
    if digests[0] is not None and digests[0] == digests[1]:
        return True
    scenes = [run["settings"].get("scene") for run in (one.manifest, other.manifest)]
    return (
        scenes[0] is not None
        and scenes[1] is not None
        and Path(scenes[0]).resolve() == Path(scenes[1]).resolve()
    )


def _plain(prompt: str) -> str:
    return " ".join(prompt.split()).casefold()


def _named(folders: Sequence[Path]) -> str:
    return ", ".join(str(folder) for folder in folders) or "none is given"
