"""`diga3d bench accuracy`: every knob and preset measured, as tables and a plot of error against time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from statistics import geometric_mean

from diga3d_warp.bench.accuracy.knobs import KNOBS, PRESETS, STANDARD, Way, ways
from diga3d_warp.bench.accuracy.measure import Error, Found, error, measure, pareto_front, ratios
from diga3d_warp.bench.accuracy.reprojection import reprojection_table
from diga3d_warp.bench.accuracy.rounding import NOTE, rounding, rounding_table
from diga3d_warp.bench.accuracy.scenes import Subject, captured, subjects
from diga3d_warp.bench.page import name_points, plot, require_plots, write_page
from diga3d_warp.evaluation.tables import Table

Results = Mapping[str, Mapping[Way, Found]]
"""What was measured, by scene and way to render."""

FRONT = "●"


def bench_accuracy(out: Path, repeats: int, scene: Path | None) -> list[Table]:
    """Measure, and write `accuracy.md` and `accuracy.png`.

    Args:
        out: Folder for both.
        repeats: Times that each way to render is timed.
        scene: A run, or a capture with a splat, to be measured beside the built-in scenes.

    Returns:
        The tables of the page.

    Raises:
        InputError: the plots' package is missing, `scene` holds no splat, or `out` cannot be written.
    """
    require_plots()
    measured = [*subjects(), *([] if scene is None else [captured(scene)])]
    names = ways()
    results = {subject.name: measure(subject, names, repeats) for subject in measured}
    tables = [
        preset_table(results),
        knob_table(results),
        rounding_table({subject.name: rounding(subject) for subject in measured}),
        reprojection_table(repeats),
        *(scene_table(subject, results[subject.name], names) for subject in measured),
    ]
    draw(out / "accuracy.png", results)
    command = f"diga3d bench accuracy --repeats {repeats} --out {out}"
    if scene is not None:
        command += f" --scene {scene}"
    write_page(out / "accuracy.md", "What accuracy costs", command, tables, ["accuracy.png"], notes())
    return tables


NOTES = """\
The truth is the same renderer in float64 with nothing left out: every pixel in its own order of depth,
unscented footprints, cut-offs at 1e-9. Errors are those of colour, 1 being white. The error of gradients is
|g - g'| / |g'| for a random weight of each pixel and channel, of the parameter that is furthest off. Times
are the best of the repeats, in those of STANDARD in the same run. The front holds what nothing else beats:
nothing is as exact and faster, or as fast and more exact. Times within 3 % and errors within 1 % count as
equal.

`diga3d fit`, `remove`, `retexture`, `replace` and `render` take a preset by `--accuracy`, Python takes any
`Accuracy`. A kernel is compiled for the values that it needs, so what is not turned costs nothing.

