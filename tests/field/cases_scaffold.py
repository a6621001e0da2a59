"""Cases of captures that are asked for as anchors (Scaffold-GS)."""

from __future__ import annotations

from pathlib import Path

from expectations import Refuses, case
from field_room import FieldRoom

ANCHORS = ("--iterations", "2", "--representation", "scaffold")
KEPT = ("is taken as it is, and holds gaussians", "leave --representation scaffold out")


@case(Refuses(KEPT, ("fit", *ANCHORS)))
def splat_that_is_to_become_anchors(room: FieldRoom, folder: Path) -> Path:
    return room.splat(folder)


@case(Refuses(KEPT, ("remove", *ANCHORS)))
def splat_with_masks_that_is_to_become_anchors(room: FieldRoom, folder: Path) -> Path:
    room.write_masks(folder)
    return room.splat(folder)


@case(Refuses(KEPT, ("replace", *ANCHORS, "--prompt", "a wooden cube")))
def splat_whose_object_is_to_become_anchors(room: FieldRoom, folder: Path) -> Path:
    room.write_masks(folder)
    return room.splat(folder)
