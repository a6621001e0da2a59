"""The page of the ablation: a table for each question, and a picture of each variant."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from itertools import chain
from pathlib import Path

import numpy as np

from diga3d_warp.bench.ablation.measure import SETTINGS, Outcome, Truth, measure, priors_of
from diga3d_warp.bench.ablation.trials import GROUPS, Trial
from diga3d_warp.bench.page import pictures, require_plots, write_page
from diga3d_warp.bench.room import HOLD_OUT, ROOM, true_picture
from diga3d_warp.evaluation.tables import Table
from diga3d_warp.priors.protocol import Prior
from diga3d_warp.scene.load import load_scene
from diga3d_warp.scene.scene import Scene
from diga3d_warp.scene.synthetic.generate import generate

COLUMNS: Mapping[str, tuple[Callable[[Outcome], float], str]] = {
    "PSNR whole [dB]": (lambda found: found.score["whole"].psnr, ".2f"),
    "SSIM": (lambda found: found.score["whole"].ssim, ".3f"),
    "PSNR masked [dB]": (lambda found: found.score["masked"].psnr, ".2f"),
    "SSIM masked": (lambda found: found.score["masked"].ssim, ".3f"),
    "PSNR coarse [dB]": (lambda found: found.coarse_psnr, ".2f"),
    "contrast, coarse [%]": (lambda found: 100 * found.coarse_contrast, ".0f"),
    "disagreement, coarse": (lambda found: found.coarse, ".2f"),
    "disagreement, rendered": (lambda found: found.rendered, ".2f"),
    "depth error [%]": (lambda found: 100 * found.depth_error, ".2f"),
    "edit [s]": (lambda found: found.seconds, ".1f"),
    "memory [MiB]": (lambda found: float(found.peak_mib), ".0f"),
}
"""Figures of an outcome by head, and how they are written."""

NEIGHBOURS = 3
"""Fitted views of the picture, side by side on the arc."""

MARGIN = 8
"""Around the masks of the picture [px]."""


def bench_ablation(out: Path, seeds: int) -> list[Table]:
    """Measure, and write `ablation.md` and `ablation.png`.

    Args:
        out: Folder of the page.
        seeds: Edits of each row, each from a seed of its own.

    Returns:
        The tables of the page.

    Raises:
        InputError: the plots' package is missing, or the folder cannot be written.
    """
    require_plots()
    trials = list(chain.from_iterable(group.values() for group in GROUPS.values()))
    priors = priors_of(trials)
    with tempfile.TemporaryDirectory() as folder:
        scene = load_scene(generate(ROOM, Path(folder) / "room"), hold_out=HOLD_OUT)
        truth, outcomes = measure(scene, trials, seeds, Path(folder), priors)
        draw(out / "ablation.png", scene, truth, outcomes)
    tables = [table(title, group, outcomes, seeds, priors) for title, group in GROUPS.items()]
    floor = truth.disagreement(scene, truth.images)
    command = f"diga3d bench ablation --seeds {seeds} --out {out}"
    write_page(
        out / "ablation.md", "Ablation", command, tables, ["ablation.png"], notes(seeds, floor, priors)
    )
    return tables


def notes(seeds: int, floor: float, priors: Mapping[str, Prior | str]) -> str:
    """Notes of the page.

    Args:
        seeds: Edits of each row.
        floor: Disagreement of the true images [levels of 255].
        priors: What can be measured, and why others cannot.
    """
    missing = "".join(
        f"- **{name}** is not measured: {why}.\n" for name, why in priors.items() if isinstance(why, str)
    )
    return f"""\
The vase of a synthetic room is removed by variants of the method, each with {seeds} seed(s) of the edit; a
cell is their mean and, of more than one, their sample deviation. The room has {ROOM.width} x {ROOM.height} px
and {ROOM.views} views, every {HOLD_OUT}th held out. All variants share one fit of the capture, of
{SETTINGS.fit.iterations} iterations; the hole is fitted in {SETTINGS.refit.iterations} iterations and refined
by TG-SDS in {SETTINGS.distil.iterations}. The tasks retexture and replace are not in the tables.

