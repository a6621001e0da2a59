"""Cases of plans for sweeps, which people write by hand."""

from __future__ import annotations

from pathlib import Path

from expectations import Refuses, case
from field_room import FieldRoom


def written(room: FieldRoom, folder: Path, lines: str) -> Path:
    """A plan beside the capture `room`."""
    room.colmap(folder / "room")
    (folder / "plan.yaml").write_text(f"command: remove\nscenes: [room]\n{lines}\n", encoding="utf-8")
    return folder / "plan.yaml"


@case(Refuses(("plan.yaml", "seed is unknown: did you mean seeds?"), ("sweep",)))
def plan_with_an_unknown_key(room: FieldRoom, folder: Path) -> Path:
    return written(room, folder, "seed: [0, 1]")


@case(Refuses(("plan.yaml", "option referenses is unknown: did you mean references?"), ("sweep",)))
def plan_with_an_unknown_option(room: FieldRoom, folder: Path) -> Path:
    return written(room, folder, "options: {referenses: 2}")


@case(Refuses(("plan.yaml", "the list of prior is empty"), ("sweep",)))
def plan_with_an_empty_grid(room: FieldRoom, folder: Path) -> Path:
    return written(room, folder, "priors: []")


@case(Refuses(("no prior or folder nothing-there",), ("sweep",)))
def plan_with_a_prior_that_is_not_there(room: FieldRoom, folder: Path) -> Path:
    return written(room, folder, "priors: [exemplar, nothing-there]")


@case(Refuses(("plan.yaml", "line 4", "a tab indents it"), ("sweep",)))
def plan_with_tabs(room: FieldRoom, folder: Path) -> Path:
    return written(room, folder, "options:\n\tseed: 1")
