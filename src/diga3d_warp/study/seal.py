"""Seal: which candidate is whose, and what votes come from, in a form that nobody reads in passing.

The page and each file of votes carry the seal, so that a tally needs the votes alone. It hides names from a
glance at the source of the page, not from someone who means to find them. The study's number is a digest of
the seal. Votes end in a checksum, which tells an edited or damaged file from a whole one; it is no signature.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import json
import zlib
from collections.abc import Mapping, Sequence
from typing import Any, TypedDict

from diga3d_warp.state import misfit
from diga3d_warp.study.questions import Question


class SealedQuestion(TypedDict):
    """A question: its instruction, and the place of the method of each candidate by code."""

    code: str
    instruction: str
    candidates: dict[str, int]


class Sealed(TypedDict):
    """What a seal holds: names of the methods, and the questions in order."""

    methods: list[str]
    questions: list[SealedQuestion]


def seal(methods: Sequence[str], questions: Sequence[Question]) -> str:
    """The seal of a study, as ASCII."""
    content: Sealed = {
        "methods": list(methods),
        "questions": [
            {
                "code": question.code,
                "instruction": question.instruction,
                "candidates": {candidate.code: candidate.method for candidate in question.candidates},
            }
            for question in questions
        ],
    }
    return base64.b64encode(zlib.compress(json.dumps(content).encode(), 9)).decode()


def unseal(text: str) -> Sealed | None:
    """What a seal holds; None if it is none."""
    try:
        content = json.loads(zlib.decompress(base64.b64decode(text, validate=True)))
    except (ValueError, binascii.Error, zlib.error):
        return None
    if misfit(content, Sealed) is not None:
        return None
    places = {place for question in content["questions"] for place in question["candidates"].values()}
    return content if places <= set(range(len(content["methods"]))) else None


def study_number(text: str) -> str:
    """The number of the study with this seal."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def checksum(votes: Mapping[str, Any]) -> str:
    """CRC-32 of votes without their checksum, keys in their order, as the page computes it: eight digits."""
    body = {key: value for key, value in votes.items() if key != "checksum"}
    text = json.dumps(body, separators=(",", ":"), ensure_ascii=False)
    return f"{zlib.crc32(text.encode('utf-8', 'surrogatepass')):08x}"
