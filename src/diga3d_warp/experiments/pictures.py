"""Page of pictures: a view of each scene, before and as each method has edited it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

from diga3d_warp.evaluation.gallery import picture_row
from diga3d_warp.evaluation.page import page, section
from diga3d_warp.experiments.job import Job, JobFolder
from diga3d_warp.experiments.sheet import Sheet
from diga3d_warp.files import write_text

PAGE = "pictures.html"


def write_pictures(out: Path, sheets: Sequence[Sheet]) -> Path:
    """Write pictures.html.

    Args:
        out: Folder of the jobs.
        sheets: What was compared.

    Returns:
        The page.
    """
    sections = [f"<h1>{escape(' and '.join(sheet.title for sheet in sheets))}</h1>"]
    for sheet in sheets:
        scenes = dict.fromkeys(job.scene for job in sheet.jobs)
        rows = "".join(_scene(out, sheet, scene) for scene in scenes)
        sections.append(section(sheet.title, rows))
    write_text(out / PAGE, page(sheets[0].title, sections))
    return out / PAGE


def _scene(out: Path, sheet: Sheet, scene: str) -> str:
    pictures: dict[str, Path] = {}
    for row in sheet.rows:
        for job in row.jobs:
            if job.scene == scene:
                pictures |= _pictures(JobFolder(out, job), row.method, job, pictures)
    return f"<h3>{escape(Path(scene).name)}</h3>{picture_row(pictures)}" if pictures else ""


def _pictures(folder: JobFolder, method: str, job: Job, before: Mapping[str, Path]) -> dict[str, Path]:
    """The middle view of a run: before, unless another run has shown it, and after."""
    views = folder.run / "views"
    names = sorted(path.relative_to(views / "after") for path in (views / "after").rglob("*.png"))
    if not names:
        return {}
    middle, prompt = names[len(names) // 2], job.options.get("prompt")
    first = {} if "before" in before else {"before": views / "before" / middle}
    return {**first, f"{method}: {prompt}" if prompt else method: views / "after" / middle}
