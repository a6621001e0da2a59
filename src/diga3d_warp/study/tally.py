"""Tally: the share of votes of each method, with Wilson's confidence interval."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.tables import Table
from diga3d_warp.study.votes import Votes, read_votes

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Share:
    """Votes for one of several.

    Attributes:
        votes: Votes for it.
        of: Votes in all.
        low, high: Ends of the interval of its share in [0, 1].
    """

    votes: int
    of: int
    low: float
    high: float


@dataclass(frozen=True)
class Tally:
    """The outcome of a study.

    Attributes:
        participants: Participants that count.
        methods: Shares by name of the method, over all questions.
        questions: The same of each question, by its instruction.
        places: Shares by place on the page; far from equal, participants did not look, or methods are alike.
        notes: What does not count, and why, one line each.
    """

    participants: int
    methods: dict[str, Share]
    questions: list[tuple[str, dict[str, Share]]]
    places: dict[str, Share]
    notes: Sequence[str]

    def tables(self) -> Iterator[Table]:
        """The shares, then those of each question where there are several, then those by place."""
        votes = sum(share.votes for share in self.methods.values())
        people = f"{self.participants} participant{'s' * (self.participants != 1)}"
        yield _table(f"{votes} votes of {people}", "method", self.methods)
        if len(self.questions) > 1:
            for number, (instruction, shares) in enumerate(self.questions, 1):
                yield _table(f"Question {number}: {instruction}", "method", shares)
        yield _table("By place on the page, which is shuffled: equal but for chance", "place", self.places)


def tally(paths: Sequence[Path]) -> Tally:
    """Count votes.

    A file that is damaged or edited is left out, and so is an earlier file of the same participant; notes
    name them.

    Args:
        paths: Files of votes, and folders that hold nothing else that ends in .json.

    Raises:
        InputError: a file is absent, none can be counted, or they are of several studies.
    """
    read, notes = [], []
    for path in _files(paths):
        try:
            read.append(read_votes(path))
        except InputError as error:
            if not path.is_file():
                raise
            notes.append(f"not counted: {error}")
    if not read:
        raise InputError(f"no votes to count: {notes[0].removeprefix('not counted: ')}")
    other = next((votes for votes in read if votes.study != read[0].study), None)
    if other is not None:
        raise InputError(f"{other.path} is of another study than {read[0].path}: tally each study by itself")
    counted, said = _one_each(read)
    notes += said
    sealed = read[0].sealed
    answers = [answer for votes in counted for answer in votes.answers]
    if not answers:
        raise InputError(
            f"{read[0].path}: no question is answered in the files: {'; '.join(notes) or 'ask again'}"
        )
    names = sealed["methods"]
    by_question: dict[str, Counter[str]] = {question["code"]: Counter() for question in sealed["questions"]}
    methods_of = {question["code"]: question["candidates"] for question in sealed["questions"]}
    for answer in answers:
        by_question[answer["question"]][names[methods_of[answer["question"]][answer["choice"]]]] += 1
    places = Counter(str(answer["order"].index(answer["choice"]) + 1) for answer in answers)
    return Tally(
        len([votes for votes in counted if votes.answers]),
        shares(sum(by_question.values(), Counter()), names),
        [
            (question["instruction"], shares(by_question[question["code"]], names))
            for question in sealed["questions"]
        ],
        shares(places, [str(place) for place in range(1, len(names) + 1)]),
        notes,
    )


def shares(votes: Counter[str], names: Sequence[str]) -> dict[str, Share]:
    """Share of each name, with Wilson's interval (1927) at `CONFIDENCE`; [0, 1] where nobody voted."""
    from scipy.stats import binomtest

    of = votes.total()
    found = {}
    for name in names:
        low, high = 0.0, 1.0
        if of:
            interval = binomtest(votes[name], of).proportion_ci(CONFIDENCE, method="wilson")
            low, high = float(interval.low), float(interval.high)
        found[name] = Share(votes[name], of, low, high)
    return found


def _files(paths: Sequence[Path]) -> list[Path]:
    files: list[Path] = []
    for path in paths:
        inside = sorted(path.glob("*.json")) if path.is_dir() else [path]
        if not inside:
            raise InputError(
                f"{path} holds no .json file: give what participants saved from the study's page"
            )
        files += inside
    return list(dict.fromkeys(files))


def _one_each(read: Sequence[Votes]) -> tuple[list[Votes], list[str]]:
    """The last file of each participant, and notes on the others."""
    last: dict[str, Votes] = {}
    notes = []
    for votes in sorted(read, key=lambda votes: votes.saved):
        earlier = last.get(votes.participant)
        if earlier is not None:
            notes.append(
                f"not counted: {earlier.path} is of the same participant as {votes.path}, saved later"
            )
        last[votes.participant] = votes
    return list(last.values()), notes


def _table(title: str, head: str, shares: dict[str, Share]) -> Table:
    rows = [
        [name, str(share.votes), f"{100 * share.votes / share.of:.2f}" if share.of else "–",
         f"{100 * share.low:.1f} – {100 * share.high:.1f}"]
        for name, share in shares.items()
    ]  # fmt: skip
    return Table(title, [head, "votes", "share [%]", f"{100 * CONFIDENCE:.0f} % interval"], rows)
