"""Values of JSON objects by name and type, with one line for those that are of another type."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from diga3d_warp.errors import InputError

_SHORT = reprlib.Repr()
_SHORT.maxlevel = 2


class Entries:
    """Entries of objects that complete each other; what is null counts as absent.

    Args:
        objects: The first one that has an entry wins.
    """

    def __init__(self, *objects: Mapping[str, Any]) -> None:
        self.objects = objects

    def get(self, name: str) -> Any:
        """The unchecked value, or None."""
        found = (each[name] for each in self.objects if each.get(name) is not None)
        return next(found, None)

    def number(self, name: str) -> float | None:
        """A finite number, also if it is written as text ("160.0"); None if absent.

        Raises:
            InputError: it is something else.
        """
        value = self.get(name)
        if value is None:
            return None
        try:
            number = float(value) if isinstance(value, (int, float, str)) else math.nan
        except (ValueError, OverflowError):
            number = math.nan
        if isinstance(value, bool) or not math.isfinite(number):
            raise InputError(f"{name} is {abridged(value)}, not a number; export it again")
        return number

    def needed(self, name: str) -> float:
        """A finite number.

        Raises:
            InputError: it is absent or something else.
        """
        number = self.number(name)
        if number is None:
            raise InputError(f"{name} is missing; export it again")
        return number

    def text(self, name: str) -> str | None:
        """A text that is not empty; None if absent or empty.

        Raises:
            InputError: it is something else.
        """
        value = self.get(name)
        if value is not None and not isinstance(value, str):
            raise InputError(f"{name} is {abridged(value)}, not a text; export it again")
        return value or None

    def flag(self, name: str) -> bool:
        """Whether something is on; False if absent. Numbers and the words true and false are taken, too.

        Raises:
            InputError: it is something else.
        """
        value = self.get(name)
        words = {"true": True, "false": False, "1": True, "0": False, "1.0": True, "0.0": False, "": False}
        known = words.get(str(value).lower()) if isinstance(value, (bool, int, float, str)) else None
        if value is not None and known is None:
            raise InputError(f"{name} is {abridged(value)}, neither true nor false; export it again")
        return bool(known)

    def table(self, name: str) -> np.ndarray:
        """An array of numbers, float64.

        Raises:
            InputError: it is absent or something else.
        """
        value = self.get(name)
        if value is None:
            raise InputError(f"{name} is missing; export it again")
        try:
            return np.array(value, np.float64)
        except (ValueError, TypeError, OverflowError):
            raise InputError(
                f"{name} is {abridged(value)}, not a table of numbers; export it again"
            ) from None


def abridged(value: Any) -> str:
    """A value shortened for an error message."""
    return _SHORT.repr(value).encode("ascii", "backslashreplace").decode()
