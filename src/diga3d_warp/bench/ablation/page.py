"""The page of the ablation: a table for each question, and a picture of each variant."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import chain
from pathlib import Path

import numpy as np

from diga3d_warp.bench.ablation.cell import NEIGHBOURS, Cell
from diga3d_warp.bench.ablation.measure import Figures, priors_of
from diga3d_warp.bench.ablation.trials import Groups, Trial, groups_of
from diga3d_warp.bench.captures import Captures
from diga3d_warp.bench.page import pictures, require_plots, write_page
from diga3d_warp.bench.room import HOLD_OUT
from diga3d_warp.evaluation.tables import Table
from diga3d_warp.priors.protocol import Prior

COLUMNS: Mapping[str, tuple[Callable[[Figures], float], str]] = {
    "PSNR whole [dB]": (lambda found: found["psnr"], ".2f"),
    "SSIM": (lambda found: found["ssim"], ".3f"),
    "PSNR masked [dB]": (lambda found: found["psnr_masked"], ".2f"),
    "SSIM masked": (lambda found: found["ssim_masked"], ".3f"),
    "PSNR coarse [dB]": (lambda found: found["coarse_psnr"], ".2f"),
    "contrast, coarse [%]": (lambda found: 100 * found["coarse_contrast"], ".0f"),
    "disagreement, coarse": (lambda found: found["coarse"], ".2f"),
    "disagreement, rendered": (lambda found: found["rendered"], ".2f"),
    "depth error [%]": (lambda found: 100 * found["depth_error"], ".2f"),
    "edit [s]": (lambda found: found["seconds"], ".1f"),
    "memory [MiB]": (lambda found: found["peak_mib"], ".0f"),
}
"""Figures of a removal by head, and how they are written."""

PAIRED = ("PSNR masked [dB]", "disagreement, coarse", "disagreement, rendered")
"""Figures whose difference from the usual method is given, too: captures differ by more than variants do."""

Results = Mapping[tuple[str, int], Mapping[Trial, Figures]]
"""Figures by capture (situation, seed) and trial."""


def bench_ablation(out: Path, work: Path, captures: Captures, prior: str) -> list[Table]:
    """Measure, and write the page and its picture: `ablation.md`, or `ablation_PRIOR.md`.

    Args:
        out: Folder of the page.
        work: Folder of captures and figures; what it holds is not measured again.
        captures: What is edited.
        prior: As `priors.named.load_prior` takes it.

    Returns:
        The tables of the page.

    Raises:
        InputError: the plots' package is missing, the prior cannot be loaded, a folder cannot be written, or
            `work` holds figures of other settings.
    """
    require_plots()
    groups = groups_of(prior)
    trials = list(chain.from_iterable(group.values() for group in groups.values()))
    priors = priors_of(trials)
    captures.hold_to(work)
    cells = {place: Cell(captures, *place, work, priors) for place in captures.cells}
    results = {place: cell.figures(trials) for place, cell in cells.items()}
    name = page_name(prior)
    draw(out / f"{name}.png", groups, next(iter(cells.values())), priors)
    tables = [table(title, group, results, Trial(prior=prior)) for title, group in groups.items()]
    command = (
        f"diga3d bench ablation --prior {prior} --situations {','.join(captures.situations)} "
        f"--seeds {captures.seeds} --out {out}"
    )
    floor = float(np.mean([cell.floor for cell in cells.values()]))
    told = notes(captures, floor, priors)
    write_page(out / f"{name}.md", f"Ablation: {prior}", command, tables, [f"{name}.png"], told)
    return tables


def page_name(prior: str) -> str:
    """Name of a prior's page without its ending."""
    return "ablation" if prior == "exemplar" else f"ablation_{Path(prior).name}"


