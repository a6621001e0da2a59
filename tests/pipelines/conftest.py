"""Fixtures of the pipelines: one tiny capture and one finished removal for all of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from tiny_removal import SETTINGS, Removed

from diga3d_warp import cli
from diga3d_warp.pipelines.remove import remove_object
from diga3d_warp.pipelines.run import Run
from diga3d_warp.scene.load import load_scene
from diga3d_warp.scene.synthetic.generate import SyntheticScene, generate


@pytest.fixture(scope="session")
def room(tmp_path_factory) -> Path:
    """A synthetic capture of nine views; not to be changed."""
    return generate(SyntheticScene(width=96, height=72, views=9), tmp_path_factory.mktemp("capture") / "room")


@pytest.fixture(scope="session")
def removed(room, tmp_path_factory) -> Removed:
    scene = load_scene(room)
    run = Run(tmp_path_factory.mktemp("removed") / "run", "remove", {"seed": 0})
    return Removed(scene, remove_object(scene, run, SETTINGS), run.folder)


@pytest.fixture
def refused(tmp_path, capfd) -> Callable[[list[str], str], None]:
    """`refused(words, said)`: that command ends with code 2 and one line that says so, and leaves no run."""

    def check(words: list[str], said: str) -> None:
        before = sorted(tmp_path.rglob("*"))
        assert cli.main([*words, "--iterations", "5", "--out", str(tmp_path / "run")]) == 2
        written = capfd.readouterr()
        lines = [line for line in written.err.replace("\r", "\n").splitlines() if "error" in line]
        assert len(lines) == 1 and lines[0].startswith("diga3d: error: ") and said in lines[0], written.err
        assert "Traceback" not in written.err and written.out == ""
        assert sorted(tmp_path.rglob("*")) == before

    return check
