"""Output of a benchmark: a Markdown page that names machine and command, and plots beside it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.tables import Table
from diga3d_warp.files import whole_file, write_text
from diga3d_warp.pipelines.machine import describe_machine, package_versions

SIZE = (7.0, 3.6)
"""Size of a plot with one pair of axes [inch]."""

DOTS = 130
"""Dots per inch: 910 px wide, which a page shows without scaling up."""


def require_plots() -> None:
    """Check that plots can be drawn, before anything is measured.

    Raises:
        InputError: matplotlib is not installed.
    """
    if find_spec("matplotlib") is None:
        raise InputError(
            "matplotlib, which draws the plots, is not installed: pip install 'diga3d-warp[bench]'"
        )


def write_page(
    path: Path, title: str, command: str, tables: Sequence[Table], plots: Sequence[str], notes: str
) -> None:
    """Write a page of tables and plots.

    Args:
        path: The .md file.
        title: Heading of the page.
        command: Command that reproduces the page.
        tables: Tables in order.
        plots: Names of image files beside the page.
        notes: Notes on how to read the page, Markdown.
    """
    machine, versions = describe_machine(), package_versions()
    made = (
        f"Made by `{command}` on {machine['processor']}, {machine['cores']} cores, {machine['system']}; "
        f"Python {versions['python']}, Warp {versions['warp']}, torch {versions['torch']}."
    )
    parts = [f"# {title}\n", f"{made}\n", notes]
    parts += [f"![{Path(plot).stem}]({plot})\n" for plot in plots]
    parts += [table.markdown() for table in tables]
    write_text(path, "\n".join(parts))


@contextmanager
def plot(path: Path, panels: int = 1) -> Iterator[Any]:
    """Axes to draw on, one or an array of `panels` side by side; saved as a whole PNG at the end."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(SIZE[0] * panels**0.5, SIZE[1]), layout="constrained")
    axes = figure.subplots(1, panels)
    for each in [axes] if panels == 1 else axes:
        each.spines[["top", "right"]].set_visible(False)
        each.grid(axis="y", color="0.9")
        each.set_axisbelow(True)
    yield axes
    with whole_file(path) as partial:
        figure.savefig(partial, dpi=DOTS)


BESIDE = [(5 * side, y) for pair in ((4, -10), (13, -19), (22, -28)) for side in (1, -1) for y in pair]
"""Where a name may stand beside its point, the best place first [points]."""

MARK = 4.0
"""Half the side of the square about a point that names keep clear of [px]."""


def name_points(axes: Any, points: Sequence[tuple[str, tuple[float, float]]]) -> None:
    """Write names beside points, none over another or over a point where there is room.

    The scales of the axes must be set before.
    """
    from matplotlib.transforms import Bbox

    axes.figure.draw_without_rendering()
    taken = [
        Bbox.from_bounds(x - MARK, y - MARK, 2 * MARK, 2 * MARK)
        for x, y in axes.transData.transform([point for _, point in points])
    ]
    for text, point in points:
        name = axes.annotate(text, point, xytext=BESIDE[0], textcoords="offset points", fontsize=7)
        for place in BESIDE:
            name.xyann = place
            name.set_horizontalalignment("left" if place[0] > 0 else "right")
            box = name.get_window_extent()
            if not any(box.overlaps(other) for other in taken):
                break
        taken.append(box)


def bars(path: Path, title: str, parts: Sequence[str], groups: Mapping[str, Sequence[float]]) -> None:
    """Stacked horizontal bars, one a group, its sum written beside it.

    Args:
        path: The .png file.
        title: What the bars show, with unit.
        parts: Names of the parts of a bar.
        groups: Value of each part, by the group's name.
    """
    with plot(path) as axes:
        names = list(groups)
        starts = [0.0] * len(names)
        for index, part in enumerate(parts):
            widths = [groups[name][index] for name in names]
            axes.barh(names, widths, left=starts, label=part, height=0.6)
            starts = [start + width for start, width in zip(starts, widths, strict=True)]
        for row, total in enumerate(starts):
            axes.text(total, row, f" {total:.3g}", va="center")
        axes.invert_yaxis()
        axes.grid(axis="y", visible=False)
        axes.grid(axis="x", color="0.9")
        axes.margins(x=0.12)
        axes.set_title(title, loc="left", fontsize=10)
        # Below: at the right it would hide the sums.
        axes.legend(frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=len(parts))


def lines(
    path: Path,
    panels: Sequence[tuple[str, Sequence[float], Mapping[str, Sequence[float]]]],
    title: str,
) -> None:
    """Curves on logarithmic axes, panels side by side; the last curve of each is a dashed guide.

    Args:
        path: The .png file.
        panels: Name of the horizontal axis, its values, and the values of each curve by name.
        title: What the vertical axes show, with unit.
    """
    with plot(path, len(panels)) as axes:
        for each, (name, places, curves) in zip(axes, panels, strict=True):
            for label, values in curves.items():
                guide = label == list(curves)[-1]
                style = {"color": "0.6", "linestyle": "--"} if guide else {"marker": "o", "markersize": 4}
                each.plot(places, values, label=label, **style)
            each.set(xscale="log", yscale="log", xlabel=name)
        axes[0].set_title(title, loc="left", fontsize=10)
        axes[0].legend(frameon=False)


def pictures(path: Path, stacks: Mapping[str, Sequence[Any]], columns: int = 5) -> None:
    """Pictures one above the other, such stacks in rows of `columns`.

    Args:
        path: The .png file.
        stacks: Pictures by title, from above, RGB in [0, 1], shape (H, W, 3); as many in each stack, all of
            one size.
        columns: Stacks in a row.
    """
    from matplotlib.figure import Figure

    rows = -(-len(stacks) // columns)
    first = next(iter(stacks.values()))
    count, (height, width) = len(first), first[0].shape[:2]
    side = 2.6
    size = (side * columns, rows * (count * side * height / width + 0.3))
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(count * rows, columns, squeeze=False)
    for each in axes.flat:
        each.set_axis_off()
    for index, (title, stack) in enumerate(stacks.items()):
        row, column = divmod(index, columns)
        for below, picture in enumerate(stack):
            axes[count * row + below, column].imshow(picture)
        axes[count * row, column].set_title(title, loc="left", fontsize=10)
    with whole_file(path) as partial:
        figure.savefig(partial, dpi=DOTS)
