"""Fill all captures by each method; what was measured before is not measured again."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from diga3d_warp.bench.captures import Captures
from diga3d_warp.bench.fill.cell import Cell
from diga3d_warp.bench.fill.figures import Figures
from diga3d_warp.bench.fill.methods import METHODS, PerView, Removal
from diga3d_warp.errors import InputError
from diga3d_warp.priors.named import load_prior
from diga3d_warp.priors.protocol import Prior


def available_priors(methods: Mapping[str, PerView | Removal]) -> dict[str, Prior | str]:
    """Priors of the methods by name; for one that cannot be loaded, a line that says why."""
    found: dict[str, Prior | str] = {}
    for method in methods.values():
        if isinstance(method, Removal) and method.prior not in found:
            try:
                found[method.prior] = load_prior(method.prior)
            except InputError as error:
                found[method.prior] = str(error)
    return found


def measure_all(
    captures: Captures,
    folder: Path,
    priors: Mapping[str, Prior | str],
    methods: Mapping[str, PerView | Removal] = METHODS,
) -> dict[tuple[str, int], dict[str, Figures]]:
    """Figures of each method on each capture.

    Args:
        captures: What is filled.
        folder: Keeps captures, figures and pictures of each cell; what it holds is taken as it is.
        priors: From `available_priors`; methods whose prior is missing are left out.
        methods: By name.

    Raises:
        InputError: the folder holds figures of other settings.
    """
    wanted = {
        name: method
        for name, method in methods.items()
        if not (isinstance(method, Removal) and isinstance(priors[method.prior], str))
    }
    captures.hold_to(folder)
    return {
        (situation, seed): Cell(captures, situation, seed, folder, priors).figures(wanted)
        for situation, seed in captures.cells
    }
