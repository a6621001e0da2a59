"""Weights of the metrics' networks, written once for all tests of a process."""

from collections.abc import Callable
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def weights_of(tmp_path_factory) -> Callable[..., Path]:
    """A function from names of networks to the folder that holds random weights of these, at least."""
    import tiny_metrics as tiny

    folder = tmp_path_factory.mktemp("weights")
    writers = {
        "vgg": lambda: tiny.write_backbone(folder, "vgg"),
        "alex": lambda: tiny.write_backbone(folder, "alex"),
        "clip": lambda: tiny.write_clip(folder),
        "musiq": lambda: tiny.write_musiq(folder),
        "inception": lambda: tiny.write_inception(folder),
        "loftr": lambda: tiny.write_loftr(folder),
    }
    written = set()

    def folder_with(*names: str) -> Path:
        for name in names:
            if name not in written:
                writers[name]()
                written.add(name)
        return folder

    return folder_with
