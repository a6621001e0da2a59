"""The `diga3d` command: reads arguments and hands them over; imports nothing heavy before it is needed."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from diga3d_warp.errors import InputError
from diga3d_warp.process import tune_process

EXIT_INPUT = 2
EXIT_INTERRUPTED = 130  # 128 + SIGINT, as shells count
SEED_MOST = 2**31 - 1  # what every generator here takes

DESCRIPTION = "Edit an object in a captured 3D scene, on 3D Gaussian splats. CPU is enough."
EXAMPLES = """\
examples:
  diga3d demo --out run/demo                         edit a synthetic room, compare with the truth
  diga3d fit captures/garden --out run/garden        photographs and poses to a splat .ply
  diga3d remove captures/statue --out run/statue     take the masked object out
  diga3d remove captures/statue --out run/statue --resume
  diga3d retexture captures/bear --prompt "white marble" --out run/bear
  diga3d replace captures/can --prompt "a wooden cube" --out run/can
  diga3d render run/statue --out statue.webm         a video along the cameras
  diga3d eval run/statue                             PSNR and SSIM on held-out views
  diga3d bench kernels                               how fast are the kernels here?
  diga3d doctor                                      is everything in place on this machine?

A capture is a folder of COLMAP, nerfstudio or LLFF / SPIn-NeRF, a splat .ply with cameras, or just images.
"""


class Help(argparse.RawDescriptionHelpFormatter):
    """Keeps the examples as they are and leaves room for the longest option."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, max_help_position=32, width=100)


class Parser(argparse.ArgumentParser):
    """A parser whose errors take one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(EXIT_INPUT, f"diga3d: error: {message} (see {self.prog} --help)\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the `diga3d` command.

    Args:
        arguments: Without the program's name; those of the process if None.

    Returns:
        Exit code: 0 done, 1 a check of `doctor` failed, 2 bad input, 130 interrupted.
    """
    tune_process()
    words = list(sys.argv[1:] if arguments is None else arguments)
    options = vars(parser().parse_args(words))
    command: Callable[..., int] = options.pop("run")
    try:
        return command(**options)
    except InputError as error:
        print(f"diga3d: error: {' '.join(str(error).split())}", file=sys.stderr)
        return EXIT_INPUT
    except KeyboardInterrupt:
        hint = ""
        if "resume" in options:
            again = shlex.join(["diga3d", *words, *([] if options["resume"] else ["--resume"])])
            hint = f"; go on with: {again}"
        print(f"\ndiga3d: interrupted{hint}", file=sys.stderr)
        return EXIT_INTERRUPTED


