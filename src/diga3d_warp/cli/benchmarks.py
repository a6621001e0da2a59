"""The bench command: one subcommand for each benchmark."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from diga3d_warp.cli.parsing import Commands, path, positive_int, scale, seed, size
from diga3d_warp.errors import InputError
from diga3d_warp.scene.synthetic.situations.catalogue import SITUATIONS


def add_benchmarks(commands: Commands) -> None:
    """bench, with kernels, effects, accuracy and ablation."""
    bench = commands.add(
        "bench",
        _kernels,
        "measure kernels, effects, accuracy and parts of the method",
        "diga3d bench kernels --out run/benchmarks",
    )
    benchmarks = Commands(bench, "benchmarks", "BENCHMARK")

    kernels = _add(
        benchmarks,
        "kernels",
        _kernels,
        "speed of every kernel, against a plain one",
        "Measure the speed of every kernel on a seeded scene, against a plain kernel.",
    )
    _add_count(kernels, "--repeats", 9, REPEATS)
    kernels.add_argument(
        "--sizes", action="store_true", help="cost against the number of gaussians and pixels instead"
    )
    effects = _add(
        benchmarks,
        "effects",
        _effects,
        "cost of each effect, on and off",
        "Measure what each effect adds to a training step, and compare the kernels' sources.",
    )
    _add_count(effects, "--repeats", 25, REPEATS)
    accuracy = _add(
        benchmarks,
        "accuracy",
        _accuracy,
        "error and time of each accuracy setting",
        "Measure error and time of every accuracy setting, on easy and on hard scenes.",
    )
    _add_count(accuracy, "--repeats", 5, REPEATS)
    accuracy.add_argument(
        "--scene", type=path, metavar="DIR", help="a run, or a capture with a splat, to be measured too"
    )
    accuracy.add_argument(
        "--pipeline",
        action="store_true",
        help="quality and time of a removal by references, iterations and diffusion steps instead",
    )
    ablation = _add(
        benchmarks,
        "ablation",
        _ablation,
        "effect of each part of the method on a removal",
        "Remove the object of synthetic situations, leaving out one part of the method at a time. "
        "If interrupted, it goes on where it was.",
    )
    ablation.add_argument(
        "--prior",
        default="exemplar",
        metavar="PRIOR",
        help="prior of the method: exemplar, or a network as the edits take it (default exemplar)",
    )
    _add_captures(ablation, ("rug", "tiles", "table-edge"), "run/bench_ablation")
    prompts = _add(
        benchmarks,
        "prompts",
        _prompts,
        "edits by text against the generator's truth",
        "Retexture and replace the object of synthetic situations by text with a network, and compare with "
        "the truth. If interrupted, it goes on where it was.",
    )
    prompts.add_argument("--prior", required=True, metavar="PRIOR", help="a network, as the edits take it")
    _add_captures(prompts, ("rug", "tiles", "table-edge"), "run/bench_prompts")
    fill = _add(
        benchmarks,
        "fill",
        _fill,
        "quality of fills where no photograph shows the background",
        "Remove the object of synthetic situations by each method, and compare with the truth. "
        "If interrupted, it goes on where it was.",
    )
    _add_captures(fill, SITUATIONS, "run/bench_fill")
    fill.add_argument(
        "--size", type=size, default=(160, 120), metavar="WxH", help="of the captures (default 160x120)"
    )
    _add_count(fill, "--views", 16, "views of a capture, every 4th held out")
    representation = _add(
        benchmarks,
        "representation",
        _representation,
        "anchors (Scaffold-GS) against plain gaussians",
        "Fit captures with anchors and with gaussians for the same time, and remove the object of those that "
        "have masks. If interrupted, it goes on where it was.",
    )
    representation.add_argument(
        "scenes", nargs="+", type=path, metavar="SCENE", help="folder of a capture, with masks or without"
    )
    representation.add_argument(
        "--iterations", type=positive_int, metavar="N", help="of the gaussians' fit (default: by the views)"
    )
    representation.add_argument(
        "--image-scale", type=scale, default=1.0, metavar="S", help="image size (default 1)"
    )
    representation.add_argument("--seed", type=seed, default=0, metavar="N", help="random seed (default 0)")
    representation.add_argument(
        "--work",
        type=path,
        default=Path("run/bench_representation"),
        metavar="DIR",
        help="folder of the runs; what it holds is not run again (default run/bench_representation)",
    )


def _add_captures(benchmark: argparse.ArgumentParser, usual: Sequence[str], work: str) -> None:
    """Synthetic captures, and the folder that keeps what was measured of them."""
    benchmark.add_argument(
        "--situations",
        type=situations,
        default=usual,
        metavar="NAME,...",
        help=f"(default {','.join(usual)}; there are {','.join(SITUATIONS)})",
    )
    _add_count(benchmark, "--seeds", 3, "captures of each situation")
    benchmark.add_argument(
        "--work",
        type=path,
        default=Path(work),
        metavar="DIR",
        help=f"folder of captures and figures; what it holds is not measured again (default {work})",
    )


def situations(text: str) -> tuple[str, ...]:
    names = tuple(text.split(","))
    unknown = [name for name in names if name not in SITUATIONS]
    if unknown:
        raise argparse.ArgumentTypeError(
            f"no situation is called {unknown[0]!r}: use {', '.join(SITUATIONS)}"
        )
    return tuple(dict.fromkeys(names))


REPEATS = "times each measurement is repeated"


def _add(
    benchmarks: Commands, name: str, run: Callable[..., int], summary: str, description: str
) -> argparse.ArgumentParser:
    """A benchmark with the one option that all have."""
    example = f"diga3d bench {name} --out run/benchmarks"
    benchmark = benchmarks.add(name, _in_checkout(run), summary, example, description)
    benchmark.add_argument(
        "--out",
        type=path,
        default=Path("run/benchmarks"),
        metavar="DIR",
        help="folder for the page and its plots (default run/benchmarks)",
    )
    return benchmark


def _in_checkout(run: Callable[..., int]) -> Callable[..., int]:
    """`run`, or a one-line error where benchmarks are not installed: they are not part of the wheel."""

    def checked(**options: Any) -> int:
        if find_spec("diga3d_warp.bench") is None:
            raise InputError(
                "the benchmarks are not part of the installed package: run them in a checkout of the source, "
                "after pip install -e ."
            )
        return run(**options)

    return checked


def _add_count(benchmark: argparse.ArgumentParser, option: str, usual: int, what: str) -> None:
    benchmark.add_argument(
        option, type=positive_int, default=usual, metavar="N", help=f"{what} (default {usual})"
    )


def _kernels(out: Path, repeats: int, sizes: bool) -> int:
    from diga3d_warp.bench.garden import Garden
    from diga3d_warp.bench.kernels import bench_kernels
    from diga3d_warp.bench.sizes import bench_sizes

    for table in bench_sizes(out, repeats) if sizes else bench_kernels(out, repeats, Garden()):
        print(table.text())
    print(out / ("sizes.md" if sizes else "kernels.md"))
    return 0


def _effects(out: Path, repeats: int) -> int:
    from diga3d_warp.bench.effects import bench_effects

    for table in bench_effects(out, repeats):
        print(table.text())
    print(out / "effects.md")
    return 0


def _accuracy(out: Path, repeats: int, scene: Path | None, pipeline: bool) -> int:
    if pipeline and scene is not None:
        raise InputError("--pipeline measures a room of its own: leave --scene out")
    from diga3d_warp.bench.accuracy.page import bench_accuracy
    from diga3d_warp.bench.accuracy.pipeline import bench_pipeline

    for table in bench_pipeline(out) if pipeline else bench_accuracy(out, repeats, scene):
        print(table.text())
    print(out / ("accuracy_pipeline.md" if pipeline else "accuracy.md"))
    return 0


def _ablation(out: Path, prior: str, situations: tuple[str, ...], seeds: int, work: Path) -> int:
    from diga3d_warp.bench.ablation.page import bench_ablation, page_name
    from diga3d_warp.bench.captures import Captures

    for table in bench_ablation(out, work, Captures(situations, seeds), prior):
        print(table.text())
    print(out / f"{page_name(prior)}.md")
    return 0


def _prompts(out: Path, prior: str, situations: tuple[str, ...], seeds: int, work: Path) -> int:
    from diga3d_warp.bench.captures import Captures
    from diga3d_warp.bench.prompts.page import bench_prompts, page_name

    for table in bench_prompts(out, work, Captures(situations, seeds), prior):
        print(table.text())
    print(out / f"{page_name(prior)}.md")
    return 0


def _fill(
    out: Path, situations: tuple[str, ...], seeds: int, size: tuple[int, int], views: int, work: Path
) -> int:
    from diga3d_warp.bench.captures import Captures
    from diga3d_warp.bench.fill.page import bench_fill

    width, height = size
    captures = Captures(situations, seeds, width, height, views)
    for table in bench_fill(out, work, captures):
        print(table.text())
    print(out / "fill.md")
    return 0


def _representation(
    scenes: Sequence[Path], out: Path, work: Path, iterations: int | None, image_scale: float, seed: int
) -> int:
    from diga3d_warp.bench.representation import bench_representation

    tables = bench_representation(
        scenes, out, work, iterations=iterations, image_scale=image_scale, seed=seed
    )
    for table in tables:
        print(table.text())
    print(out / "representation.md")
    return 0
