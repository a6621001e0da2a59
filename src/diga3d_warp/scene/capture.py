"""Capture: the calibration that a reader returns, before any photograph is opened."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.scene import Points


@dataclass(frozen=True, eq=False)
class Shot:
    """One calibrated photograph that has not been read yet.

    Attributes:
        name: Path of the image below its image folder as the calibration writes it, with forward slashes,
            with or without ending.
        camera: Camera at the size for which it was calibrated, which need not be the size of the file.
        mask: File of the mask that the calibration names for it; None if it names none.
    """

    name: str
    camera: Camera
    mask: Path | None = None


@dataclass(frozen=True, eq=False)
class Capture:
    """Calibration of a scene.

    Attributes:
        kind: Layout, as in `Scene.kind`.
        shots: Calibrated photographs.
        image_folders: Folders that hold the same photographs, keyed by the factor by which they are
            smaller: {1: images, 2: images_2}.
        points: Sparse points, or None where the capture has none.
        notes: Assumptions and omissions of the reader, one line each.
        held_out: Names of the shots that the capture itself keeps for testing; None if it has no split.
    """

    kind: str
    shots: Sequence[Shot]
    image_folders: Mapping[int, Path]
    points: Points | None
    notes: Sequence[str] = field(default_factory=tuple)
    held_out: frozenset[str] | None = None
