"""Time of each stage of a fit, against a plain kernel and against targets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from diga3d_warp.bench.garden import Garden, Statistics, project_into, statistics
from diga3d_warp.bench.page import bars, require_plots, write_page
from diga3d_warp.bench.stages import OTHERS, PLAIN, RASTERISER, STAGES, WHOLE, Bench, Seconds, threads
from diga3d_warp.evaluation.tables import Table
from diga3d_warp.pipelines.machine import core_count


@dataclass(frozen=True)
class Wanted:
    """Targets of the kernels on the garden-like scene.

    Attributes:
        rasterise_seconds: Sorting, binning and blending with its adjoint, all cores [s]. A fifth of what
            the fastest CPU rasteriser takes on two cores (OpenSplat, 0.50 + 0.39 s).
        forward_ns, backward_ns: Of a listed pair of pixel and gaussian, on one core [ns].
        whole_gain, rasterise_gain: How many times faster than the plain kernel on one thread.
        thread_gain: How many times faster on two threads than on one.
        others_share: Projection, harmonics, loss and optimiser together, in times of the rasteriser.
    """

    rasterise_seconds: float = 0.18
    forward_ns: float = 1.6
    backward_ns: float = 3.0
    whole_gain: float = 8.0
    rasterise_gain: float = 12.0
    thread_gain: float = 1.6
    others_share: float = 1.0


WANTED = Wanted()


@dataclass(frozen=True)
class Measured:
    """All times of one run of the command.

    Attributes:
        statistics: Workload of the scene.
        one, all: Times of the stages on one thread and on all.
        plain: Times of the plain rasteriser, one thread.
        count: Number of threads of `all`.
    """

    statistics: Statistics
    one: Seconds
    all: Seconds
    plain: Seconds
    count: int


def bench_kernels(out: Path, repeats: int, garden: Garden) -> list[Table]:
    """Measure, and write `kernels.md` and `kernels.png`.

    Args:
        out: Folder for both.
        repeats: Times that each stage is run; the plain kernels run a third as often.
        garden: The scene.

    Returns:
        The tables of the page.

    Raises:
        InputError: the plots' package is missing, or the folder cannot be written.
    """
    require_plots()
    measured = measure(garden, repeats)
    tables = [scene_table(garden, measured), verdicts(measured), stage_table(measured)]
    times = {
        "plain, 1 thread": [_least(measured.plain, (name,)) for name in PLAIN],
        "1 thread": [_forward(measured.one), _backward(measured.one)],
        f"{measured.count} threads": [_forward(measured.all), _backward(measured.all)],
    }
    bars(
        out / "kernels.png",
        f"Rasterising {garden.count:,} gaussians at {garden.width} x {garden.height} px [s]",
        ["forward", "backward"],
        times,
    )
    command = f"diga3d bench kernels --repeats {repeats} --out {out}"
    write_page(out / "kernels.md", "Speed of the kernels", command, tables, ["kernels.png"], NOTES)
    return tables


NOTES = """\
Times are wall times. The best of the repeats says what the code can do; the median, how quiet the machine
was. A listed pair is a pixel and a gaussian that its tile of 16 x 16 px lists, whether or not the gaussian
reaches the pixel. The plain rasteriser (`kernels/plain.py`) runs one pixel a thread on one core with the same
lists.
"""


def measure(garden: Garden, repeats: int) -> Measured:
    """Time a scene on one thread, on all threads and with the plain kernels."""
    bench, count = Bench(garden), core_count()
    found = statistics(project_into(bench.optimiser.gaussians(), garden.camera), garden.camera)
    with threads(1):
        one = {**bench.stages(repeats), **bench.whole(repeats)}
    with threads(count):
        many = {**bench.stages(repeats), **bench.whole(repeats)}
    return Measured(found, one, many, bench.plain(max(1, repeats // 3)), count)


def scene_table(garden: Garden, measured: Measured) -> Table:
    """The scene's statistics beside those of the capture that it imitates."""
    found = measured.statistics
    rows = [
        ("gaussians", f"{garden.count:,}", "120,000"),
        ("image", f"{garden.width} x {garden.height} px", "648 x 420 px"),
        ("opacities", f"{garden.opacity_least} to {garden.opacity_most}", "0.2 to 0.95"),
        ("median radius at 3 sigma", f"{found.median_radius:.1f} px", "10 px"),
        ("pairs of tile and gaussian", f"{found.tile_pairs:,}", "0.39 million"),
        ("pairs of pixel and gaussian", f"{found.listed_pairs:,}", ""),
        ("drawn gaussians", f"{found.drawn:,}", ""),
    ]
    return Table("The scene", ["", "here", "wanted"], rows)