def notes(captures: Captures, floor: float, priors: Mapping[str, Prior | str]) -> str:
    """Notes of the page.

    Args:
        captures: What is edited.
        floor: Disagreement of the true images [levels of 255].
        priors: What can be measured, and why others cannot.
    """
    missing = "".join(
        f"- **{name}** is not measured: {why}.\n" for name, why in priors.items() if isinstance(why, str)
    )
    settings = captures.settings
    return f"""\
The object of synthetic [situations](../situations.md) is removed by variants of the method:
{", ".join(captures.situations)}, each with {captures.seeds} seed(s) of capture and edit. A cell is the mean
over the captures and their sample deviation, most of which is that between captures. **against the first
row**: mean of the differences from the first row of the first table on the same capture, and the standard
error of that mean. The captures have {captures.width} x {captures.height} px and {captures.views} views,
every {HOLD_OUT}th held out. All variants share one fit of each capture, of {settings.fit.iterations}
iterations; the hole is fitted in {settings.refit.iterations} iterations and refined by TG-SDS in
{settings.distil.iterations}. Charts of the surfaces behind the object are off but for the row that names
them.

- **PSNR, SSIM**: held-out views against the scene without the object, over the whole image and within the
  widened masks.
- **PSNR, contrast, coarse**: of the filled views before any fit, where no photograph shows what is behind the
  object: against the truth, and the deviation of colours there in shares of the truth's. Fills that blur are
  nearer to the truth than sharp ones out of place, and agree better: contrast tells which it is. Pixels that
  no fill reached are left out of these and of the next figure; the picture shows them grey.
- **disagreement**: what no photograph shows behind the object, warped along the true depth from each fitted
  view into its neighbours: mean absolute difference of colour [levels of 255]. Coarse: of the filled views
  before any fit. Rendered: of the same views of the edited splat. The true images themselves differ by
  {floor:.2f}, since warping resamples their texture; flat fills differ by less.
- **depth error**: median of |z - z*| / z* of the rendered views where no photograph shows the surface.
- **edit**: from the choice of references to the finished splat, wall time. **memory**: most that the process
  held during it, all that it had loaded before included.
{missing}
The picture shows, by columns, the views of {NEIGHBOURS} neighbours as they are filled before the fit, and
below them a held-out view of the edited splat, all of the first capture.
"""


def table(title: str, group: Mapping[str, Trial], results: Results, usual: Trial) -> Table:
    """One row for each trial of a group, also for one that was not measured."""
    rows = []
    for name, trial in group.items():
        found = [figures[trial] for figures in results.values() if trial in figures]
        if not found:
            rows.append([f"{name}: not measured", *["–"] * (len(COLUMNS) + len(PAIRED))])
            continue
        cells = [cell([of(each) for each in found], form) for of, form in COLUMNS.values()]
        for head in PAIRED:
            of, form = COLUMNS[head]
            against = [of(figures[trial]) - of(figures[usual]) for figures in results.values()]
            cells.append("0" if trial == usual else difference(against, form))
        rows.append([name, *cells])
    heads = [f"{head.replace(' [dB]', '')} against the first row" for head in PAIRED]
    return Table(title, ["", *COLUMNS, *heads], rows)


def cell(values: Sequence[float], form: str) -> str:
    """Mean, and the sample's deviation where there is more than one value."""
    mean = format(float(np.mean(values)), form)
    return mean if len(values) == 1 else f"{mean} ± {format(float(np.std(values, ddof=1)), form)}"


def known_cell(values: Sequence[float | None], form: str) -> str:
    """`cell` of the values that there are; a dash if there is none."""
    known = [value for value in values if value is not None]
    return cell(known, form) if known else "–"


def difference(values: Sequence[float], form: str) -> str:
    """Mean with its sign, and its standard error where there is more than one value."""
    mean = format(float(np.mean(values)), f"+{form}")
    if len(values) == 1:
        return mean
    return f"{mean} ± {format(float(np.std(values, ddof=1) / len(values) ** 0.5), form)}"


def draw(path: Path, groups: Groups, shown: Cell, priors: Mapping[str, Prior | str]) -> None:
    """A stack of pictures for the truth and for each trial, cut to the surroundings of the masks."""
    stacks = {"the scene without the object": shown.pictures(None)}
    drawn: set[Trial] = set()
    for group in groups.values():
        known = set(drawn)  # of earlier tables: what differs in the fine stage alone looks the same
        for name, trial in group.items():
            if not isinstance(priors[trial.prior], str) and trial.coarse not in known:
                drawn.add(trial.coarse)
                stacks[name] = shown.pictures(trial)
    pictures(path, stacks, columns=6)
