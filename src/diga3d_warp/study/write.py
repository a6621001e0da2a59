"""Write a study: one page that opens offline, with its pictures or, if they are many, a folder beside it."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from diga3d_warp.errors import InputError, cannot_read
from diga3d_warp.files import whole_file, write_text
from diga3d_warp.study.media import Medium
from diga3d_warp.study.questions import Question, make_question
from diga3d_warp.study.seal import seal, study_number

INLINE_MOST = 18 * 2**20
"""Most bytes of pictures in the page itself: Base64 adds a third, and most mail takes 25 MB."""

PARTS = Path(__file__).with_name("page")

MARK = '<html lang="en" data-study="'
"""Start of a study's page, followed by its number."""


@dataclass(frozen=True)
class Study:
    """A study that was written.

    Attributes:
        page: The page.
        folder: Folder of its pictures; None if they are in the page.
        notes: What was left out or taken for something, one line each.
    """

    page: Path
    folder: Path | None
    notes: Sequence[str]


def write_study(
    questions: Sequence[Sequence[Path]],
    out: Path,
    *,
    names: Sequence[str] = (),
    video: bool = False,
    inline_most: int = INLINE_MOST,
) -> Study:
    """Write the page of a study. The same runs give the same bytes.

    Args:
        questions: Run folders of each question, one for each method, in the same order of methods.
        out: The page, ends with .html.
        names: Names of the methods, for the tally; derived from the folders if empty.
        video: Show a flight through each splat in place of the views.
        inline_most: Bytes of pictures up to which they are in the page itself.

    Raises:
        InputError: runs that do not compare, or a file at `out` that is not this study.
    """
    _check_out(out)
    methods = _methods(questions, names)
    made, notes = [], []
    for folders in questions:
        question, said = make_question(folders, video=video)
        made.append(question)
        notes += [note for note in said if note not in notes]
    if len({question.code for question in made}) < len(made):
        raise InputError("two questions are about the same runs: give each once")
    sealed = seal(methods, made)
    number = study_number(sealed)
    there = _study_at(out)
    if there not in (None, number):
        raise InputError(f"{out} is another study, whose votes may be out: delete it or choose another --out")
    media = {medium.name: medium for question in made for medium in _media(question)}
    folder = out.with_name(f"{out.stem}_files")
    apart = sum(len(medium.data) for medium in media.values()) > inline_most
    if apart:
        _write_folder(folder, media)

    def address(medium: Medium) -> str:
        return f"{folder.name}/{medium.name}" if apart else medium.url

    write_text(out, _page(number, sealed, made, address))
    return Study(out, folder if apart else None, notes)


def _check_out(out: Path) -> None:
    if out.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"{out} is no name of a page: let --out end with .html")
    if out.is_dir():
        raise InputError(f"{out} is a folder: choose another --out")
    if out.exists() and _study_at(out) is None:
        raise InputError(f"{out} is there and is no study: delete it or choose another --out")


def _study_at(page: Path) -> str | None:
    """The number of the study at a path; None if there is none."""
    try:
        with page.open("rb") as stream:
            start = stream.read(200).decode("utf-8", "replace")
    except FileNotFoundError:
        return None
    except OSError as error:
        raise cannot_read(page, error) from error
    found = re.search(re.escape(MARK) + r"([0-9a-f]{16})\"", start)
    return found[1] if found else None


def _methods(questions: Sequence[Sequence[Path]], names: Sequence[str]) -> list[str]:
    """Names of the methods: those given, or the folders' names if they are the same in all questions."""
    count = len(questions[0])
    for folders in questions:
        if len(folders) != count:
            raise InputError(
                f"a question has {len(folders)} runs and the first has {count}: give each one run of every "
                "method, in the same order"
            )
    if names:
        if len(names) != count or len(set(names)) < count or not all(name.strip() for name in names):
            raise InputError(f"--names has to give {count} different names, one for each run of a question")
        return list(names)
    for naming in (lambda folder: folder.resolve().name, str):
        for folders in questions:
            found = [naming(folder) for folder in folders]
            if len(set(found)) == count and all(
                [naming(folder) for folder in others] == found for others in questions
            ):
                return found
    if len(questions) == 1:
        return [str(folder) for folder in questions[0]]
    raise InputError(
        "the folders' names do not tell which runs are of one method: name the methods with --names"
    )


def _media(question: Question) -> Iterator[Medium]:
    yield from question.source
    if question.object is not None:
        yield question.object
    for candidate in question.candidates:
        yield from candidate.media


def _write_folder(folder: Path, media: dict[str, Medium]) -> None:
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} is a file, and the pictures of the study go there: choose another --out")
    others = (
        sorted(entry.name for entry in folder.iterdir() if entry.name not in media) if folder.exists() else []
    )
    if others:
        raise InputError(f"{folder} holds other things ({others[0]}): delete it or choose another --out")
    for name, medium in media.items():
        with whole_file(folder / name) as partial:
            partial.write_bytes(medium.data)


def _page(number: str, sealed: str, questions: Sequence[Question], address: Callable[[Medium], str]) -> str:
    data: dict[str, Any] = {
        "study": number,
        "sealed": sealed,
        "questions": [
            {
                "code": question.code,
                "instruction": question.instruction,
                "ask": question.ask,
                "source": [address(medium) for medium in question.source],
                "object": None if question.object is None else address(question.object),
                "candidates": [
                    {"code": candidate.code, "media": [address(medium) for medium in candidate.media]}
                    for candidate in question.candidates
                ],
            }
            for question in questions
        ],
    }
    parts = {
        part: (PARTS / part).read_text(encoding="utf-8") for part in ("body.html", "page.css", "page.js")
    }
    content = json.dumps(data, ensure_ascii=False, separators=(",", ":")).replace("<", "\\u003c")
    return (
        f'<!doctype html>\n{MARK}{number}"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape('Which result is best?')}</title>\n<style>\n{parts['page.css']}</style></head>\n"
        f'<body>\n{parts["body.html"]}<script type="application/json" id="study">{content}</script>\n'
        f"<script>\n{parts['page.js']}</script></body></html>\n"
    )
