"""Commands that run many jobs: experiment and sweep."""

from __future__ import annotations

import argparse
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from diga3d_warp.cli.options import add_accuracy
from diga3d_warp.cli.parsing import Commands, non_negative, path, positive_int, scale, seed
from diga3d_warp.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from diga3d_warp.experiments.job import Job
    from diga3d_warp.experiments.run import Crew
    from diga3d_warp.experiments.sheet import Sheet

NAMES = ("table1", "table2", "table3", "table4", "table5", "accuracy", "all")

AGAIN = "If interrupted, the same command goes on where it was."


def add_experiments(commands: Commands) -> None:
    """experiment and sweep."""
    experiment = commands.add(
        "experiment",
        _experiment,
        "run the paper's experiments on a data set",
        "diga3d experiment table1 table3 --data data/spin-nerf --out run/spin-nerf",
        f"Run the paper's experiments, and write their tables beside the published figures. {AGAIN}",
    )
    experiment.add_argument(
        "names", nargs="+", choices=NAMES, metavar="NAME", help=f"which: {', '.join(NAMES)}"
    )
    experiment.add_argument(
        "--data", type=path, required=True, metavar="DIR", help="folder of the scenes, a folder each"
    )
    experiment.add_argument(
        "--scenes", type=_names, default=(), metavar="NAME,...", help="scenes to take (default all)"
    )
    experiment.add_argument(
        "--prior",
        dest="priors",
        action="append",
        metavar="PRIOR",
        help="a prior, as the edits take it; rows of each table for each (repeatable, default exemplar)",
    )
    experiment.add_argument(
        "--representation",
        dest="representations",
        action="append",
        choices=["gaussians", "scaffold"],
        help="what is fitted, as in the edits; rows for each (repeatable, default gaussians)",
    )
    experiment.add_argument(
        "--image-scale",
        type=scale,
        metavar="S",
        help="image size (default that on which the figures of the data set are measured)",
    )
    experiment.add_argument(
        "--iterations", type=positive_int, metavar="N", help="iterations of the fits (default by the scene)"
    )
    add_accuracy(experiment, "accuracy of the fitted renderings")
    experiment.add_argument("--seed", type=seed, default=0, metavar="N", help="random seed (default 0)")
    experiment.add_argument(
        "--edits", type=path, metavar="FILE", help="edits of table2 (default edits.yaml in the data folder)"
    )
    experiment.add_argument(
        "--votes", type=path, nargs="+", default=(), metavar="FILE", help="votes of a study, for table2"
    )
    experiment.add_argument(
        "--weights", type=path, metavar="DIR", help="folder with weights of the perceptual metrics"
    )
    _add_machines(experiment)

    sweep = commands.add(
        "sweep",
        _sweep,
        "run a grid of scenes, prompts, priors and seeds",
        "diga3d sweep plan.yaml --out run/sweep",
        f"Run every combination of the values in a plan. {AGAIN}",
    )
    sweep.add_argument("plan", type=path, metavar="PLAN", help="YAML file, see docs/scale.md")
    _add_machines(sweep)


def _add_machines(command: argparse.ArgumentParser) -> None:
    command.set_defaults(goes_on=True)
    command.add_argument("--out", type=path, required=True, metavar="DIR", help="folder of jobs and tables")
    machines = command.add_argument_group("machines")
    machines.add_argument(
        "--workers", type=positive_int, metavar="N", help="jobs at a time on this machine (default 1)"
    )
    machines.add_argument(
        "--cores",
        type=positive_int,
        metavar="N",
        help="cores of a job (default this machine's, shared evenly)",
    )
    machines.add_argument(
        "--gpus",
        type=non_negative,
        metavar="G",
        help="GPUs of a job, such as 0.5 for two on each (default 1 with a network as prior)",
    )
    machines.add_argument(
        "--address",
        metavar="HOST:PORT",
        help="a Ray cluster to run on; --out and data must be shared folders",
    )
    machines.add_argument(
        "--ray",
        action=argparse.BooleanOptionalAction,
        help="run through Ray, on this machine without --address (default if Ray is installed)",
    )


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _experiment(
    names: list[str],
    data: Path,
    scenes: Sequence[str],
    priors: list[str] | None,
    representations: list[str] | None,
    image_scale: float | None,
    iterations: int | None,
    accuracy: str,
    seed: int,
    edits: Path | None,
    votes: Sequence[Path],
    weights: Path | None,
    **machines: Any,
) -> int:
    from diga3d_warp.experiments.options import placed_prior
    from diga3d_warp.experiments.paper import Experiment
    from diga3d_warp.experiments.scenes import check_apart, packed_scenes
    from diga3d_warp.pipelines.run import say

    chosen = tuple(dict.fromkeys(placed_prior(prior, Path()) for prior in priors or ["exemplar"]))
    options: dict[str, Any] = {"seed": seed, "accuracy": accuracy}
    options |= {} if iterations is None else {"iterations": iterations}
    options |= {} if image_scale is None else {"image_scale": image_scale}
    experiment = Experiment(
        data, scenes, chosen, tuple(dict.fromkeys(representations or ["gaussians"])), options,
        "published" if image_scale is None else None,
        None if weights is None else str(weights.resolve()), edits, votes,
    )  # fmt: skip
    check_apart(machines["out"], data)
    sheets = experiment.sheets(names)
    read = {sheet.name for sheet in sheets}
    if votes and "table2" not in read:
        raise InputError("only table2 reads --votes: name it, too, or leave them out")
    if edits is not None and not read & {"table2", "table5"}:
        raise InputError("only table2 and table5 read --edits: name one, too, or leave it out")
    if packed := packed_scenes(data):
        say(f"note: {data} holds archives, which are not read: unpack {', '.join(packed)} for their scenes")
    return _run(sheets, **machines)