def parser() -> argparse.ArgumentParser:
    """The command's parser with all subcommands."""
    root = Parser(
        prog="diga3d",
        description=DESCRIPTION,
        epilog=EXAMPLES,
        formatter_class=Help,
    )
    root.add_argument("--version", action=_Version)
    commands = root.add_subparsers(
        title="commands", required=True, metavar="COMMAND [-h]", parser_class=Parser
    )

    def add(name: str, run: Callable[..., int], summary: str, example: str) -> argparse.ArgumentParser:
        command = commands.add_parser(
            name,
            help=summary,
            description=summary[0].upper() + summary[1:] + ".",
            epilog=f"example:\n  {example}",
            formatter_class=Help,
        )
        command.set_defaults(run=run)
        return command

    fit = add("fit", _fit, "fit a splat to a capture", "diga3d fit captures/garden --out run/garden")
    _add_run_options(fit)

    remove = add(
        "remove",
        _remove,
        "remove the masked object from a capture",
        "diga3d remove captures/statue --out run/statue --masks captures/statue/masks",
    )
    _add_run_options(remove)
    _add_mask_boxes(remove)
    _add_prior(remove)
    _add_reference_options(remove)

    retexture = add(
        "retexture",
        _retexture,
        "give the masked object another material",
        'diga3d retexture captures/bear --prompt "white marble" --out run/bear',
    )
    _add_run_options(retexture)
    _add_mask_boxes(retexture)
    retexture.add_argument(
        "--prompt", required=True, metavar="TEXT", help="the material; a word of the built-in vocabulary"
    )
    _add_reference_options(retexture)

    replace = add(
        "replace",
        _replace,
        "put another object in place of the masked one",
        'diga3d replace captures/can --prompt "a wooden cube" --out run/can',
    )
    _add_run_options(replace)
    _add_mask_boxes(replace)
    new = replace.add_mutually_exclusive_group(required=True)
    new.add_argument("--prompt", metavar="TEXT", help='a built-in solid in a material: "a wooden cube"')
    new.add_argument(
        "--asset", type=Path, metavar="FILE", help="a mesh (.glb, .obj, .ply, .stl) or a splat .ply"
    )
    _add_prior(replace)
    _add_reference_options(replace)

    render = add("render", _render, "render a run along a path", "diga3d render run/statue --out statue.webm")
    render.add_argument("folder", type=Path, metavar="RUN", help="folder of a finished run")
    render.add_argument(
        "--out",
        type=Path,
        metavar="FILE|DIR",
        help="a .webm, .mp4 or .avi video, or a folder for PNG frames (default RUN/path.webm)",
    )
    render.add_argument(
        "--path",
        choices=["spline", "views"],
        default="spline",
        help="a smooth path through the views, or the views themselves (default spline)",
    )
    render.add_argument(
        "--frames", type=_positive_int, default=120, metavar="N", help="frames of a spline (default 120)"
    )
    render.add_argument(
        "--size", type=_size, metavar="WxH", help="size of a frame in pixels (default that of the first view)"
    )

    _add_accuracy(render, "of the frames")

    evaluate = add("eval", _evaluate, "measure a run on held-out views", "diga3d eval run/statue")
    evaluate.add_argument("folder", type=Path, metavar="RUN", help="folder of a finished run")
    evaluate.add_argument(
        "--protocol",
        choices=["held-out", "spin-nerf"],
        default="held-out",
        help="against held-out photographs, or a SPIn-NeRF scene's ground truth (default held-out)",
    )
    evaluate.add_argument(
        "--image-scale", type=_scale, metavar="S", help="size of the images (default that of the run)"
    )

    _add_benchmarks(
        add(
            "bench",
            _bench_kernels,
            "measure what kernels, effects and accuracy cost on this machine",
            "diga3d bench kernels --out run/benchmarks",
        )
    )

    add("doctor", _doctor, "check that everything is in place on this machine", "diga3d doctor")

    synthetic = add(
        "synthetic",
        _synthetic,
        "write a synthetic capture with ground truth",
        "diga3d synthetic run/room --views 24",
    )
    synthetic.add_argument("out", type=Path, metavar="OUT", help="a new folder")
    synthetic.add_argument("--width", type=_positive_int, default=320, metavar="PX")
    synthetic.add_argument("--height", type=_positive_int, default=240, metavar="PX")
    synthetic.add_argument("--views", type=_positive_int, default=24, metavar="N")
    synthetic.add_argument("--no-shadows", action="store_true", help="the object casts no shadow")
    synthetic.add_argument("--seed", type=_seed, default=0, metavar="N")

    demo = add("demo", _demo, "edit the object of a synthetic room and compare", "diga3d demo --out run/demo")
    demo.add_argument("--out", type=Path, default=Path("run/demo"), metavar="DIR", help="(default run/demo)")
    return root


