"""Scaffold-GS against plain gaussians: the same capture, the same seconds of fitting, the same edit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from diga3d_warp.bench.page import write_page
from diga3d_warp.config import Effects
from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.record import read_manifest, run_effects
from diga3d_warp.evaluation.tables import Table
from diga3d_warp.gaussians.parameters import PLY, Gaussians
from diga3d_warp.gaussians.representation import Representation
from diga3d_warp.gaussians.scaffold.anchors import ANCHORS
from diga3d_warp.gaussians.storage import load
from diga3d_warp.pipelines import stages
from diga3d_warp.pipelines.contents import everything
from diga3d_warp.pipelines.fit import fit, fit_settings, requested_fit
from diga3d_warp.pipelines.remove import remove
from diga3d_warp.pipelines.request import FitRequest
from diga3d_warp.scene.load import load_scene
from diga3d_warp.scene.scene import Scene, View
from diga3d_warp.scene.working_frame import WorkingFrame
from diga3d_warp.state import read_mask

PILOT = 0.1
"""Part of the iterations of a first fit of anchors, which tells how long one takes: all parts of a fit are
parts of its iterations, so a short one has the shares of a long one."""

PILOT_LEAST = 100
"""Iterations of the pilot at least, if the fit has as many: a shorter one would mostly measure its start."""

OF_FITS = ("effects", "fit", "views")
"""Stages that are not part of an edit, nor is baking."""


@dataclass(frozen=True)
class Cell:
    """A capture fitted with one representation.

    Attributes:
        capture, representation: Their names.
        iterations: Of the fit.
        seconds: Wall time of the fit [s].
        rows: Gaussians or anchors at its end.
        megabytes: Size of its file [MB].
        psnr: Against the held-out photographs [dB].
        baked: The same of the gaussians that anchors are baked to; of plain ones it is `psnr` [dB].
        baking: Wall time of that [s]; 0 for plain ones.
        edit: Wall time of the stages of a removal [s]; None where the capture has no masks.
        beside: PSNR of the result of the removal, outside its masks, against the held-out photographs [dB].
        changed: Mean change of the held-out views within its masks [levels of 255].
    """

    capture: str
    representation: str
    iterations: int
    seconds: float
    rows: int
    megabytes: float
    psnr: float
    baked: float
    baking: float
    edit: float | None = None
    beside: float | None = None
    changed: float | None = None


def bench_representation(
    scenes: Sequence[Path], out: Path, work: Path, *, iterations: int | None = None, image_scale: float = 1.0,
    seed: int = 0,
) -> list[Table]:  # fmt: skip
    """Measure, and write `representation.md`.

    Args:
        scenes: Captures; those with masks get a removal, too.
        out: Folder of the page.
        work: Folder of the runs; finished ones are not run again.
        iterations: Of the fit of plain gaussians; None chooses by the capture.
        image_scale: As `fit` takes it.
        seed: Of all fits.

    Returns:
        The tables of the page.

    Raises:
        InputError: a capture is not usable, or holds out no views.
    """
    cells = [cell for scene in scenes for cell in _measured(scene, work, iterations, image_scale, seed)]
    tables = [_fits(cells)]
    if any(cell.edit is not None for cell in cells):
        tables.append(_edits([cell for cell in cells if cell.edit is not None]))
    command = f"diga3d bench representation {' '.join(map(str, scenes))} --out {out}"
    write_page(out / "representation.md", "Anchors against plain gaussians", command, tables, [], NOTES)
    return tables


NOTES = """\
Anchors (Scaffold-GS) get as many iterations as take the seconds of the fit of plain gaussians, by a pilot fit
of a tenth of them. PSNR is the mean over the views that are held out. "baked" is that of the standard
gaussians in `point_cloud.ply`, to which anchors are baked; the seconds of that are not part of the fit's.
Sizes are those of `scaffold.npz`, deflated, and of the 3DGS `.ply`, both float32.
"""


def _measured(path: Path, work: Path, iterations: int | None, image_scale: float, seed: int) -> list[Cell]:
    folder = work / path.name
    scene = load_scene(path, image_scale=image_scale)
    if not scene.test_views:
        raise InputError(f"{path} has too few photographs to hold one out, and nothing to measure on")
    count = fit_settings(scene, iterations).iterations
    plain = _ran(scene, folder / "gaussians", "gaussians", count, seed)
    pilot = max(min(PILOT_LEAST, count), round(PILOT * count))
    per_iteration = _pilot(scene, folder / "pilot", pilot, seed) / pilot
    wanted = max(1, round(plain.seconds / per_iteration))
    return [plain, _ran(scene, folder / "scaffold", "scaffold", wanted, seed)]


def _pilot(scene: Scene, folder: Path, iterations: int, seed: int) -> float:
    """Seconds of a fit of anchors."""
    request = FitRequest(
        scene=scene, out=folder, representation="scaffold", iterations=iterations, seed=seed, resume=True
    )
    settings = requested_fit(scene, request)
    run = request.open_run("fit", scene, iterations)
    run.hold_to(**everything(scene, settings, seed, {}))
    stages.fit_source(run, stages.begin(run, scene), settings, seed)
    run.close()
    return _seconds(folder)["fit"]


def _ran(scene: Scene, folder: Path, representation: str, iterations: int, seed: int) -> Cell:
    """A fit, or a removal with its fit, and what was measured of it."""
    options: dict[str, Any] = {
        "representation": representation, "iterations": iterations, "seed": seed, "resume": True,
    }  # fmt: skip
    masked = any(view.mask is not None for view in scene.views)
    (remove if masked else fit)(scene, folder / "run", **options)
    return _cell(scene, folder / "run", representation, iterations, masked)


def _cell(scene: Scene, folder: Path, representation: str, iterations: int, masked: bool) -> Cell:
    seconds, effects = _seconds(folder), run_effects(read_manifest(folder))
    views = _held_out(scene, effects)
    fitted = load(folder / "stages" / "fit")
    bake = folder / "stages" / "bake-fit"
    file = folder / "stages" / "fit" / (PLY if representation == "gaussians" else ANCHORS)
    shell = stages.shell_in(folder)
    psnr = _psnr(fitted, shell, views, effects)
    cell = Cell(
        scene.path.name, representation, iterations, seconds["fit"], len(fitted), file.stat().st_size / 1e6,
        psnr, _psnr(load(bake), shell, views, effects) if bake.is_dir() else psnr,
        seconds.get("bake-fit", 0.0),
    )  # fmt: skip
    if not masked:
        return cell
    edit = sum(
        spent for name, spent in seconds.items() if name not in OF_FITS and not name.startswith("bake-")
    )
    masks = {view.name: read_mask(folder / "masks" / f"{view.name}.png") for view in views}
    beside, changed = _edited(folder, views, masks, effects)
    return replace(cell, edit=edit, beside=beside, changed=changed)


def _edited(
    folder: Path, views: Sequence[View], masks: dict[str, np.ndarray], effects: Effects
) -> tuple[float, float]:
    """`Cell.beside` and `Cell.changed` of a removal."""
    stage = [name for name in _seconds(folder) if name in ("refit", "distil")][-1]
    before, after = (load(folder / "stages" / name) for name in ("fit", stage))
    shell = stages.shell_in(folder)
    change, count = 0.0, 0
    for view in views:
        first, second = (
            stages.shown(each, shell, view.camera, effects).astype(float) for each in (before, after)
        )
        inside = masks[view.name]
        change += float(np.abs(first - second)[inside].sum())
        count += 3 * int(inside.sum())
    outside = {name: ~mask for name, mask in masks.items()}
    return _psnr(after, shell, views, effects, outside), change / max(count, 1)


def _held_out(scene: Scene, effects: Effects) -> list[View]:
    """The held-out views as the stages of a run have them, in working units."""
    working = WorkingFrame.of(scene).working_scene(scene)
    return list((working if effects.lens else working.without_lens()).test_views)


def _psnr(
    splat: Representation, shell: Gaussians | None, views: Sequence[View], effects: Effects,
    where: dict[str, np.ndarray] | None = None,
) -> float:  # fmt: skip
    """Mean PSNR of the views' photographs [dB]."""
    found = []
    for view in views:
        shown = stages.shown(splat, shell, view.camera, effects).astype(float)
        error = (shown - view.pixels) ** 2
        error = error if where is None else error[where[view.name]]
        found.append(-10.0 * np.log10(max(float(error.mean()) / 255.0**2, 1e-12)))
    return float(np.mean(found))


def _seconds(folder: Path) -> dict[str, float]:
    return {stage["name"]: stage["seconds"] for stage in read_manifest(folder)["stages"]}


def _fits(cells: Sequence[Cell]) -> Table:
    columns = [
        "capture", "", "iterations", "fit [s]", "rows", "file [MB]", "PSNR held out [dB]", "baked [dB]",
        "baking [s]",
    ]  # fmt: skip
    rows = [
        (
            cell.capture, cell.representation, str(cell.iterations), f"{cell.seconds:.0f}", str(cell.rows),
            f"{cell.megabytes:.1f}", f"{cell.psnr:.2f}", f"{cell.baked:.2f}", f"{cell.baking:.0f}",
        )
        for cell in cells
    ]  # fmt: skip
    return Table("Fits of equal time", columns, rows)


def _edits(cells: Sequence[Cell]) -> Table:
    columns = ["capture", "", "removal [s]", "PSNR outside the masks [dB]", "change within them [levels]"]
    rows = [
        (
            cell.capture, cell.representation, f"{cell.edit:.0f}", f"{cell.beside:.2f}",
            f"{cell.changed:.1f}",
        )
        for cell in cells
    ]  # fmt: skip
    return Table("A removal on each", columns, rows)
