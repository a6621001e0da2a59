"""What a user may expect of an input: the right scene, a note where something was guessed; or one line."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from field_room import FieldRoom

from diga3d_warp import cli
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.load import load_scene
from diga3d_warp.scene.scene import Scene

Build = Callable[[FieldRoom, Path], Path]
"""Writes the files of a case into an empty folder and returns what the user names as SCENE."""

PIXEL_TOLERANCE = 0.05
"""Distance that a point may move in an image [px]: parameters passed through text."""

COLOR_TOLERANCE = 6.0
"""Mean difference of a photograph that went through JPEG [levels of 255]."""


@dataclass(frozen=True)
class Reads:
    """The room comes out: the same cameras, photographs and points.

    Attributes:
        notes: Words that the notes of the scene must hold.
        views: How many views are expected, training and test together; None for all of the room's.
        points: Whether the points must be those of the room.
        load: Further arguments of `load_scene`.
        also: Further assertions on the scene.
    """

    notes: tuple[str, ...] = ()
    views: int | None = None
    points: bool = True
    load: dict = field(default_factory=dict)
    also: Callable[[Scene, FieldRoom], None] | None = None

    def check(self, scene_path: Path, room: FieldRoom, tmp_path: Path, capfd) -> None:
        scene = load_scene(scene_path, **self.load)
        views = [*scene.views, *scene.test_views]
        assert len(views) == (self.views or len(room.names)), [view.name for view in views]
        for view in views:
            name = next(name for name in room.names if name in view.name.lower())
            shift = np.abs(
                projected(view.camera, room.points.positions)
                - projected(room.cameras[name], room.points.positions)
            )
            assert shift.max() < PIXEL_TOLERANCE, (view.name, shift.max())
            wanted = room.pixels[name]
            assert view.pixels.shape == wanted.shape
            assert np.abs(view.pixels.astype(float) - wanted).mean() < COLOR_TOLERANCE, view.name
        if self.points:
            order, own = (np.lexsort(p.positions.T.round(4)) for p in (scene.points, room.points))
            assert len(scene.points) == len(room.points)
            np.testing.assert_allclose(scene.points.positions[order], room.points.positions[own], atol=2e-4)
        said = "\n".join(scene.notes)
        for words in self.notes:
            assert words in said, f"{words!r} is not in the notes: {said!r}"
        if self.also:
            self.also(scene, room)


@dataclass(frozen=True)
class Refuses:
    """One line, exit code 2, nothing written.

    Attributes:
        words: What the line must hold.
        command: The command and its options, without SCENE and --out; {scene} stands for SCENE.
    """

    words: tuple[str, ...]
    command: tuple[str, ...] = ("fit", "--iterations", "2")

    def check(self, scene_path: Path, room: FieldRoom, tmp_path: Path, capfd) -> None:
        before = sorted(tmp_path.rglob("*"))
        name, *options = (word.replace("{scene}", str(scene_path)) for word in self.command)
        assert cli.main([name, str(scene_path), *options, "--out", str(tmp_path / "run")]) == 2
        written = capfd.readouterr()
        lines = [line for line in written.err.replace("\r", "\n").splitlines() if "error" in line]
        assert len(lines) == 1 and lines[0].startswith("diga3d: error: "), written.err
        for words in self.words:
            assert words in lines[0], f"{words!r} is not in {lines[0]!r}"
        assert "Traceback" not in written.err
        assert sorted(tmp_path.rglob("*")) == before


@dataclass(frozen=True)
class Case:
    """An input from the field.

    Attributes:
        name: What is special about it, in kebab case.
        build: Makes it.
        expected: What must come of it.
    """

    name: str
    build: Build
    expected: Reads | Refuses


CASES: list[Case] = []


def case(expected: Reads | Refuses) -> Callable[[Build], Build]:
    """Register a function that builds a case; its name, with dashes, is the name of the case."""

    def register(build: Build) -> Build:
        name = build.__name__.replace("_", "-")
        assert all(other.name != name for other in CASES), f"two cases are called {name}"
        CASES.append(Case(name, build, expected))
        return build

    return register


def projected(camera: Camera, positions: np.ndarray) -> np.ndarray:
    """Pixel positions of points in front of a camera without a lens, shape (P, 2); NaN-free."""
    pose = np.asarray(camera.pose, np.float64)
    local = positions @ pose[:3, :3].T + pose[:3, 3]
    depth = np.where(local[:, 2] > 1e-6, local[:, 2], np.inf)
    return np.stack(
        [camera.fx * local[:, 0] / depth + camera.cx, camera.fy * local[:, 1] / depth + camera.cy], axis=1
    )


def parameters() -> list:
    """All registered cases as parameters of a test."""
    return [pytest.param(each, id=each.name) for each in CASES]
