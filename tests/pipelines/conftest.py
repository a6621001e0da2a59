"""Fixtures of the pipelines: one tiny capture and one finished removal for all of them."""

from __future__ import annotations

from pathlib import Path

import pytest
from tiny_removal import SETTINGS, Removed

from diga3d_warp.pipelines.remove import remove
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
    return Removed(scene, remove(scene, run, SETTINGS), run.folder)
