"""Time and memory of a step of a fit, against the number of gaussians and of pixels.

Each size runs in a process of its own, so that its peak of memory is its own: `python -m
diga3d_warp.bench.sizes COUNT WIDTH HEIGHT REPEATS` prints one line of JSON.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from diga3d_warp.bench.page import lines, require_plots, write_page
from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.tables import Table
from diga3d_warp.process import give_memory_back, tune_process

COUNTS = (10_000, 30_000, 120_000, 400_000, 1_000_000)
"""Gaussians, at 648 x 420 px."""

IMAGES = ((384, 260), (648, 420), (1200, 820), (1760, 1136))
"""Image sizes [px], 0.1 to 2 megapixels, once with 120,000 gaussians and once with as many a pixel."""

COUNT, IMAGE = 120_000, (648, 420)
"""Where all three series meet."""


@dataclass(frozen=True)
class Size:
    """Time and memory of one size.

    Attributes:
        count: Gaussians.
        width, height: Image size [px].
        listed_pairs: Pairs of a pixel and a gaussian that its tile lists.
        blended_pairs: Those of them in which the gaussian has a weight above 0.
        rasterise: Best time of sorting, binning and blending with its adjoint [s].
        binning: The part of it that sorts and bins, and sums rows: work by gaussians as much as by pairs [s].
        others: Best time of the other stages together [s].
        peak_mib: Memory that the scene, its optimiser and a step of a fit added to the process at most [MiB].
    """

    count: int
    width: int
    height: int
    listed_pairs: int
    blended_pairs: int
    rasterise: float
    binning: float
    others: float
    peak_mib: int

    @property
    def pixels(self) -> int:
        return self.width * self.height

    @property
    def step(self) -> float:
        """Best time of all stages together [s]."""
        return self.rasterise + self.others


@dataclass(frozen=True)
class Series:
    """Growing sizes, and the quantity that grows."""

    name: str
    sizes: Sequence[Size]


def bench_sizes(out: Path, repeats: int) -> list[Table]:
    """Measure all sizes, and write `sizes.md` and `sizes.png`.

    Args:
        out: Folder for both.
        repeats: Times that each stage is run.

    Returns:
        The tables of the page.

    Raises:
        InputError: the plots' package is missing, or a size needs more memory than there is.
    """
    require_plots()
    measured = {(COUNT, *IMAGE): run_size(COUNT, *IMAGE, repeats)}

    def size_of(count: int, width: int, height: int) -> Size:
        key = (count, width, height)
        if key not in measured:
            measured[key] = run_size(*key, repeats)
        return measured[key]

    density = COUNT / (IMAGE[0] * IMAGE[1])
    series = [
        Series(f"by gaussians, at {IMAGE[0]} x {IMAGE[1]} px", [size_of(count, *IMAGE) for count in COUNTS]),
        Series(
            "by pixels, with as many gaussians a pixel",
            [size_of(round(density * width * height), width, height) for width, height in IMAGES],
        ),
        Series(f"by pixels, with {COUNT:,} gaussians", [size_of(COUNT, *image) for image in IMAGES]),
    ]
    tables = [*(size_table(one) for one in series), growth_table(series), memory_table(series)]
    lines(
        out / "sizes.png",
        [
            ("gaussians", [size.count for size in series[0].sizes], _curves(series[0])),
            *(("megapixels", [size.pixels / 1e6 for size in one.sizes], _curves(one)) for one in series[1:]),
        ],
        "seconds of a step",
    )
    command = f"diga3d bench kernels --sizes --repeats {repeats} --out {out}"
    write_page(out / "sizes.md", "Cost against size", command, tables, ["sizes.png"], NOTES)
    return tables


NOTES = """\
One step of a fit on all cores. Gaussians are the smaller the more there are on so many pixels: they cover the
image as often. Memory is the peak that scene, optimiser and step add to a fresh process. Binning is the part
of rasterising that sorts, bins and sums rows; blending is the rest. A step is rasterising and the others.

