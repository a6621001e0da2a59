"""Report: a run on one page that opens offline, with pictures, masks, figures, curves and stages."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Iterator, Mapping
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from diga3d_warp.evaluation.charts import curve, duration, memory, timeline
from diga3d_warp.evaluation.page import page, section
from diga3d_warp.evaluation.protocols import evaluation_tables
from diga3d_warp.evaluation.record import REPORT, read_manifest, read_metrics
from diga3d_warp.evaluation.tables import Table
from diga3d_warp.files import write_text
from diga3d_warp.state import read_pixels

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Pixels = NDArray[Any]
    """An 8-bit RGB picture, shape (H, W, 3)."""

MOST_VIEWS = 12
"""Views on the page, spread evenly over all: with both pictures of each it stays under about 5 MB."""

LARGE, SMALL = 900, 260
"""Longest side of an embedded picture [px]: in the comparison, and on the sheet of masks."""

JPEG_QUALITY = 88

OUTLINE = (255, 64, 160)
"""Colour of a mask's outline, RGB: rare in photographs."""

PAIR_NAMES = {"fit": ("photograph", "splat"), "remove": ("before", "after")}


def write_report(folder: Path) -> Path:
    """Write report.html from what the run folder holds: manifest, metrics, views and masks.

    Args:
        folder: The run folder. Pictures are taken from views/before, views/after and masks, by name.

    Returns:
        The report's path.

    Raises:
        InputError: the folder holds no run, or a picture in it cannot be decoded.
    """
    manifest, metrics = read_manifest(folder), read_metrics(folder)
    name = Path(manifest["settings"].get("scene") or folder).name
    prompt = manifest["settings"].get("prompt")
    title = {
        "fit": f"A splat of {name}",
        "remove": f"{name} without the object",
        "retexture": f"{name}: {prompt}",
        "replace": f"{name}: {prompt or Path(manifest['settings'].get('asset') or '').name}",
    }.get(manifest["command"], f"{manifest['command']}: {name}")
    sections = [
        f"<h1>{escape(title)}</h1><code class=soft>{escape(manifest['command_line'])}</code>",
        _tiles(manifest, metrics),
        _notes(manifest["notes"]),
        section("Views", _comparison(folder, manifest["command"])),
        section("Masks", _mask_sheet(folder)),
        section("Likeness", "".join(_table(table) for table in _tables(metrics))),
        section("Curves", _curves(metrics)),
        section("Stages", f'<div class="card">{timeline(manifest["stages"])}</div>'),
        section("Effects", _effects(manifest)),
        section("Figures", _figures(metrics)),
        section("Manifest", f'<pre class="card">{escape(json.dumps(_short(manifest), indent=2))}</pre>'),
    ]
    write_text(folder / REPORT, page(title, [part for part in sections if part]))
    return folder / REPORT


def _tiles(manifest: Mapping[str, Any], metrics: Mapping[str, Any]) -> str:
    """The headline figures."""
    tiles = []
    evaluation = metrics.get("evaluation", {})
    for entry in evaluation.get("comparisons", []):
        psnr = entry["mean"].get("whole", {}).get("psnr")
        if psnr is not None:
            tiles.append((f"{psnr:.2f} dB", f"{entry['title']}, PSNR"))
    if evaluation.get("unmasked_loss_db") is not None:
        tiles.append((f"{evaluation['unmasked_loss_db']:.2f} dB", "lost on unmasked pixels"))
    tiles.append((duration(manifest["seconds"]), "in all"))
    peaks = [manifest.get("peak_mib", 0), *(stage["peak_mib"] for stage in manifest["stages"])]
    if any(peaks):
        tiles.append((memory(max(peaks)), "peak memory"))
    cells = "".join(
        f"<div><b>{escape(value)}</b><span class=soft>{escape(label)}</span></div>" for value, label in tiles
    )
    return f'<div class="tiles">{cells}</div>'


def _notes(notes: list[str]) -> str:
    items = "".join(f"<li>{escape(note)}</li>" for note in notes)
    return section("Notes", items and f'<ul class="notes">{items}</ul>')


def _comparison(folder: Path, command: str) -> str:
    """A slider over one view, and a sheet of all to choose from."""
    names = [
        name for name in _names(folder / "views" / "after") if _picture(folder, "before", name).is_file()
    ]
    left, right = PAIR_NAMES.get(command, ("before", "after"))
    buttons: list[str] = []
    first = ""
    for name in _spread(names):
        before, after = (read_pixels(_picture(folder, side, name)) for side in ("before", "after"))
        ratio = f"{after.shape[1] / after.shape[0]:.4f}"
        sources = embedded(before, LARGE), embedded(after, LARGE)
        if not first:
            first = (
                f'<div class="compare" style="--ratio:{ratio}">'
                f'<img class="after" src="{sources[1]}" alt="{right}">'
                f'<img class="before" src="{sources[0]}" alt="{left}"><i></i>'
                f'<span class="left">{left}</span><span class="right">{right}</span>'
                f'<input type="range" step="0.1" value="50" aria-label="{left} or {right}"></div>'
            )
        buttons.append(
            f'<button aria-pressed="{"false" if buttons else "true"}" data-ratio="{ratio}" '
            f'data-before="{sources[0]}"><img src="{sources[1]}" alt="">{escape(name)}</button>'
        )
    if not first:
        return ""
    more = len(names) - len(buttons)
    rest = f"<p class=soft>{more} more views are in the folder views.</p>" if more else ""
    return first + '<div class="sheet">' + "".join(buttons) + "</div>" + rest