- **PSNR, SSIM**: held-out views against the room without the vase, over the whole image and within the
  widened masks.
- **PSNR, contrast, coarse**: of the filled views before any fit, where no photograph shows what is behind the
  vase: against the truth, and the deviation of colours there in shares of the truth's. Fills that blur are
  nearer to the truth than sharp ones out of place, and agree better: contrast tells which it is. Pixels that
  no fill reached are left out of these and of the next figure; the picture shows them grey.
- **disagreement**: what no photograph shows behind the vase, warped along the true depth from each fitted
  view into its neighbours: mean absolute difference of colour [levels of 255]. Coarse: of the filled views
  before any fit. Rendered: of the same views of the edited splat. The true images themselves differ by
  {floor:.2f}, since warping resamples their texture; flat fills differ by less.
- **depth error**: median of |z - z*| / z* of the rendered views where no photograph shows the surface.
- **edit**: from the choice of references to the finished splat, wall time. **memory**: most that the process
  held during it, all that it had loaded before included.
{missing}
The picture shows, by columns, the views of {NEIGHBOURS} neighbours as they are filled before the fit, and
below them a held-out view of the edited splat, all with seed 0.
"""


def table(
    title: str,
    group: Mapping[str, Trial],
    outcomes: Mapping[tuple[Trial, int], Outcome],
    seeds: int,
    priors: Mapping[str, Prior | str],
) -> Table:
    """One row for each trial of a group, also for one that was not measured."""
    rows = []
    for name, trial in group.items():
        prior = priors[trial.prior]
        if isinstance(prior, str):
            rows.append([f"{name}: not measured", *["–"] * len(COLUMNS)])
            continue
        found = [outcomes[trial, seed] for seed in range(seeds)]
        rows.append([name, *(cell([of(each) for each in found], form) for of, form in COLUMNS.values())])
    return Table(title, ["", *COLUMNS], rows)


def cell(values: Sequence[float], form: str) -> str:
    """Mean, and the sample's deviation where there is more than one value."""
    mean = format(float(np.mean(values)), form)
    return mean if len(values) == 1 else f"{mean} ± {format(float(np.std(values, ddof=1)), form)}"


def draw(path: Path, scene: Scene, truth: Truth, outcomes: Mapping[tuple[Trial, int], Outcome]) -> None:
    """A stack of pictures for the truth and for each trial, cut to the surroundings of the masks."""
    middle = len(scene.views) // 2
    near = range(max(0, middle - 1), min(len(scene.views), middle - 1 + NEIGHBOURS))
    held_out = scene.test_views[len(scene.test_views) // 2]
    shown = [*(scene.views[i] for i in near), held_out]
    window = _window([view.mask for view in shown if view.mask is not None])
    stacks = {"the room without the vase": [truth.images[i] for i in near]}
    stacks["the room without the vase"].append(true_picture(scene, held_out).numpy())
    drawn: set[Trial] = set()
    for group in GROUPS.values():
        known = set(drawn)  # of earlier tables: what differs in the fine stage alone looks the same
        for name, trial in group.items():
            if (trial, 0) in outcomes and trial.coarse not in known:
                drawn.add(trial.coarse)
                found = outcomes[trial, 0]
                stacks[name] = [*(found.fills[scene.views[i].name] for i in near), found.shown]
    pictures(path, {name: [image[window] for image in stack] for name, stack in stacks.items()}, columns=6)


def _window(masks: Sequence[np.ndarray]) -> tuple[slice, slice]:
    """Rows and columns around all masks."""
    together = np.any(masks, axis=0)
    spans = []
    for axis in (1, 0):
        (where,) = np.nonzero(together.any(axis))
        spans.append(slice(max(0, where[0] - MARGIN), where[-1] + 1 + MARGIN))
    return spans[0], spans[1]
