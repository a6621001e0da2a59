"""Gallery: pictures of several runs beside each other, on one page that opens offline."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

from diga3d_warp.evaluation.page import page, section
from diga3d_warp.evaluation.record import REPORT
from diga3d_warp.evaluation.report import embedded
from diga3d_warp.evaluation.tables import Table
from diga3d_warp.files import write_text
from diga3d_warp.scene.photographs.images import read_image

SIDE = 420
"""Longest side of a picture [px]: seven of them fill a wide screen."""


def write_gallery(
    folder: Path, title: str, rows: Sequence[Mapping[str, Path]], runs: Mapping[str, Path], table: Table
) -> Path:
    """Write report.html with pictures side by side and links to the reports of the runs.

    Args:
        folder: Folder that receives report.html.
        title: Title of the page.
        rows: One per view: the pictures' files by caption, in order.
        runs: Folders of the runs below `folder`, by name.
        table: Figures to show below the pictures.

    Returns:
        The page's path.
    """
    links = "".join(
        f'<li><a href="{escape((run / REPORT).relative_to(folder).as_posix())}">{escape(name)}</a></li>'
        for name, run in runs.items()
    )
    sections = [
        f"<h1>{escape(title)}</h1>",
        section("Side by side", "".join(picture_row(row) for row in rows)),
        section("Each run", f"<ul>{links}</ul>"),
        section("Likeness", f'<pre class="card">{escape(table.text())}</pre>'),
    ]
    write_text(folder / REPORT, page(title, sections))
    return folder / REPORT


def picture_row(pictures: Mapping[str, Path]) -> str:
    """Pictures side by side as HTML, by caption."""
    figures = "".join(
        f'<figure><img src="{embedded(read_image(path), SIDE)}" alt="{escape(caption)}">'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
        for caption, path in pictures.items()
    )
    return f'<div class="sheet">{figures}</div>'
