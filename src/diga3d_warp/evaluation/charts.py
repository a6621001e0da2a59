"""Charts of the report as inline SVG and HTML, without script or network, in the page's colours."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

WIDTH, HEIGHT = 440, 240
LEFT, RIGHT, TOP, BOTTOM = 52, 14, 14, 30
"""Size of a curve's drawing and its margins [SVG units]; it is scaled to its column."""

MOST_POINTS = 400
"""Points drawn of a curve: more than its width in pixels would only make the page larger."""


def timeline(stages: Sequence[Mapping[str, Any]]) -> str:
    """Stages as bars one after another, each with its seconds and peak memory.

    Args:
        stages: Stages of the manifest: name, seconds, peak_mib, resumed.
    """
    total = sum(stage["seconds"] for stage in stages) or 1.0
    rows, start = [], 0.0
    for stage in stages:
        left, width = 100 * start / total, 100 * stage["seconds"] / total
        start += stage["seconds"]
        resumed = " (resumed)" if stage["resumed"] else ""
        rows.append(
            f'<div class="stage"><span>{escape(stage["name"])}{resumed}</span>'
            f'<span class="track"><i style="left:{left:.2f}%;width:{width:.2f}%"></i></span>'
            f"<span>{duration(stage['seconds'])}</span><span>{memory(stage['peak_mib'])}</span></div>"
        )
    return '<div class="timeline">' + "".join(rows) + "</div>"


def curve(title: str, points: Sequence[tuple[float, float]]) -> str:
    """A line over iterations, its last value written at its end.

    Args:
        title: What the line shows.
        points: Iteration and value, in order; values must be finite.
    """
    stride = -(-len(points) // MOST_POINTS)
    drawn = [*points[:-1:stride], points[-1]]
    xs, ys = zip(*drawn, strict=True)
    x_ticks, y_ticks = nice_ticks(min(xs), max(xs)), nice_ticks(min(ys), max(ys))
    x_low, x_high = min(xs), max(max(xs), min(xs) + 1e-9)
    y_low, y_high = min(y_ticks[0], min(ys)), max(y_ticks[-1], max(ys))

    def place(x: float, y: float) -> tuple[float, float]:
        return (
            LEFT + (x - x_low) / (x_high - x_low) * (WIDTH - LEFT - RIGHT),
            HEIGHT - BOTTOM - (y - y_low) / (y_high - y_low) * (HEIGHT - TOP - BOTTOM),
        )

    parts = []
    for tick in y_ticks:
        _, y = place(x_low, tick)
        parts.append(f'<line class="grid" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>')
        parts.append(f'<text x="{LEFT - 8}" y="{y + 4:.1f}" text-anchor="end">{tick:g}</text>')
    for tick in x_ticks:
        if x_low <= tick <= x_high:
            x, _ = place(tick, y_low)
            parts.append(f'<text x="{x:.1f}" y="{HEIGHT - 8}" text-anchor="middle">{tick:g}</text>')
    line = " ".join(f"{x:.1f},{y:.1f}" for x, y in (place(*point) for point in drawn))
    end_x, end_y = place(*drawn[-1])
    parts.append(f'<polyline points="{line}"/><circle cx="{end_x:.1f}" cy="{end_y:.1f}" r="4"/>')
    return (
        f"<figure><figcaption>{escape(title)} <b>{_short(drawn[-1][1])}</b> at the end</figcaption>"
        f'<svg class="curve" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(title)}">'
        + "".join(parts)
        + "</svg></figure>"
    )


def nice_ticks(low: float, high: float) -> list[float]:
    """Three to seven round numbers that enclose a range; steps of 1, 2 or 5 times a power of ten."""
    if high <= low:
        high = low + (abs(low) or 1.0)
    raw = (high - low) / 5
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= raw)
    first, last = math.floor(low / step), math.ceil(high / step)
    return [float(f"{index * step:.9g}") for index in range(first, last + 1)]


def _short(value: float) -> str:
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.4g}"


def duration(seconds: float) -> str:
    """Seconds in words: 4.2 s, 3 min 07 s, 2 h 05 min."""
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest:02d} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"


def memory(mib: float) -> str:
    """Mebibytes in words: 812 MiB, 1.4 GiB."""
    return f"{mib:.0f} MiB" if mib < 1024 else f"{mib / 1024:.1f} GiB"