def _add_benchmarks(bench: argparse.ArgumentParser) -> None:
    """One subcommand for each benchmark."""
    benchmarks = bench.add_subparsers(
        title="benchmarks", required=True, metavar="BENCHMARK [-h]", parser_class=Parser
    )

    def add(name: str, run: Callable[..., int], summary: str, description: str, repeats: int) -> Parser:
        benchmark = benchmarks.add_parser(
            name,
            help=summary,
            description=description,
            epilog=f"example:\n  diga3d bench {name} --out run/benchmarks",
            formatter_class=Help,
        )
        benchmark.set_defaults(run=run)
        benchmark.add_argument(
            "--out",
            type=Path,
            default=Path("run/benchmarks"),
            metavar="DIR",
            help="folder for the page and its plots (default run/benchmarks)",
        )
        benchmark.add_argument(
            "--repeats",
            type=_positive_int,
            default=repeats,
            metavar="N",
            help=f"times each measurement is repeated (default {repeats})",
        )
        return benchmark

    kernels = add(
        "kernels",
        _bench_kernels,
        "speed of every kernel, against a plain one",
        "Measure the speed of every kernel on a seeded scene, against a plain kernel.",
        9,
    )
    kernels.add_argument(
        "--sizes", action="store_true", help="cost against the number of gaussians and pixels instead"
    )
    add(
        "effects",
        _bench_effects,
        "what each effect costs on, and that it costs nothing off",
        "Measure what each effect adds to a training step, and compare the kernels' sources.",
        25,
    )
    accuracy = add(
        "accuracy",
        _bench_accuracy,
        "what each knob of accuracy costs in error and in time",
        "Measure error and time of every knob of accuracy, on easy and on hard scenes.",
        5,
    )
    accuracy.add_argument(
        "--scene", type=Path, metavar="DIR", help="a run, or a capture with a splat, to be measured too"
    )
    accuracy.add_argument(
        "--pipeline",
        action="store_true",
        help="what references, iterations and diffusion steps of a removal cost instead",
    )


def _add_run_options(command: argparse.ArgumentParser) -> None:
    command.add_argument("scene", type=Path, metavar="SCENE", help="folder or .ply of the capture")
    command.add_argument("--out", type=Path, required=True, metavar="RUN", help="the run folder, a new one")
    command.add_argument(
        "--masks", type=Path, metavar="DIR", help="a mask for each image (default: found in the capture)"
    )
    command.add_argument(
        "--image-scale",
        type=_scale,
        default=1.0,
        metavar="S",
        help="size of the images against the largest in the capture (default 1)",
    )
    command.add_argument(
        "--iterations", type=_positive_int, metavar="N", help="steps of the fit (default: by the scene)"
    )
    command.add_argument(
        "--hold-out",
        type=_hold_out,
        default=8,
        metavar="N",
        help="keep every Nth view for testing, 0 for none (default 8)",
    )
    command.add_argument(
        "--effects",
        type=_effects,
        default={},
        metavar="LIST",
        help="insist on effects, such as sh_degree=1,exposure=off (default: by the scene)",
    )
    _add_accuracy(command, "of the renderings that are fitted")
    command.add_argument("--seed", type=_seed, default=0, metavar="N", help="(default 0)")
    command.add_argument("--resume", action="store_true", help="go on with an interrupted run")


def _add_accuracy(command: argparse.ArgumentParser, of_what: str) -> None:
    command.add_argument(
        "--accuracy",
        choices=["draft", "standard", "exact"],
        default="standard",
        help=f"{of_what}, against their time (default standard)",
    )


def _add_mask_boxes(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--mask-box",
        dest="mask_boxes",
        nargs=5,
        action="append",
        default=[],
        metavar=("VIEW", "X0", "Y0", "X1", "Y1"),
        help="a box [px] around the object in one view, in place of masks; up to three, from other sides",
    )


def _add_prior(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--prior",
        choices=["exemplar", "classical"],
        default="exemplar",
        help="what invents the part that no view saw (default exemplar)",
    )


def _add_reference_options(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--references",
        type=_positive_int,
        default=3,
        metavar="K",
        help="views that are edited first and stand for all (default 3)",
    )
    command.add_argument(
        "--selection",
        choices=["kmeans", "random"],
        default="kmeans",
        help="how references are chosen (default kmeans)",
    )


class _Version(argparse.Action):
    """Looks the version up only when asked: reading package metadata takes a while."""

    def __init__(self, option_strings: Sequence[str], dest: str, **_: Any) -> None:
        super().__init__(option_strings, dest=argparse.SUPPRESS, nargs=0, help="show the version and exit")

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from importlib.metadata import version

        parser.exit(message=f"diga3d {version('diga3d-warp')}\n")


