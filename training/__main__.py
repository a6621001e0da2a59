"""Command line of the training."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import get_args

from diga3d_warp.errors import InputError
from training.recipe import RECIPE
from training.windows import Part

PARTS: tuple[Part, ...] = get_args(Part)


def main(arguments: list[str] | None = None) -> int:
    """Run one stage of the training; exit code 2 with one line for what the user can mend."""
    parser = argparse.ArgumentParser("python -m training", description="Trains the room prior.")
    parser.add_argument("--work", type=Path, required=True, help="folder of data and checkpoints")
    parser.add_argument("--threads", type=int, default=2, help="processor threads (default 2)")
    stages = parser.add_subparsers(dest="stage", required=True)
    everything = stages.add_parser("all", help="all stages, as far as the recipe's schedule; then export")
    everything.add_argument("folder", type=Path, help="where to export")
    everything.add_argument("--workers", type=int, default=1, help="processes that share each batch")
    data = stages.add_parser("data", help="render windows of rooms")
    data.add_argument("--rooms", type=int, default=1000, help="number of rooms to reach (default 1000)")
    data.add_argument(
        "--part", choices=PARTS, default="windows",
        help="rooms to train on (windows), to look at meanwhile (held_out), for published figures (tested)",
    )  # fmt: skip
    train = stages.add_parser("train", help="train one network")
    train.add_argument("network", choices=("autoencoder", "decoder", "denoiser", "edges", "depth"))
    train.add_argument("--steps", type=int, default=100_000, help="number of the last step")
    train.add_argument("--workers", type=int, default=1, help="processes that share each batch (default 1)")
    latents = stages.add_parser("latents", help="encode samples, with the autoencoder as it is at first")
    latents.add_argument("--samples", type=int, default=300_000, help="number to reach (default 300000)")
    folder = stages.add_parser("export", help="write a folder in diffusers format, fp16")
    folder.add_argument("folder", type=Path)
    report = stages.add_parser("evaluate", help="fill windows of held-out rooms, beside other fills")
    report.add_argument("folder", type=Path, help="written by export")
    report.add_argument("--windows", type=int, default=64, help="number of windows (default 64)")
    report.add_argument("--prompts", type=int, default=10, help="number of prompts (default 10)")
    report.add_argument("--part", choices=PARTS[1:], default="tested", help="rooms (default tested)")
    report.add_argument("--pictures", type=Path, help="folder of pictures")
    curves = stages.add_parser("curve", help="plot the losses of all networks")
    curves.add_argument("picture", type=Path, help=".png file to write")
    chosen = parser.parse_args(arguments)
    try:
        _run(chosen)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


def _run(chosen: argparse.Namespace) -> None:
    import torch

    torch.set_num_threads(chosen.threads)
    if chosen.stage == "all":
        from training.teach import train_all

        train_all(chosen.work, chosen.folder, chosen.threads, chosen.workers)
    elif chosen.stage == "data":
        from training.windows import render_rooms

        render_rooms(chosen.work, RECIPE.data, chosen.rooms, chosen.part)
    elif chosen.stage == "latents":
        from training.latents import encode_samples

        encode_samples(chosen.work, RECIPE, chosen.samples)
    elif chosen.stage == "train":
        from training.teach import Task
        from training.workers import run_workers

        task = Task(chosen.network, chosen.work, chosen.steps, chosen.threads)
        run_workers(chosen.workers, task)
    elif chosen.stage == "export":
        from training.export import export

        for line in export(chosen.work, RECIPE, chosen.folder):
            print(line)
    elif chosen.stage == "evaluate":
        from training.evaluate import load, removal, text
        from training.windows import open_windows

        rooms, prior = open_windows(chosen.work, RECIPE.data, chosen.part), load(chosen.folder)
        print(removal(prior, rooms, chosen.windows, chosen.pictures), end="\n\n")
        print(text(prior, rooms, chosen.prompts, chosen.pictures))
    elif chosen.stage == "curve":
        from training.curve import draw_curves

        draw_curves(chosen.work, chosen.picture)


if __name__ == "__main__":
    raise SystemExit(main())
