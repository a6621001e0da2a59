"""Votes: the file that a participant sends back, read and checked."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypedDict

from diga3d_warp.errors import InputError
from diga3d_warp.files import read_json
from diga3d_warp.state import misfit
from diga3d_warp.study.seal import Sealed, checksum, study_number, unseal

ASK_AGAIN = "ask for it again"


class Answer(TypedDict):
    """The answer to a question: codes of the question, of the choice, and of all candidates as they stood."""

    question: str
    choice: str
    order: list[str]


class VotesRecord(TypedDict):
    """A file of votes."""

    form: Literal["diga3d-votes-1"]
    study: str
    participant: str
    saved: str
    answers: list[Answer]
    sealed: str
    checksum: str


@dataclass(frozen=True)
class Votes:
    """What one participant answered.

    Attributes:
        path: The file.
        study: Number of the study.
        participant: Number of the participant, made by chance in the browser.
        saved: When the file was saved, UTC.
        answers: The answers, at most one to a question.
        sealed: What the study's seal holds.
    """

    path: Path
    study: str
    participant: str
    saved: str
    answers: list[Answer]
    sealed: Sealed


def read_votes(path: Path) -> Votes:
    """Read a file of votes.

    Raises:
        InputError: it is absent, no whole file of votes, or was edited by hand.
    """
    data = read_json(path, ASK_AGAIN)
    if not isinstance(data, dict) or data.get("form") != "diga3d-votes-1":
        raise InputError(f"{path} is no file of votes: give what participants saved from the study's page")
    if wrong := misfit(data, VotesRecord):
        raise InputError(f"{path} is damaged ({wrong}): {ASK_AGAIN}")
    if data["checksum"] != checksum(data):
        raise InputError(
            f"{path} was edited or damaged (its checksum is not that of its content): {ASK_AGAIN}"
        )
    sealed = unseal(data["sealed"])
    if (
        sealed is None
        or study_number(data["sealed"]) != data["study"]
        or not _answerable(data["answers"], sealed)
    ):
        raise InputError(f"{path} is damaged (its answers are not to its own study): {ASK_AGAIN}")
    return Votes(path, data["study"], data["participant"], data["saved"], data["answers"], sealed)


def _answerable(answers: list[Answer], sealed: Sealed) -> bool:
    """Whether the answers are to different questions of the study, each a choice among its candidates."""
    candidates = {question["code"]: question["candidates"] for question in sealed["questions"]}
    asked = [answer["question"] for answer in answers]
    if len(set(asked)) < len(asked) or not candidates.keys() >= set(asked):
        return False
    return all(
        answer["choice"] in answer["order"]
        and sorted(answer["order"]) == sorted(candidates[answer["question"]])
        for answer in answers
    )
