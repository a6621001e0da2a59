"""Fixtures of the scene readers."""

from __future__ import annotations

from pathlib import Path

import pytest
from corner import Corner

from diga3d_warp.scene.colmap.reconstruction import write_colmap


@pytest.fixture(scope="session")
def corner() -> Corner:
    return Corner()


@pytest.fixture
def colmap_scene(tmp_path: Path, corner: Corner) -> Path:
    """The corner as a COLMAP folder with images."""
    corner.write_images(tmp_path / "images")
    write_colmap(tmp_path, corner.cameras, corner.points)
    return tmp_path
