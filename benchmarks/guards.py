"""Guards that hard cases need, each with the test that fails without it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Guard:
    """A piece of source without which a hard case goes wrong.

    Attributes:
        file: Below src/diga3d_warp.
        source: What stands there, exactly once in the file.
        without: What is put in its place.
        test: The test that must then fail, below tests; a file, a function or one of its cases.
    """

    file: str
    source: str
    without: str
    test: str


@dataclass(frozen=True)
class HardCase:
    """One row of the table.

    Attributes:
        name: The case.
        handling: What the project does.
        guards: Taken out one by one.
        constants: Settings that decide it, as Class.attribute; their reasons stand in the class's docstring.
    """

    name: str
    handling: str
    guards: tuple[Guard, ...]
    constants: tuple[str, ...] = ()


def condition(file: str, source: str, test: str) -> Guard:
    """A guard `if SOURCE:` that never holds."""
    return Guard(file, f"if {source}:", "if False:", test)
