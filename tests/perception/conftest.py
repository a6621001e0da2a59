"""Tiny checkpoints in the real format, written once."""

import pytest

from tiny_perception import write_cutter, write_depth_model, write_detector


@pytest.fixture(scope="session")
def models(tmp_path_factory):
    """Folders dpt, detector and cutter."""
    root = tmp_path_factory.mktemp("models")
    write_depth_model(root / "dpt")
    write_detector(root / "detector")
    write_cutter(root / "cutter")
    return root