def _positive_int(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number above 0")
    return int(text)


def _effects(text: str) -> dict[str, bool | int]:
    from diga3d_warp.effects.overrides import parse_overrides

    try:
        return parse_overrides(text)
    except InputError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _hold_out(text: str) -> int:
    if not text.isdecimal() or int(text) == 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not 0 (hold out none) or a whole number above 1")
    return int(text)


def _seed(text: str) -> int:
    if not text.isdecimal() or int(text) > SEED_MOST:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 0 to {SEED_MOST}")
    return int(text)


def _scale(text: str) -> float:
    try:
        scale = float(text)
    except ValueError:
        scale = 0.0
    if not 0.0 < scale <= 1.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number above 0 and up to 1")
    return scale


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal() and int(width) > 0 and int(height) > 0):
        raise argparse.ArgumentTypeError(f"{text!r} is not a size such as 640x480")
    return int(width), int(height)


def _fit(**options: Any) -> int:
    from diga3d_warp.pipelines.fit import fit_command

    return _show_run(fit_command(**options))


def _remove(**options: Any) -> int:
    from diga3d_warp.pipelines.remove import remove_command

    return _show_run(remove_command(**options))


def _retexture(**options: Any) -> int:
    from diga3d_warp.pipelines.retexture import retexture_command

    return _show_run(retexture_command(**options))


def _replace(**options: Any) -> int:
    from diga3d_warp.pipelines.replace import replace_command

    return _show_run(replace_command(**options))


def _show_run(run: Any) -> int:
    """End with what a user opens next."""
    from diga3d_warp.evaluation.record import REPORT, RESULT

    print(run.folder / RESULT)
    print(run.folder / REPORT)
    return 0


def _render(
    folder: Path, out: Path | None, path: str, frames: int, size: tuple[int, int] | None, accuracy: str
) -> int:
    from diga3d_warp.config import ACCURACIES
    from diga3d_warp.pipelines.render import render_path

    print(render_path(folder, out, path=path, frames=frames, size=size, accuracy=ACCURACIES[accuracy]))
    return 0


def _evaluate(folder: Path, protocol: str, image_scale: float | None) -> int:
    from diga3d_warp.evaluation.protocols import evaluate
    from diga3d_warp.evaluation.report import write_report

    for table in evaluate(folder, protocol, image_scale=image_scale):
        print(table.text())
    print(write_report(folder))
    return 0


def _doctor() -> int:
    from diga3d_warp.doctor import examine

    return examine()


def _bench_effects(out: Path, repeats: int) -> int:
    from diga3d_warp.bench.effects import bench_effects

    for table in bench_effects(out, repeats):
        print(table.text())
    print(out / "effects.md")
    return 0


def _bench_kernels(out: Path, repeats: int, sizes: bool) -> int:
    from diga3d_warp.bench.garden import Garden
    from diga3d_warp.bench.kernels import bench_kernels
    from diga3d_warp.bench.sizes import bench_sizes

    for table in bench_sizes(out, repeats) if sizes else bench_kernels(out, repeats, Garden()):
        print(table.text())
    print(out / ("sizes.md" if sizes else "kernels.md"))
    return 0


def _bench_accuracy(out: Path, repeats: int, scene: Path | None, pipeline: bool) -> int:
    from diga3d_warp.bench.accuracy.page import bench_accuracy
    from diga3d_warp.bench.accuracy.pipeline import bench_pipeline

    for table in bench_pipeline(out) if pipeline else bench_accuracy(out, repeats, scene):
        print(table.text())
    print(out / ("accuracy_pipeline.md" if pipeline else "accuracy.md"))
    return 0


def _synthetic(out: Path, width: int, height: int, views: int, no_shadows: bool, seed: int) -> int:
    from diga3d_warp.scene.synthetic.generate import SyntheticScene, generate

    settings = SyntheticScene(width=width, height=height, views=views, shadows=not no_shadows, seed=seed)
    print(generate(settings, out, progress=True))
    return 0


def _demo(out: Path) -> int:
    from diga3d_warp.pipelines.demo import run_demo

    run_demo(out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
