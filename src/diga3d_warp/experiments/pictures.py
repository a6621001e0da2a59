"""Page of pictures: a test view of each scene before, as each method has edited it, and its photograph."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path

from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.gallery import picture_row
from diga3d_warp.evaluation.page import page, section
from diga3d_warp.evaluation.record import REPORT, read_metrics
from diga3d_warp.experiments.job import Job, JobFolder
from diga3d_warp.experiments.sheet import Sheet
from diga3d_warp.files import write_text
from diga3d_warp.scene.photographs.folders import image_files, image_folders

PAGE = "pictures.html"

TRUTH = "ground truth"

MOST_SCENES = 24
"""Scenes of a sheet on the page: with five pictures of each it stays under about 10 MB."""


def write_pictures(out: Path, sheets: Sequence[Sheet]) -> Path:
    """Write pictures.html.

    Args:
        out: Folder of the jobs.
        sheets: What was compared.

    Returns:
        The page.
    """
    title = "Pictures of the experiments"
    sections = [section(sheet.title, _scenes(out, sheet)) for sheet in sheets]
    write_text(out / PAGE, page(title, [f"<h1>{title}</h1>", *sections]))
    return out / PAGE


def _scenes(out: Path, sheet: Sheet) -> str:
    """The scenes of a sheet."""
    jobs: dict[str, list[tuple[str, Job]]] = {}
    for row in sheet.rows:
        for job in row.jobs:
            jobs.setdefault(job.scene, []).append((row.method, job))
    shown = "".join(_scene(out, scene, jobs[scene]) for scene in list(jobs)[:MOST_SCENES])
    more = len(jobs) - MOST_SCENES
    return shown + (f"<p class=soft>{more} more scenes are in the folder jobs.</p>" if more > 0 else "")


def _scene(out: Path, scene: str, jobs: Sequence[tuple[str, Job]]) -> str:
    """The pictures of a scene, and links to the reports of its runs; nothing where no job has any."""
    pictures: dict[str, Path] = {}
    links, truth = [], None
    for method, job in jobs:
        folder = JobFolder(out, job)
        view, compared = _view(folder)
        if view is None:
            continue
        prompt = job.options.get("prompt")
        name = f"{method}: {prompt}" if prompt else method
        pictures.setdefault("before", folder.run / "views" / "before" / f"{view}.png")
        pictures[name] = folder.run / "views" / "after" / f"{view}.png"
        truth = truth or (_photograph(Path(scene), view) if compared else None)
        report = (folder.run / REPORT).relative_to(out).as_posix()
        links.append(f'<a href="{escape(report)}">{escape(name)}</a>')
    if not pictures:
        return ""
    if truth is not None:
        pictures[TRUTH] = truth
    reports = f"<p class=soft>Reports: {', '.join(links)}</p>"
    return f"<h3>{escape(Path(scene).name)}</h3>{picture_row(pictures)}{reports}"


def _view(folder: JobFolder) -> tuple[str | None, bool]:
    """The middle one of a run's test views, or of all its views; whether its photograph is the truth."""
    views = folder.run / "views" / "after"
    try:
        evaluation = read_metrics(folder.run).get("evaluation", {})
    except InputError:
        evaluation = {}
    names = sorted(evaluation["comparisons"][0]["views"]) if evaluation.get("comparisons") else []
    if not names:
        names = sorted(
            path.relative_to(views).with_suffix("").as_posix()
            for path in views.rglob("*.png")
            if not path.name.startswith(".")
        )
    if not names or not (views / f"{names[len(names) // 2]}.png").is_file():
        return None, False
    return names[len(names) // 2], evaluation.get("protocol") == "spin-nerf"


def _photograph(scene: Path, view: str) -> Path | None:
    """The photograph of a view in the scene's smallest image folder that has one."""
    for folder in reversed(image_folders(scene).values()):
        found = next((file for key, file in image_files(folder).items() if key == view), None)
        if found is not None:
            return found
    return None
