"""The situations by name. Imports nothing heavy, so that the command line can list them."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from diga3d_warp.scene.synthetic.situations.situation import Situation

SITUATIONS = ("rug", "tiles", "table-edge", "corner", "lawn", "shelf", "bench", "paving", "curved")
"""Each has a module of its name with a function `build`."""


def build_situation(name: str, seed: int) -> Situation:
    """The situation of a name.

    Args:
        name: One of `SITUATIONS`.
        seed: Of layout, materials, sizes, cameras and light.
    """
    import numpy as np

    module = import_module(f"diga3d_warp.scene.synthetic.situations.{name.replace('-', '_')}")
    situation: Situation = module.build(np.random.default_rng([seed, *name.encode()]))
    return situation