"""


def notes() -> str:
    """Notes of the page: definition of errors and times, and the approximation of each setting."""
    return (
        NOTES + NOTE + "".join(f"- **{knob.name}** (`{knob.attribute}`): {knob.meaning}.\n" for knob in KNOBS)
    )


def preset_table(results: Results) -> Table:
    """Errors and times of the presets over all scenes."""
    front = dict(zip(_ways_of(results), pareto_front(_points(results)), strict=True))
    rows = []
    for name, way in PRESETS.items():
        errors = [found[way].error for found in results.values()]
        rows.append((name, *_cells(_worst(errors)), *_times(results, way), FRONT if front[way] else ""))
    columns = ["", *HEADS, "forward", "backward", "together", "front"]
    return Table("Presets: error in the worst scene, mean time", columns, rows)


def knob_table(results: Results) -> Table:
    """Each knob alone: its own error, which is the difference to STANDARD with this knob at its exact end."""
    rows = []
    for knob in KNOBS:
        for label, way in knob.settings.items():
            name = f"{knob.name} {label}" + (" (standard)" if way == STANDARD else "")
            if way == knob.exact:
                cells = ["–"] * len(HEADS)
            else:
                cells = _cells(_worst([error(each[way], each[knob.exact]) for each in results.values()]))
            rows.append((name, *cells, *_times(results, way)))
    columns = ["knob", *HEADS, "forward", "backward", "together"]
    return Table("Knobs: each one's own error in the worst scene, mean time", columns, rows)


def scene_table(subject: Subject, found: Mapping[Way, Found], names: Mapping[Way, str]) -> Table:
    """All ways to render one scene against the truth."""
    front = pareto_front([(each.seconds, each.error.root_mean_square) for each in found.values()])
    rows = []
    for (way, each), best in zip(found.items(), front, strict=True):
        times = [f"{1e3 * each.forward:.1f}", f"{1e3 * each.backward:.1f}", f"{ratios(found, way)[2]:.2f}"]
        rows.append((names[way], *_cells(each.error), *times, FRONT if best else ""))
    camera = subject.camera
    title = (
        f"Scene “{subject.name}” against the truth: {len(subject.gaussians):,} gaussians, "
        f"{camera.width} x {camera.height} px"
    )
    return Table(title, ["", *HEADS, "forward [ms]", "backward [ms]", "times", "front"], rows)


LEAST_ERROR = 1e-9
"""Root mean square error of colour drawn for zero error, which has no logarithm; below float32 rounding."""

HEADS = ("PSNR [dB]", "max", "mean", "gradient")


def _cells(found: Error) -> list[str]:
    return [f"{found.psnr:.1f}", *(f"{x:.1e}" for x in (found.largest, found.mean, found.gradient))]


def _worst(errors: Sequence[Error]) -> Error:
    return Error(
        min(each.psnr for each in errors),
        max(each.largest for each in errors),
        max(each.mean for each in errors),
        max(each.gradient for each in errors),
    )


def _times(results: Results, way: Way) -> list[str]:
    shares = zip(*(ratios(found, way) for found in results.values()), strict=True)
    return [f"{geometric_mean(share):.2f}" for share in shares]


def _ways_of(results: Results) -> list[Way]:
    return list(next(iter(results.values())))


def _points(results: Results) -> list[tuple[float, float]]:
    """Time in those of STANDARD and root mean square error of each way, geometric means over the scenes."""
    return [
        (
            geometric_mean(ratios(found, way)[2] for found in results.values()),
            _mean_error(found[way].error for found in results.values()),
        )
        for way in _ways_of(results)
    ]


def draw(path: Path, results: Results) -> None:
    """Left, error against time with the front; right, the own error of each knob away from its exact end."""
    points = dict(zip(_ways_of(results), _points(results), strict=True))
    front = pareto_front(list(points.values()))
    best = sorted(point for point, on in zip(points.values(), front, strict=True) if on)
    named: list[tuple[str, tuple[float, float]]] = []
    with plot(path, 2) as (whole, own):
        whole.plot(*zip(*best, strict=True), color="0.8", linewidth=6, solid_capstyle="round", label="front")
        for knob in KNOBS:
            whole.plot(
                *zip(*(points[way] for way in knob.settings.values()), strict=True),
                marker="o", markersize=4, linewidth=1, label=knob.name,
            )  # fmt: skip
            turned = {label: way for label, way in knob.settings.items() if way != knob.exact}
            places = [(points[way][0], _own_error(results, way, knob.exact)) for way in turned.values()]
            own.plot(*zip(*places, strict=True), marker="o", markersize=4, linewidth=1, label=knob.name)
            named += zip(turned, places, strict=True)
        for way in PRESETS.values():
            whole.plot(*points[way], marker="*", markersize=12, color="black", linestyle="none")
        whole.set_title("Root mean square error of colour", loc="left", fontsize=10)
        own.set_title("Each knob's own error", loc="left", fontsize=10)
        for axes in (whole, own):
            axes.set(xscale="log", yscale="log", xlabel="time, in those of STANDARD")
        whole.legend(frameon=False, fontsize=7)
        name_points(whole, [(name, points[way]) for name, way in PRESETS.items()])
        name_points(own, named)


def _own_error(results: Results, way: Way, exact: Way) -> float:
    """Root mean square difference that one knob makes, geometric mean over the scenes."""
    return _mean_error(error(each[way], each[exact]) for each in results.values())


def _mean_error(errors: Iterable[Error]) -> float:
    """Geometric mean of root mean square errors, where none at all counts as the least that is drawn."""
    return geometric_mean(max(each.root_mean_square, LEAST_ERROR) for each in errors)
