"""Effects on which the user insists: `--effects sh_degree=1,exposure=off`."""

from __future__ import annotations

from collections.abc import Mapping

from diga3d_warp.errors import InputError

SWITCHES = ("lens", "antialias", "exposure", "background", "pixel_order", "surround", "shadow", "mirror")
"""Effects that are on or off. Depth, normals and determinism follow the task, not a wish."""

DEGREES = ("0", "1", "2", "3")


def parse_overrides(text: str) -> dict[str, bool | int]:
    """Effects by name from `name=value,...`; a switch takes on, off or auto, `sh_degree` 0 to 3 or auto.

    What is auto is left to the evidence, as what is not named.

    Args:
        text: As on the command line; empty for none.

    Raises:
        InputError: a part names no effect, or a value that the effect does not take.
    """
    chosen: dict[str, bool | int] = {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        name, _, value = (word.strip() for word in part.partition("="))
        if name == "sh_degree" and value in DEGREES:
            chosen[name] = int(value)
        elif name in SWITCHES and value in ("on", "off"):
            chosen[name] = value == "on"
        elif value == "auto" and name in (*SWITCHES, "sh_degree"):
            chosen.pop(name, None)
        else:
            raise InputError(
                f"{part!r} is no effect: expected sh_degree=0|1|2|3, or on|off|auto for {', '.join(SWITCHES)}"
            )
    return chosen


def format_overrides(chosen: Mapping[str, bool | int]) -> str:
    """The text that `parse_overrides` reads, in a fixed order."""
    words = {True: "on", False: "off"}
    return ",".join(
        f"{name}={words[value] if isinstance(value, bool) else value}"
        for name, value in sorted(chosen.items())
    )
