"""Questions of a study: an instruction, the scene before the edit, and candidates in no telling order."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.record import RESULT, SOURCE
from diga3d_warp.study.candidates import Candidate, has_splats, pictures_below, read_candidates, shared_views
from diga3d_warp.study.media import LONGEST, Medium, common_size, outlined, spread, video_of, views_of

FRAMES = 120
"""Frames of a flight: four seconds, as `diga3d render` makes by default."""

ASKED = {
    "remove": "Which result looks best, as if the object had never been there?",
    "retexture": "Which result follows the instruction best, in high quality?",
    "replace": "Which result follows the instruction best, in high quality?",
}
"""The question by edit. The paper's user study lets users "select the most relevant edited scene based on the
text prompts while ensuring high rendering quality"; a removal has no prompt to be relevant to."""


@dataclass(frozen=True)
class Shown:
    """A candidate as it is shown.

    Attributes:
        code: Digest of what is shown; the candidates of a question are sorted by it.
        method: Place of its method among those of the study.
        media: Views in order, or one video.
    """

    code: str
    method: int
    media: Sequence[Medium]


@dataclass(frozen=True)
class Question:
    """One question.

    Attributes:
        instruction: What was asked of the candidates.
        ask: What is asked of the participant.
        source: The scene before the edit, in the order of the candidates' media.
        object: A view with the object outlined, if there are masks.
        candidates: In the order of their codes.
    """

    instruction: str
    ask: str
    source: Sequence[Medium]
    object: Medium | None
    candidates: Sequence[Shown]

    @property
    def code(self) -> str:
        """Digest of the question."""
        return _digest([self.instruction, *(candidate.code for candidate in self.candidates)])


def make_question(folders: Sequence[Path], *, video: bool) -> tuple[Question, list[str]]:
    """A question about some runs.

    Args:
        folders: One for each method, in the order of the methods.
        video: Render a flight through each splat in place of showing the views.

    Returns:
        The question, and notes on what was left out or taken for something.

    Raises:
        InputError: the runs do not compare, have no views, or look the same.
    """
    candidates, edit = read_candidates(folders)
    foreign = [str(candidate.folder) for candidate in candidates if candidate.manifest is None]
    notes = [f"{folder} is no run: its pictures are shown as another method's result" for folder in foreign]
    first = next(candidate for candidate in candidates if candidate.manifest is not None)
    before = first.before
    if video:
        source, media = _flights(candidates, first)
    else:
        names, left_out = shared_views(candidates)
        notes += left_out
        names = spread(names)
        firsts = {str(candidate.folder): candidate.after[names[0]] for candidate in candidates}
        size = common_size({"the source": before[names[0]], **firsts})
        source = views_of(before, names, size)
        media = [views_of(candidate.after, names, size) for candidate in candidates]
    shown: dict[str, Shown] = {}
    for method, (candidate, pictures) in enumerate(zip(candidates, media, strict=True)):
        code = _digest([medium.name for medium in pictures])
        if code in shown:
            same = folders[shown[code].method]
            raise InputError(f"{candidate.folder} shows the same pictures as {same}: give runs that differ")
        shown[code] = Shown(code, method, pictures)
    return (
        Question(
            edit.instruction,
            ASKED[edit.command],
            source,
            outlined(before, pictures_below(first.folder / "masks")),
            [shown[code] for code in sorted(shown)],
        ),
        notes,
    )


def _flights(candidates: Sequence[Candidate], first: Candidate) -> tuple[list[Medium], list[list[Medium]]]:
    """Videos of the source and of each candidate along the same path."""
    from diga3d_warp.pipelines.render import render_flight

    for candidate in candidates:
        if not has_splats(candidate):
            raise InputError(
                f"{candidate.folder} has no splats to render a video of: leave --video out to show views"
            )

    def flight(run: Candidate, splat: str) -> list[Medium]:
        return [video_of(list(render_flight(run.folder, splat, FRAMES, LONGEST)))]

    return flight(first, SOURCE), [flight(candidate, RESULT) for candidate in candidates]


def _digest(parts: Sequence[str]) -> str:
    return hashlib.sha256("\n".join(parts).encode("utf-8", "surrogatepass")).hexdigest()[:16]