def _sweep(plan: Path, **machines: Any) -> int:
    from diga3d_warp.experiments.plan import read_plan
    from diga3d_warp.experiments.sweep import sheet_of

    return _run([sheet_of(read_plan(plan), plan)], **machines)


def _run(
    sheets: Sequence[Sheet],
    out: Path,
    workers: int | None,
    cores: int | None,
    gpus: float | None,
    address: str | None,
    ray: bool | None,
) -> int:
    from diga3d_warp.experiments.options import check_jobs
    from diga3d_warp.experiments.remeasure import has_more_weights
    from diga3d_warp.experiments.results import write_results
    from diga3d_warp.experiments.run import run_jobs
    from diga3d_warp.pipelines.run import say

    jobs = [job for sheet in sheets for job in sheet.jobs]
    if gpus is None:
        gpus = _gpus_of(jobs, address)
    crew = _crew(workers, cores, gpus, address, ray)
    if address is None:  # machines of a cluster may have what this one lacks
        check_jobs(jobs)
    outcomes = run_jobs(jobs, out, crew, outdated=has_more_weights)
    written = write_results(out, sheets, outcomes)
    for sheet in sheets:
        print(sheet.main(outcomes).text())
    for file in written:
        print(file)
    failed = sum(outcome["error"] is not None for outcome in outcomes.values())
    if failed:
        say(f"{failed} of {len(outcomes)} jobs failed, the tables say why: the same command tries them again")
    return 1 if failed else 0


def _gpus_of(jobs: Sequence[Job], address: str | None) -> float:
    """GPUs of a job if the user does not say: one for a network, where there may be one."""
    from diga3d_warp.checkpoints import best_device
    from diga3d_warp.priors.named import reads_prompts

    network = any(reads_prompts(str(job.options.get("prior", "exemplar"))) for job in jobs)
    return 1.0 if network and (address is not None or best_device("auto") == "cuda") else 0.0


def _crew(workers: int | None, cores: int | None, gpus: float, address: str | None, ray: bool | None) -> Crew:
    """Where jobs run.

    Raises:
        InputError: options contradict each other, or Ray is asked for and not installed.
    """
    if address is not None and ray is False:
        raise InputError("--address is a cluster of Ray's: leave --no-ray out")
    if address is not None and workers is not None:
        raise InputError("--workers is of this machine, and a cluster runs as many jobs as fit: use --cores")
    from diga3d_warp.experiments.cluster import RayCrew
    from diga3d_warp.pipelines.machine import core_count

    count = workers or 1
    threads = cores or max(core_count() // count, 1)
    if ray is False or (ray is None and address is None and find_spec("ray") is None):
        from diga3d_warp.experiments.processes import LocalCrew

        if gpus not in (0.0, 1.0):
            raise InputError(
                "without Ray each job sees one GPU, whatever --gpus says: leave it out, or use --ray"
            )
        return LocalCrew(count, threads, _gpu_count() if gpus else 0)
    crew = RayCrew(address, count, threads, gpus)
    crew.check()
    return crew


def _gpu_count() -> int:
    import torch

    return torch.cuda.device_count()