A listed pair is a pixel and a gaussian that its tile lists, a blended one has a weight above 0. Blocks of
pixels that a gaussian does not reach are passed over, so a listed pair costs the less the smaller the
gaussian is beside its tile. The same number of gaussians on more pixels is larger ones: a larger part of what
is listed is blended, and rasterising alone grows faster than listed pairs, though more slowly than blended
ones. A step has stages that cost the same whatever the pixels.
"""


def run_size(count: int, width: int, height: int, repeats: int) -> Size:
    """Measure one size in a process of its own.

    Raises:
        InputError: the process died, most likely out of memory.
    """
    words = [str(number) for number in (count, width, height, repeats)]
    command = [sys.executable, "-m", "diga3d_warp.bench.sizes", *words]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True)
    if done.returncode != 0:
        raise InputError(
            f"measuring {count:,} gaussians at {width} x {height} px ended with code {done.returncode}: "
            "free memory, or see the lines above"
        )
    return Size(**json.loads(done.stdout.splitlines()[-1]))


def measure(count: int, width: int, height: int, repeats: int) -> Size:
    """Measure one size in this process, which should be a fresh one."""
    import torch

    from diga3d_warp.bench.garden import Garden, project_into, statistics
    from diga3d_warp.bench.stages import OTHERS, RASTERISER, Bench
    from diga3d_warp.pipelines.machine import peak_mib, reset_peak
    from diga3d_warp.splatting.attribution import shares

    Bench(Garden(count=100, width=32, height=32)).stages(1)  # load kernels and libraries
    give_memory_back()  # of a compiler that may have run
    reset_peak()
    before = peak_mib()
    garden = Garden(count=count, width=width, height=height)
    bench = Bench(garden)
    seconds = bench.stages(repeats)
    bench.whole(1)
    peak = peak_mib() - before
    projection = project_into(bench.optimiser.gaussians(), garden.camera)
    hits = shares(projection, torch.zeros(height, width, 3)).hits
    best = {name: min(times) for name, times in seconds.items()}
    return Size(
        count,
        width,
        height,
        statistics(projection, garden.camera).listed_pairs,
        int(hits.sum()),
        rasterise=sum(best[name] for name in RASTERISER),
        binning=best["sort and bin"] + best["sum rows"],
        others=sum(best[name] for name in OTHERS),
        peak_mib=peak,
    )


def size_table(series: Series) -> Table:
    """One row a size."""
    rows = [
        (
            f"{size.count:,}",
            f"{size.width} x {size.height}",
            f"{size.listed_pairs / 1e6:.1f}",
            f"{size.blended_pairs / 1e6:.1f}",
            f"{1e3 * size.rasterise:.0f}",
            f"{1e3 * size.binning:.0f}",
            f"{1e3 * size.others:.0f}",
            f"{1e3 * size.step:.0f}",
            f"{1e9 * size.rasterise / size.listed_pairs:.2f}",
            f"{1e9 * size.rasterise / size.blended_pairs:.2f}",
            f"{size.peak_mib}",
        )
        for size in series.sizes
    ]
    columns = [
        "gaussians", "image [px]", "listed pairs [million]", "blended [million]", "rasterise [ms]",
        "binning [ms]", "others [ms]", "step [ms]", "ns a listed pair", "ns a blended one", "peak [MiB]",
    ]  # fmt: skip
    return Table(series.name[0].upper() + series.name[1:], columns, rows)


def growth_table(series: Sequence[Series]) -> Table:
    """Does time grow no faster than the listed pairs, from the first size to the last?

    Judged of a whole step, which is what a fit costs, and of rasterising alone.
    """
    rows = []
    for one in series:
        start, end = one.sizes[0], one.sizes[-1]
        listed = end.listed_pairs / start.listed_pairs
        times = [end.step / start.step, end.rasterise / start.rasterise]
        judged = [f"{time:.2f}, {'met' if time <= listed else 'missed'}" for time in times]
        blended = end.blended_pairs / start.blended_pairs
        rows.append((one.name, f"{listed:.2f}", *judged, f"{blended:.2f}"))
    columns = ["time grows no faster than listed pairs", "listed", "a step", "rasterising", "blended pairs"]
    return Table("Growth [times]", columns, rows)


def memory_table(series: Sequence[Series]) -> Table:
    """Memory per gaussian and per pixel."""
    by_count, _, by_pixels = (one.sizes for one in series)
    bytes_of = {
        "one more gaussian": _slope(by_count, [size.count for size in by_count]),
        "one more pixel, with the pairs it brings": _slope(by_pixels, [size.pixels for size in by_pixels]),
    }
    return Table("Memory", ["", "bytes"], [(name, f"{value:.0f}") for name, value in bytes_of.items()])


def _slope(sizes: Sequence[Size], amounts: Sequence[int]) -> float:
    """Bytes per additional gaussian or pixel, from the first size to the last."""
    return 2**20 * (sizes[-1].peak_mib - sizes[0].peak_mib) / (amounts[-1] - amounts[0])


def _curves(series: Series) -> dict[str, list[float]]:
    """Times, and proportional growth with the pairs as a guide."""
    sizes = series.sizes
    a_pair = sizes[0].step / sizes[0].listed_pairs
    return {
        "step": [size.step for size in sizes],
        "rasterise": [size.rasterise for size in sizes],
        "others": [size.others for size in sizes],
        "in proportion to pairs": [a_pair * size.listed_pairs for size in sizes],
    }


if __name__ == "__main__":
    tune_process()
    print(json.dumps(asdict(measure(*map(int, sys.argv[1:])))))