def _mask_sheet(folder: Path) -> str:
    """The views with the outlines of the masks that were used."""
    import cv2

    figures = []
    for name in _spread([n for n in _names(folder / "masks") if _picture(folder, "before", n).is_file()]):
        picture = _shrunk(read_pixels(_picture(folder, "before", name)), SMALL)
        mask = read_pixels(folder / "masks" / f"{name}.png")[..., 0]
        mask = cv2.resize(mask, picture.shape[1::-1], interpolation=cv2.INTER_NEAREST)
        outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        outlined = cv2.drawContours(np.ascontiguousarray(picture), outlines, -1, OUTLINE, 2)
        share = f"{escape(name)}, {100 * float((mask > 0).mean()):.1f} %"
        figures.append(f'<figure><img src="{embedded(outlined, SMALL)}" alt="">{share}</figure>')
    return f'<div class="sheet">{"".join(figures)}</div>' if figures else ""


def _tables(metrics: Mapping[str, Any]) -> Iterator[Table]:
    yield from (Table.from_json(data) for data in metrics.get("tables", []))
    if "evaluation" in metrics:
        yield from evaluation_tables(metrics["evaluation"])


def _effects(manifest: Mapping[str, Any]) -> str:
    """The chosen effects with their evidence; empty for a run without a choice."""
    plan = manifest.get("effects")
    return _table(Table.from_json(plan["table"])) if plan and "table" in plan else ""


def _table(table: Table) -> str:
    kinds = [' class="words"' if table.holds_words(column) else "" for column in range(len(table.columns))]
    head = "".join(f"<th{kind}>{escape(cell)}</th>" for kind, cell in zip(kinds, table.columns, strict=True))
    rows = (
        "".join(f"<td{kind}>{escape(cell)}</td>" for kind, cell in zip(kinds, row, strict=True))
        for row in table.rows
    )
    body = "".join(f"<tr>{row}</tr>" for row in rows)
    return (
        f'<div class="scroll card"><table><caption>{escape(table.title)}</caption>'
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def _curves(metrics: Mapping[str, Any]) -> str:
    """A chart for each figure of each subject's curve: a list of {"iteration": ..., "loss": ..., ...}."""
    charts = []
    for subject, figures in metrics.items():
        points = figures.get("curve", []) if isinstance(figures, dict) else []
        keys = dict.fromkeys(key for point in points for key in point if key != "iteration")
        for key in keys:
            line = [(point["iteration"], point[key]) for point in points if _is_number(point.get(key))]
            if len(line) > 1:
                charts.append(curve(f"{subject}: {key}", line))
    return f'<div class="curves">{"".join(charts)}</div>' if charts else ""


def _figures(metrics: Mapping[str, Any]) -> str:
    """Single figures by subject, those that no table or curve shows."""
    rows = [
        [f"{subject}: {key}", f"{value:.6g}" if isinstance(value, float) else str(value)]
        for subject, figures in metrics.items()
        if isinstance(figures, dict) and subject != "evaluation"
        for key, value in figures.items()
        if not isinstance(value, (dict, list))
    ]
    return _table(Table("Measured by the stages", ["figure", "value"], rows)) if rows else ""


def _short(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """The manifest without what the page shows elsewhere."""
    return {key: value for key, value in manifest.items() if key not in ("stages", "notes", "effects")}


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and math.isfinite(value)


def _names(folder: Path) -> list[str]:
    """Names of the pictures below a folder; a view's name may hold folders."""
    files = sorted(folder.rglob("*.png"))
    return [str(file.relative_to(folder).with_suffix("")) for file in files if not file.name.startswith(".")]


def _picture(folder: Path, side: str, name: str) -> Path:
    return folder / "views" / side / f"{name}.png"


def _spread(names: list[str]) -> list[str]:
    count = min(len(names), MOST_VIEWS)
    return [names[index] for index in np.linspace(0, len(names) - 1, count).round().astype(int)]


def _shrunk(pixels: Pixels, side: int) -> Pixels:
    import cv2

    scale = side / max(pixels.shape[:2])
    if scale >= 1:
        return pixels
    return cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)


def embedded(pixels: Pixels, side: int) -> str:
    """A picture as a data URL, no longer than `side` pixels."""
    import cv2

    small = np.ascontiguousarray(_shrunk(pixels, side)[..., ::-1])
    _, data = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode()
