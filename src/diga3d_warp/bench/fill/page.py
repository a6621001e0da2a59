"""The page of the comparison: tables over all captures and by situation, a plot, pictures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from diga3d_warp.bench.ablation.page import known_cell
from diga3d_warp.bench.captures import Captures
from diga3d_warp.bench.fill.cell import picture_path
from diga3d_warp.bench.fill.figures import Figures
from diga3d_warp.bench.fill.measure import available_priors, measure_all
from diga3d_warp.bench.fill.methods import METHODS, PICTURED, Removal
from diga3d_warp.bench.page import pictures, plot, require_plots, write_page
from diga3d_warp.bench.room import HOLD_OUT
from diga3d_warp.evaluation.tables import Table
from diga3d_warp.priors.protocol import Prior
from diga3d_warp.state import read_picture

Results = Mapping[tuple[str, int], Mapping[str, Figures]]
"""Figures by capture (situation, seed) and method."""

Column = Callable[[Figures], "float | None"]

COLUMNS: Mapping[str, tuple[Column, str]] = {
    "PSNR unseen [dB]": (lambda found: found["unseen"], ".2f"),
    "contrast unseen [%]": (lambda found: _times(100, found["contrast"]), ".0f"),
    "no fill [%]": (lambda found: 100 * found["left"], ".1f"),
    "disagreement": (lambda found: found["disagreement"], ".2f"),
    "PSNR masked [dB]": (lambda found: found["psnr"], ".2f"),
    "SSIM masked": (lambda found: found["ssim"], ".3f"),
    "depth error [%]": (lambda found: _times(100, found["depth_error"]), ".2f"),
    "PSNR elsewhere [dB]": (lambda found: found["elsewhere"], ".2f"),
    "edit [s]": (lambda found: found["seconds"], ".1f"),
}
"""Figures by head, and how they are written."""

BY_SITUATION = ("PSNR unseen [dB]", "PSNR masked [dB]")
"""Heads of the figures that have a table by situation."""


def bench_fill(out: Path, work: Path, captures: Captures) -> list[Table]:
    """Measure, and write `fill.md`, `fill.png` and `fill-pictures.png`.

    Args:
        out: Folder of the page.
        work: Folder of captures and figures; what it holds is not measured again.
        captures: What is filled.

    Returns:
        The tables of the page.

    Raises:
        InputError: the plots' package is missing, a folder cannot be written, or `work` holds figures of
            other settings.
    """
    require_plots()
    priors = available_priors(METHODS)
    results = measure_all(captures, work, priors)
    tables = [overall(results), *(by_situation(results, head) for head in BY_SITUATION)]
    draw_plot(out / "fill.png", results)
    draw_pictures(out / "fill-pictures.png", results, work)
    command = (
        f"diga3d bench fill --situations {','.join(captures.situations)} --seeds {captures.seeds} "
        f"--size {captures.width}x{captures.height} --views {captures.views} --out {out}"
    )
    notes = explained(captures, priors, results)
    write_page(out / "fill.md", "Fills", command, tables, ["fill.png", "fill-pictures.png"], notes)
    return tables


def overall(results: Results) -> Table:
    """A row for each method: mean and deviation over all captures."""
    rows = []
    for method in _methods(results):
        found = [figures[method] for figures in results.values()]
        rows.append(
            [method, *(known_cell([of(each) for each in found], form) for of, form in COLUMNS.values())]
        )
    return Table(f"Mean and deviation over {len(results)} captures", ["", *COLUMNS], rows)


def by_situation(results: Results, head: str) -> Table:
    """A row for each method and a column for each situation: mean and deviation over the seeds."""
    of, form = COLUMNS[head]
    situations = _situations(results)
    rows = []
    for method in _methods(results):
        cells = []
        for situation in situations:
            found = [figures[method] for (name, _), figures in results.items() if name == situation]
            cells.append(known_cell([of(each) for each in found], form))
        rows.append([method, *cells])
    return Table(f"{head}, by situation", ["", *situations], rows)


def draw_plot(path: Path, results: Results) -> None:
    """PSNR of unseen pixels by situation: a mark for each seed, a line through the means of a method.

    Methods that are given all views are left out: before the fit they are nearly the truth.
    """
    situations = _situations(results)
    with plot(path) as axes:
        for method in _methods(results):
            removal = METHODS[method]
            if isinstance(removal, Removal) and removal.given == "all":
                continue
            means = []
            for place, situation in enumerate(situations):
                values = [
                    figures[method]["unseen"] for (name, _), figures in results.items() if name == situation
                ]
                known = [value for value in values if value is not None]
                means.append(np.mean(known) if known else np.nan)
                axes.plot([place] * len(known), known, ".", color="0.7", markersize=4)
            axes.plot(range(len(situations)), means, "o-", label=method, markersize=4, linewidth=1)
        axes.set_xticks(range(len(situations)), situations)
        axes.set_title("PSNR of what no photograph shows, before the fit [dB]", loc="left", fontsize=10)
        axes.legend(frameon=False, fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5))


def draw_pictures(path: Path, results: Results, work: Path) -> None:
    """The captures where the pictured method is best and worst: each method's filled view, and the render."""
    ranked = sorted(
        (value, place)
        for place, figures in results.items()
        if (value := figures[PICTURED]["unseen"]) is not None
    )
    places = [ranked[-1][1], ranked[0][1]]
    stacks = {}
    for title in ("photograph", "truth"):
        shown = [read_picture(picture_path(work, place, title)) for place in places]
        stacks[title] = [image for image in shown for _ in range(2)]
    for method in _methods(results):
        names = (f"{method} filled", f"{method} rendered")
        stacks[method] = [read_picture(picture_path(work, place, name)) for place in places for name in names]
    pictures(path, stacks, columns=len(stacks))


