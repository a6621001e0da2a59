"""The sheet of a sweep: a row for each combination of the grid, its scenes averaged."""

from __future__ import annotations

from pathlib import Path

from diga3d_warp.errors import InputError
from diga3d_warp.experiments.job import Job
from diga3d_warp.experiments.paper import BOX, FID, LPIPS, MASKED, PSNR, SSIM
from diga3d_warp.experiments.plan import Plan
from diga3d_warp.experiments.sheet import COSTS, Column, Row, Sheet

UNMASKED = Column("unmasked PSNR ↑", "PSNR", "unmasked")
REFERENCE_FREE = (Column("MUSIQ ↑", "MUSIQ"), Column("SIFT ↑", "SIFT matches", digits=0))
CLIP = Column("CLIP_dir ↑", "CLIP_dir", digits=4)

COLUMNS = {
    "fit": (PSNR, SSIM, LPIPS, FID),
    "remove": (PSNR, SSIM, LPIPS, *MASKED, *BOX, UNMASKED, *REFERENCE_FREE),
    "retexture": (CLIP, UNMASKED, *REFERENCE_FREE),
    "replace": (CLIP, UNMASKED, *REFERENCE_FREE),
}


def sheet_of(plan: Plan, path: Path) -> Sheet:
    """What a sweep compares.

    Args:
        plan: The plan.
        path: Its file, after which those of the results are called.

    Raises:
        InputError: a file of the results would have the name of another one.
    """
    name = path.stem.lstrip(".") or "sweep"
    if f"{name}.md" == COSTS:
        raise InputError(f"{path}: {COSTS} is the name of another result: call the plan something else")
    rows: dict[str, list[Job]] = {}
    for values, job in plan.jobs():
        # Means over seeds, too: they are repetitions of one method.
        described = ", ".join(f"{key} {value}" for key, value in values.items() if key != "seed")
        rows.setdefault(described or plan.command, []).append(job)
    count = len(plan.grid.get("seed", [0]))
    seeds = [f"Means over {count} seeds of each scene."] if count > 1 else []
    scenes = f"{len(plan.scenes)} scene{'s' * (len(plan.scenes) != 1)}"
    return Sheet(
        name, f"{plan.command}, {scenes}", COLUMNS[plan.command],
        [Row(described, jobs) for described, jobs in rows.items()], notes=seeds,
    )  # fmt: skip