def stage_table(measured: Measured) -> Table:
    """Times of every stage, and of their sums."""
    many = f"{measured.count} threads"
    columns = ["stage", "1 thread [ms]", "median", f"{many} [ms]", "median", "gain", "ns a pair and core"]
    rows = [_stage_row(measured, name, (name,)) for name in STAGES]
    rows.append(_stage_row(measured, "rasteriser", RASTERISER))
    rows.append(_stage_row(measured, "all others", OTHERS))
    rows.append(_stage_row(measured, WHOLE, (WHOLE,)))
    for name in PLAIN:
        least, middle = _least(measured.plain, (name,)), median(measured.plain[name])
        per_pair = f"{1e9 * least / measured.statistics.listed_pairs:.2f}"
        rows.append((name, f"{1e3 * least:.1f}", f"{1e3 * middle:.1f}", "–", "–", "–", per_pair))
    return Table("Stages", columns, rows)


def _stage_row(measured: Measured, name: str, stages: Sequence[str]) -> tuple[str, ...]:
    one, many = _least(measured.one, stages), _least(measured.all, stages)
    cells = []
    for seconds in (measured.one, measured.all):
        middle = sum(median(seconds[stage]) for stage in stages)
        cells += [f"{1e3 * _least(seconds, stages):.1f}", f"{1e3 * middle:.1f}"]
    per_pair = 1e9 * many * measured.count / measured.statistics.listed_pairs
    return (name, *cells, f"{one / many:.2f}", f"{per_pair:.2f}")


def verdicts(measured: Measured) -> Table:
    """A line for each target: the target, the measurement, and whether it is met."""
    pairs = measured.statistics.listed_pairs
    rasterise, once = _least(measured.all, RASTERISER), _least(measured.one, RASTERISER)
    others, others_once = _least(measured.all, OTHERS), _least(measured.one, OTHERS)
    plain = _least(measured.plain, PLAIN) + _least(measured.one, ("sort and bin",))
    nanoseconds = 1e9 * measured.count / pairs
    many = f"{measured.count} threads"
    w = WANTED
    rows = [
        _at_most(f"rasterise, forward and backward, {many} [s]", rasterise, w.rasterise_seconds),
        _at_most("forward, a listed pair and core [ns]", nanoseconds * _forward(measured.all), w.forward_ns),
        _at_most(
            "backward, a listed pair and core [ns]", nanoseconds * _backward(measured.all), w.backward_ns
        ),
        _at_least(
            f"whole step, {many}, against the plain kernel on one [times]",
            (plain + others_once) / _least(measured.all, (WHOLE,)),
            w.whole_gain,
        ),
        _at_least(
            f"rasterise, {many}, against the plain kernel on one [times]", plain / rasterise, w.rasterise_gain
        ),
        _at_least(f"rasterise, {many} against one [times]", once / rasterise, w.thread_gain),
        _at_most("all other stages, in rasterisers [times]", others / rasterise, w.others_share),
    ]
    return Table("Targets", ["", "wanted", "found", "verdict"], rows)


def _at_most(name: str, found: float, limit: float) -> tuple[str, str, str, str]:
    verdict = "met" if found <= limit else f"missed by {100 * (found / limit - 1):.0f} %"
    return name, f"≤ {limit:g}", f"{found:.3g}", verdict


def _at_least(name: str, found: float, limit: float) -> tuple[str, str, str, str]:
    verdict = "met" if found >= limit else f"missed by {100 * (1 - found / limit):.0f} %"
    return name, f"≥ {limit:g}", f"{found:.3g}", verdict


def _forward(seconds: Mapping[str, Sequence[float]]) -> float:
    return _least(seconds, ("sort and bin", "blend"))


def _backward(seconds: Mapping[str, Sequence[float]]) -> float:
    return _least(seconds, ("blend adjoint", "sum rows"))


def _least(seconds: Mapping[str, Sequence[float]], stages: Sequence[str]) -> float:
    """Best time of stages together [s]."""
    return sum(min(seconds[stage]) for stage in stages)