def explained(captures: Captures, priors: Mapping[str, Prior | str], results: Results) -> str:
    """What a reader must know."""
    missing = "".join(
        f"- **{name}** is not measured: {prior}.\n"
        for name, prior in priors.items()
        if isinstance(prior, str)
    )
    settings = captures.settings
    references = settings.method.references if settings.method else Removal().method.references
    return f"""\
The object of synthetic [situations](../situations.md) is removed, each with {captures.seeds} seed(s),
which vary layout, materials, cameras and light; the object casts no shadow, since masks do not hold it.
The captures have {captures.width} x {captures.height} px and {captures.views} views, every {HOLD_OUT}th held
out. All methods share one fit of each capture, of {settings.fit.iterations} iterations; the hole is fitted
in {settings.refit.iterations}. A cell is mean ± sample deviation; over all captures, most of the deviation
is that between the captures.

- **unseen**: pixels of the fitted views where no photograph shows what is behind the object, by the exact
  depth; of the filled views before any fit. Contrast is the deviation of colours there, in shares of the
  truth's: a fill that blurs is nearer to the truth than a sharp one out of place. **no fill**: the share
  that no fill reached, which the figures leave out.
- **disagreement**: unseen pixels of the filled views, warped along the true depth into the neighbours: mean
  absolute difference [levels of 255]. Flat fills agree well.
- **masked**: held-out views of the splat within the widened masks, against the truth; of the two fills of
  each view alone, those views filled in the same way.
- **depth error**: median of |z - z*| / z* of the rendered views in unseen pixels.
- **elsewhere**: views without the object from other places than the cameras', whole images.
- **edit**: wall time from the choice of references to the finished splat, whatever else ran; for fills of
  each view, of all fitted views.
- **true references**, **true views**: {references} references, or all fitted views, are given as they truly
  are, as `--fill` takes them; the former lie on charts, and a classical prior fills what they do not show.
  True views differ from the truth before the fit only where the removal took an unseen pixel for seen. What
  true references lose against true views after the fit is lost by propagation.
{missing}
The pictures show the captures where {PICTURED} is best (upper two rows) and worst (lower two) by PSNR of
unseen pixels: the view with the most of them, as filled and as rendered from the edited splat.
"""


def _methods(results: Results) -> list[str]:
    return list(next(iter(results.values())))


def _situations(results: Results) -> list[str]:
    return list(dict.fromkeys(situation for situation, _ in results))


def _times(factor: float, value: float | None) -> float | None:
    return None if value is None else factor * value
