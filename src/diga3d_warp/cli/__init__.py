"""The `diga3d` command: reads arguments and hands them over; imports nothing heavy before it is needed."""

from __future__ import annotations

import argparse
import io
import os
import shlex
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from diga3d_warp.cli.benchmarks import add_benchmarks
from diga3d_warp.cli.edits import add_edits
from diga3d_warp.cli.experiments import add_experiments
from diga3d_warp.cli.parsing import EXIT_INPUT, Commands, Help, Parser, Version
from diga3d_warp.cli.results import add_results
from diga3d_warp.cli.signals import Stopped, exit_code, last_line, stoppable
from diga3d_warp.cli.study import add_study
from diga3d_warp.cli.trials import add_trials
from diga3d_warp.errors import InputError, explained, out_of_memory
from diga3d_warp.process import tune_process

EXIT_UNHEARD = 141  # 128 + SIGPIPE, as shells count

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
  diga3d export run/statue --format spz              the splat for other programs
  diga3d study run/ours run/lama --out study.html    a page on which people vote
  diga3d experiment table1 --data spin-nerf --out run/table1
  diga3d bench kernels                               measure the kernels on this machine
  diga3d doctor                                      check this machine

A capture is a COLMAP, nerfstudio or LLFF / SPIn-NeRF folder, a splat with cameras.json, or photographs alone.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the `diga3d` command.

    Args:
        arguments: Without the program's name; those of the process if None.

    Returns:
        Exit code: 0 success, 1 a check of `doctor` or a job of an experiment failed, 2 bad input or a refusal
        of the system, 130 interrupted, 143 terminated, 141 broken pipe.
    """
    tune_process()
    words = list(sys.argv[1:] if arguments is None else arguments)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # names may hold what a terminal's code page lacks
            stream.reconfigure(errors="backslashreplace")
    options = vars(parser().parse_args(words))
    command: Callable[..., int] = options.pop("run")
    hint = ""
    goes_on = options.pop("goes_on", False)
    if goes_on or "resume" in options:
        again = shlex.join(["diga3d", *words, *([] if goes_on or options["resume"] else ["--resume"])])
        hint = f"; go on with: {again}"
    stops: list[Stopped] = []
    try:
        with stoppable(hint) as stops:
            code = command(**options)
            sys.stdout.flush()
            return code
    except BrokenPipeError:
        return _unheard()
    except (Exception, KeyboardInterrupt) as error:
        if stops or isinstance(error, KeyboardInterrupt):
            stop = stops[0] if stops else Stopped()
            print(last_line(stop, hint), file=sys.stderr)
            return exit_code(stop)
        line = _line_about(error)
        if line is None:
            raise
        print(f"diga3d: error: {' '.join(line.split())}", file=sys.stderr)
        return EXIT_INPUT


def _line_about(error: Exception) -> str | None:
    """What to say of bad input and of what the system refuses; None for a fault of this program."""
    if isinstance(error, InputError):
        return str(error)
    lacking = out_of_memory(error)
    if lacking is not None:
        return f"{lacking}: close other programs, or use a smaller --image-scale"
    if isinstance(error, OSError) and error.filename is not None:
        return str(explained(error, lambda path: False, Path()))
    return None


def _unheard() -> int:
    """End quietly where nobody reads the output any more, as in `diga3d eval run | head -1`."""
    with suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())  # else Python reports the lost output at its end
    return EXIT_UNHEARD


def parser() -> argparse.ArgumentParser:
    """The command's parser with all subcommands."""
    root = Parser(prog="diga3d", description=DESCRIPTION, epilog=EXAMPLES, formatter_class=Help)
    root.add_argument("--version", action=Version)
    commands = Commands(root, "commands", "COMMAND")
    add_edits(commands)
    add_results(commands)
    add_study(commands)
    add_experiments(commands)
    add_benchmarks(commands)
    add_trials(commands)
    return root
