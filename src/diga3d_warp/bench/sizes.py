"""What a step of a fit costs in time and memory, against the number of gaussians and of pixels.

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
from diga3d_warp.process import tune_process

COUNTS = (10_000, 30_000, 120_000, 400_000, 1_000_000)
"""Gaussians, at 648 x 420 px."""

IMAGES = ((384, 260), (648, 420), (1200, 820), (1760, 1136))
"""Image sizes [px], 0.1 to 2 megapixels, at 120,000 gaussians."""

COUNT, IMAGE = 120_000, (648, 420)

TOLERANCE = 1.1
"""Growth of time over growth of pairs that still counts as no faster [ratio]: the noise of a measurement."""


@dataclass(frozen=True)
class Size:
    """What one size took.

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
    by_count = [run_size(count, *IMAGE, repeats) for count in COUNTS]
    by_image = [
        by_count[COUNTS.index(COUNT)] if image == IMAGE else run_size(COUNT, *image, repeats)
        for image in IMAGES
    ]
    tables = [
        size_table(f"Number of gaussians, at {IMAGE[0]} x {IMAGE[1]} px", by_count),
        size_table(f"Size of the image, with {COUNT:,} gaussians", by_image),
        growth_table(by_count, by_image),
    ]
    lines(
        out / "sizes.png",
        [
            ("gaussians", [size.count for size in by_count], _curves(by_count)),
            ("megapixels", [size.pixels / 1e6 for size in by_image], _curves(by_image)),
        ],
        "seconds of a step",
    )
    command = f"diga3d bench kernels --sizes --repeats {repeats} --out {out}"
    write_page(out / "sizes.md", "Cost against size", command, tables, ["sizes.png"], NOTES)
    return tables


NOTES = """\
One step of a fit on all cores. More gaussians are smaller ones, so that they cover the image as often. Memory
is the peak that scene, optimiser and step add to a fresh process. Binning is the part of rasterising that
sorts, bins and sums rows; blending is the rest. A listed pair costs the more the more often the gaussian does
reach the pixel, since blocks of pixels that it does not reach are passed over: larger images with the same
number of gaussians have larger gaussians, of whose listed pairs more are blended, so that their time grows
between the two.
"""


def run_size(count: int, width: int, height: int, repeats: int) -> Size:
    """Measure one size in a process of its own.

    Raises:
        InputError: the process died, most likely for want of memory.
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


def size_table(title: str, sizes: Sequence[Size]) -> Table:
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
            f"{1e9 * size.rasterise / size.listed_pairs:.2f}",
            f"{1e9 * size.rasterise / size.blended_pairs:.2f}",
            f"{size.peak_mib}",
        )
        for size in sizes
    ]
    columns = [
        "gaussians", "image [px]", "listed pairs [million]", "blended [million]", "rasterise [ms]",
        "binning [ms]", "others [ms]", "ns a listed pair", "ns a blended one", "peak [MiB]",
    ]  # fmt: skip
    return Table(title, columns, rows)


def growth_table(by_count: Sequence[Size], by_image: Sequence[Size]) -> Table:
    """Does time grow with the pairs, and how much memory do a gaussian and a pixel take?"""
    rows = []
    for name, sizes in (("gaussians", by_count), ("pixels", by_image)):
        # From the default size on: below it, what every launch costs hides the pairs.
        start, end = next(size for size in sizes if size.count == COUNT), sizes[-1]
        time, pairs = end.rasterise / start.rasterise, end.listed_pairs / start.listed_pairs
        blended = end.blended_pairs / start.blended_pairs
        verdict = "met" if time <= TOLERANCE * pairs else "missed"
        rows.append(
            (f"rasterising grows no faster than listed pairs, by {name}",
             f"{time:.2f} times, listed pairs {pairs:.2f}, blended ones {blended:.2f}", verdict)
        )  # fmt: skip
    mib = 1024 * 1024
    first, last = by_count[0], by_count[-1]
    a_gaussian = mib * (last.peak_mib - first.peak_mib) / (last.count - first.count)
    rows.append(("memory of one more gaussian", f"{a_gaussian:.0f} bytes", ""))
    first, last = by_image[0], by_image[-1]
    a_pixel = mib * (last.peak_mib - first.peak_mib) / (last.pixels - first.pixels)
    rows.append(("memory of one more pixel, with the pairs it brings", f"{a_pixel:.0f} bytes", ""))
    return Table("Growth", ["", "found", "verdict"], rows)


def _curves(sizes: Sequence[Size]) -> dict[str, list[float]]:
    """Times, and how they would grow with the pairs."""
    a_pair = sizes[-1].rasterise / sizes[-1].listed_pairs
    return {
        "rasterise": [size.rasterise for size in sizes],
        "others": [size.others for size in sizes],
        "in proportion to pairs": [a_pair * size.listed_pairs for size in sizes],
    }


if __name__ == "__main__":
    tune_process()
    print(json.dumps(asdict(measure(*map(int, sys.argv[1:])))))
