"""The `diga3d` command: reads arguments and hands them over; imports nothing heavy before it is needed."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Callable, Sequence

from diga3d_warp.cli.benchmarks import add_benchmarks
from diga3d_warp.cli.edits import add_edits
from diga3d_warp.cli.parsing import EXIT_INPUT, Commands, Help, Parser, Version
from diga3d_warp.cli.results import add_results
from diga3d_warp.cli.trials import add_trials
from diga3d_warp.errors import InputError
from diga3d_warp.process import tune_process

EXIT_INTERRUPTED = 130  # 128 + SIGINT, as shells count

DESCRIPTION = "Edit an object in a captured 3D scene, on 3D Gaussian splats. CPU is enough."
EXAMPLES = """\
examples:
  diga3d demo --out run/demo                         edit a synthetic room, compare with the truth
  diga3d fit captures/garden --out run/garden        fit a splat to photographs and poses
  diga3d remove captures/statue --out run/statue     remove the masked object
  diga3d remove captures/statue --out run/statue --resume
  diga3d retexture captures/bear --prompt "white marble" --out run/bear
  diga3d replace captures/can --prompt "a wooden cube" --out run/can
  diga3d render run/statue --out statue.webm         a video along the cameras
  diga3d eval run/statue                             PSNR and SSIM on held-out views
  diga3d bench kernels                               measure the kernels on this machine
  diga3d doctor                                      check this machine

A capture is a COLMAP, nerfstudio or LLFF / SPIn-NeRF folder, a splat with cameras.json, or photographs alone.
"""


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
    root = Parser(prog="diga3d", description=DESCRIPTION, epilog=EXAMPLES, formatter_class=Help)
    root.add_argument("--version", action=Version)
    commands = Commands(root, "commands", "COMMAND")
    add_edits(commands)
    add_results(commands)
    add_benchmarks(commands)
    add_trials(commands)
    return root
