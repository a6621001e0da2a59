"""What every parser of the command has in common: its form, its one-line errors, and the types of values."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from diga3d_warp.errors import InputError

EXIT_INPUT = 2
SEED_MOST = 2**31 - 1  # what every generator here takes
COUNT_MOST = 10**9  # steps and frames that nobody lives to see the end of
BOUNDLESS = 10**20  # more than anything here takes
SIDE_MOST = 16_383  # px, the most that VP8 encodes


class Help(argparse.RawDescriptionHelpFormatter):
    """Keeps the examples as they are and leaves room for the longest option."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, max_help_position=32, width=100)


class Parser(argparse.ArgumentParser):
    """A parser whose errors take one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(EXIT_INPUT, f"diga3d: error: {message} (see {self.prog} --help)\n")


class Commands:
    """The subcommands of a parser.

    Args:
        parser: Whose subcommands they are.
        title: What `--help` calls all of them.
        metavar: What it calls one of them.
    """

    def __init__(self, parser: argparse.ArgumentParser, title: str, metavar: str) -> None:
        self._parsers = parser.add_subparsers(
            title=title, required=True, metavar=f"{metavar} [-h]", parser_class=Parser
        )

    def add(
        self, name: str, run: Callable[..., int], summary: str, example: str, description: str = ""
    ) -> argparse.ArgumentParser:
        """The parser of a new subcommand.

        Args:
            name: What a user types.
            run: Takes the options by name and gives the exit code.
            summary: A line without a full stop, for the list of all.
            example: A line as a user would type it.
            description: A sentence for its own help; the summary if empty.
        """
        command = self._parsers.add_parser(
            name,
            help=summary,
            description=description or summary[0].upper() + summary[1:] + ".",
            epilog=f"example:\n  {example}",
            formatter_class=Help,
        )
        command.set_defaults(run=run)
        return command


class Version(argparse.Action):
    """Looks the version up only when asked: reading package metadata takes a while."""

    def __init__(self, option_strings: Sequence[str], dest: str, **_: Any) -> None:
        super().__init__(option_strings, dest=argparse.SUPPRESS, nargs=0, help="show the version and exit")

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from importlib.metadata import version

        parser.exit(message=f"diga3d {version('diga3d-warp')}\n")


def path(text: str) -> Path:
    if not text.strip():
        raise argparse.ArgumentTypeError(f"{text!r} is not a path")
    return Path(text)


def positive_int(text: str) -> int:
    number = _decimal(text)
    if number is None or number < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number above 0")
    if number > COUNT_MOST:
        raise argparse.ArgumentTypeError(f"a number of {len(text)} digits is above {COUNT_MOST}")
    return number


def _decimal(text: str) -> int | None:
    """A whole number, `BOUNDLESS` if it has 20 digits or more; None if it is no whole number."""
    if not text.isdecimal():
        return None
    return int(text) if len(text) < 20 else BOUNDLESS


def whole_numbers(text: str) -> tuple[int, ...]:
    numbers = text.split(",")
    if not all(number.strip().isdecimal() for number in numbers):
        raise argparse.ArgumentTypeError(f"{text!r} is not a list of whole numbers such as 3,7")
    return tuple(int(number) for number in numbers)


def effects(text: str) -> dict[str, bool | int]:
    from diga3d_warp.effects.overrides import parse_overrides

    try:
        return parse_overrides(text)
    except InputError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def hold_out(text: str) -> int:
    number = _decimal(text)
    if number is None or number == 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not 0 (hold out none) or a whole number above 1")
    return number


def seed(text: str) -> int:
    number = _decimal(text)
    if number is None or number > SEED_MOST:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 0 to {SEED_MOST}")
    return number


def scale(text: str) -> float:
    number = _number(text)
    if not 0.0 < number <= 1.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number above 0 and up to 1")
    return number


def share(text: str) -> float:
    number = _number(text)
    if not 0.0 <= number <= 1.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number from 0 to 1")
    return number


def non_negative(text: str) -> float:
    number = _number(text)
    if not 0.0 <= number < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number from 0 up")
    return number


def _number(text: str) -> float:
    """A number; not a number if it is none."""
    try:
        return float(text)
    except ValueError:
        return float("nan")


def size(text: str) -> tuple[int, int]:
    width, height = (_decimal(side) for side in text.partition("x")[::2])
    if not width or not height:
        raise argparse.ArgumentTypeError(f"{text!r} is not a size such as 640x480")
    if max(width, height) > SIDE_MOST:
        raise argparse.ArgumentTypeError(f"{text!r} is larger than {SIDE_MOST}x{SIDE_MOST}")
    return width, height
