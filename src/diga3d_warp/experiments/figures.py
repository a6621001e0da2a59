"""Figures of a run as tables take them: by metric and region, out of an evaluation's comparisons."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

Figures = dict[str, dict[str, float | None]]
"""Means over the test views by metric and region; None for an infinite PSNR."""

RESULTS = ("edited against ground truth", "edited against photographs", "fit against photographs")
"""Comparisons that score what a run has made; the first that an evaluation has is taken."""

CHANGE = "edited against source"
"""Comparison of an edit with what was there before; CLIP_dir is measured on it."""

PATH = ("edited, along a path", "fit, along a path")
"""Frames of which correspondences are counted, as the paper counts them."""


def figures_of(evaluation: Mapping[str, Any]) -> Figures:
    """The figures of the result in an `EvaluationRecord`.

    Metrics of the change alone, as CLIP_dir, are taken from there.
    """
    found: Figures = {}
    means = {entry["title"]: entry["mean"] for entry in evaluation["comparisons"]}
    title = next((title for title in RESULTS if title in means), None)
    if title is not None:
        for region, score in means[title].items():
            found.setdefault("PSNR", {})[region] = score["psnr"]
            found.setdefault("SSIM", {})[region] = score["ssim"]
    perceptual = evaluation.get("perceptual")
    if perceptual is None:
        return found
    for each in (title, CHANGE):
        for metric, regions in perceptual["comparisons"].get(each, {}).get("mean", {}).items():
            if metric not in found:
                found[metric] = dict(regions)
    for row in perceptual["corrs"]["rows"]:
        if row["title"] in PATH:
            for matcher, corrs in row["matches"].items():
                found[matcher] = {"whole": corrs["whole"]}
    return found
