"""Tables of figures, as text for the terminal and as rows for the report."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from diga3d_warp.evaluation.metrics import REGIONS, Score

FIGURE = re.compile(r"[-+]?\d|inf|–|$")
"""Start of a number; an empty cell counts as one."""


@dataclass(frozen=True)
class Table:
    """A titled table.

    Attributes:
        title: Title of the table.
        columns: Heads; the first names the rows.
        rows: Cells as text, one row each, as long as `columns`.
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]

    def text(self) -> str:
        """The table for a terminal: first column and words to the left, figures to the right."""
        lines = [self.columns, *self.rows]
        widths = [max(len(line[column]) for line in lines) for column in range(len(self.columns))]

        def aligned(line: Sequence[str]) -> str:
            cells = [line[0].ljust(widths[0])]
            for column in range(1, len(line)):
                pad = str.ljust if self.holds_words(column) else str.rjust
                cells.append(pad(line[column], widths[column]))
            return "  ".join(cells).rstrip()

        rule = "-" * len(aligned(["-" * width for width in widths]))
        return "\n".join([self.title, aligned(self.columns), rule, *map(aligned, self.rows)]) + "\n"

    def markdown(self) -> str:
        """The table for a Markdown page, its title above it."""
        rule = ["---", *("---" if self.holds_words(c) else "---:" for c in range(1, len(self.columns)))]
        lines = [f"| {' | '.join(line)} |" for line in (self.columns, rule, *self.rows)]
        return "\n".join([f"**{self.title}**", "", *lines]) + "\n"

    def holds_words(self, column: int) -> bool:
        """Whether a cell of the column is not a number."""
        return any(FIGURE.match(row[column]) is None for row in self.rows)

    def as_json(self) -> dict[str, Any]:
        """The table as JSON data, for `metrics.json` under "tables"."""
        return {"title": self.title, "columns": list(self.columns), "rows": [list(row) for row in self.rows]}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Table:
        """The table back from JSON data."""
        return cls(data["title"], data["columns"], data["rows"])


def score_table(title: str, head: str, rows: Mapping[str, Mapping[str, Score]]) -> Table:
    """Scores by row and region.

    Args:
        title: What the table shows.
        head: Head of the first column.
        rows: Scores of each row by region. A region that no row has gets no columns.
    """
    regions = [region for region in REGIONS if any(region in scores for scores in rows.values())]
    columns = [head]
    for region in regions:
        columns += [f"{region} PSNR", "SSIM"]
    cells = [[name, *(cell for region in regions for cell in _cells(scores.get(region)))]
             for name, scores in rows.items()]  # fmt: skip
    return Table(title, columns, cells)


def _cells(score: Score | None) -> tuple[str, str]:
    return ("–", "–") if score is None else (f"{score.psnr:.2f}", f"{score.ssim:.4f}")
