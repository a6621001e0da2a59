"""Perceptual metrics of rendered views: LPIPS, CLIP_dir, MUSIQ and FID, as far as their weights are there.

Each network is a file that the user brings. What is missing is named once, with its size and the command for
it, and its cells say "not measured". They take seconds a view on a CPU, so `diga3d eval` alone measures them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.clip_direction import ClipDirection
from diga3d_warp.evaluation.correspondences import LoftrMatcher, Matcher, SiftMatcher
from diga3d_warp.evaluation.frechet import Inception, frechet_distance
from diga3d_warp.evaluation.lpips import ALEX, VGG, Lpips
from diga3d_warp.evaluation.metrics import REGIONS
from diga3d_warp.evaluation.musiq import Musiq
from diga3d_warp.evaluation.tables import Table

NOT_MEASURED = "not measured"

Network = TypeVar("Network")

Figures = dict[str, dict[str, float]]
"""Figures by metric and region, both by their names in tables."""


@dataclass(frozen=True)
class Pair:
    """A rendered view and what it is compared with.

    Attributes:
        picture, reference: RGB, shape (H, W, 3); values outside [0, 1] are clipped, as a screen does.
        mask: True where the object is or was, shape (H, W), bool; None if unknown.
        regions: Those of `metrics.REGIONS` in which the comparison means something.
        edit: Whether the reference is the same view before the edit.
    """

    picture: torch.Tensor
    reference: torch.Tensor
    mask: np.ndarray | None = None
    regions: tuple[str, ...] = REGIONS
    edit: bool = False


@dataclass(frozen=True)
class EditText:
    """Texts of an edit, for CLIP_dir.

    Attributes:
        source: What the scene shows before the edit; None if nobody said.
        edited: What it shows after it; None if the run had no prompt.
    """

    source: str | None
    edited: str | None


@dataclass
class Perceptual:
    """The metrics that can be measured here, and why others cannot.

    Attributes:
        lpips, clip, musiq, inception: Loaded networks; None or empty if missing.
        matchers: What counts correspondences; SIFT is always there.
        missing: Metric to the line that says what it lacks.
    """

    lpips: list[Lpips] = field(default_factory=list)
    clip: ClipDirection | None = None
    musiq: Musiq | None = None
    inception: Inception | None = None
    matchers: list[Matcher] = field(default_factory=list)
    missing: dict[str, str] = field(default_factory=dict)

    @classmethod
    def load(
        cls, weights: Path | None = None, device: str = "cpu", text: EditText | None = None
    ) -> Perceptual:
        """Load every network whose weights are on the machine.

        Args:
            weights: Folder that is looked in first; see `weights.py`.
            device: Where they run.
            text: Texts of the edit; None for a run that follows no text, which has no CLIP_dir.

        Raises:
            InputError: `weights` is not a folder.
        """
        if weights is not None and not weights.is_dir():
            raise InputError(f"{weights} is not a folder: give the one that holds the weights of the metrics")
        loaded = cls()
        for backbone in (VGG, ALEX):
            network = loaded._try(backbone.title, partial(Lpips, backbone, weights, device))
            loaded.lpips += [] if network is None else [network]
        if text is not None:
            loaded.clip = loaded._try(ClipDirection.title, lambda: _clip(text, weights, device))
        loaded.musiq = loaded._try(Musiq.title, lambda: Musiq(weights, device))
        loaded.inception = loaded._try(Inception.title, lambda: Inception(weights, device))
        loftr = loaded._try(LoftrMatcher.title, lambda: LoftrMatcher(weights, device))
        loaded.matchers = [SiftMatcher(), *([] if loftr is None else [loftr])]
        return loaded

    def _try(self, title: str, load: Callable[[], Network]) -> Network | None:
        try:
            return load()
        except InputError as error:
            self.missing[title] = str(error)
            return None

    def view(self, pair: Pair) -> Figures:
        """Figures of one view; a metric that does not apply to it has none.

        Raises:
            InputError: a picture holds NaN or infinity, or they differ in size.
        """
        picture, reference = checked(pair.picture), checked(pair.reference)
        if picture.shape != reference.shape:
            shapes = f"{tuple(picture.shape)} and {tuple(reference.shape)}"
            raise InputError(f"pictures of shape {shapes} cannot be compared: give one size")
        mask = None if pair.mask is None else torch.as_tensor(pair.mask).cpu()
        figures: Figures = {}
        for lpips in self.lpips:
            figures[lpips.backbone.title] = lpips.scores(picture, reference, mask, pair.regions)
        if self.clip is not None and pair.edit:
            figures[self.clip.title] = {"whole": self.clip.score(picture, reference)}
        if self.musiq is not None and not pair.edit:
            figures[self.musiq.title] = {"whole": self.musiq.score(picture)}
        return {title: values for title, values in figures.items() if values}

    def features(self, pair: Pair) -> tuple[np.ndarray, np.ndarray] | None:
        """Features for FID of a view and its reference; None if it is not compared as a whole."""
        if self.inception is None or pair.edit or "whole" not in pair.regions:
            return None
        return tuple(self.inception.features(checked(image)) for image in (pair.picture, pair.reference))  # type: ignore[return-value]


class Gathering:
    """Figures of the views of one comparison."""

    def __init__(self, metrics: Perceptual) -> None:
        self.metrics = metrics
        self.views: dict[str, Figures] = {}
        self.features: list[tuple[np.ndarray, np.ndarray]] = []

    def add(self, name: str, pair: Pair) -> None:
        """Measure a view."""
        try:
            self.views[name] = self.metrics.view(pair)
        except InputError as error:
            raise InputError(f"{name}: {error}") from error
        features = self.metrics.features(pair)
        if features is not None:
            self.features.append(features)

    def as_json(self) -> dict[str, Any]:
        """All figures as JSON data: means over the views that have one, FID of them all, and each view."""
        mean: Figures = {}
        for figures in self.views.values():
            for title, values in figures.items():
                mean.setdefault(title, dict.fromkeys(values, 0.0)).update(dict.fromkeys(values, 0.0))
        for title, values in mean.items():
            for region in values:
                found = [view[title][region] for view in self.views.values() if region in view.get(title, {})]
                values[region] = float(np.mean(found))
        if len(self.features) > 1:
            sets = (np.stack([pair[side] for pair in self.features]) for side in (0, 1))
            mean[Inception.title] = {"whole": frechet_distance(*sets)}
        return {"mean": mean, "views": self.views, "pictures": len(self.features)}


def edit_text(
    manifest: Mapping[str, Any], source: str | None = None, edited: str | None = None
) -> EditText | None:
    """The texts of a run's edit; None for a run that follows no text.

    Args:
        manifest: Of the run.
        source, edited: Given by the user, in place of none and of the run's prompt.

    Raises:
        InputError: texts are given for a fit, which has no edit.
    """
    command, given = manifest["command"], source is not None or edited is not None
    if command == "fit" and given:
        raise InputError("a fit has no edit: leave out --source-prompt and --edit-prompt")
    if command not in ("retexture", "replace") and not given:
        return None
    return EditText(source, edited or manifest["settings"].get("prompt"))


def checked(picture: torch.Tensor) -> torch.Tensor:
    """A picture on the CPU, clipped to [0, 1].

    Raises:
        InputError: it holds NaN or infinity, or is not of shape (H, W, 3).
    """
    picture = picture.detach().cpu().float()
    if picture.ndim != 3 or picture.shape[2] != 3:
        raise InputError(f"a picture of shape {tuple(picture.shape)} is not RGB: give (H, W, 3)")
    wrong = int((~picture.isfinite().all(-1)).sum())
    if wrong:
        raise InputError(f"a picture is not finite in {wrong} of its pixels: what was rendered has diverged")
    return picture.clamp(0.0, 1.0)


def perceptual_tables(figures: Mapping[str, Any]) -> list[Table]:
    """Tables of the part "perceptual" of an evaluation: means by comparison, then what was not measured."""
    comparisons, missing = figures["comparisons"], figures["missing"]
    rows = []
    for title in (VGG.title, ALEX.title, ClipDirection.title, Musiq.title, Inception.title):
        means = [entry["mean"].get(title, {}) for entry in comparisons.values()]
        regions = [region for region in REGIONS if any(region in mean for mean in means)]
        for region in regions:
            name = title if title in SINGLE else f"{title}, {region}"
            if title == Inception.title:
                name += f" of {max(entry['pictures'] for entry in comparisons.values())} pictures"
            rows.append([name, *(_cell(title, mean.get(region)) for mean in means)])
        if not regions and title in missing:
            rows.append([title, *([NOT_MEASURED] * len(comparisons))])
    tables = []
    if rows:
        tables.append(Table("Perceptual metrics, mean over views", ["metric", *comparisons], rows))
    if missing:
        tables.append(
            Table("Not measured", ["metric", "what it lacks"], [list(pair) for pair in missing.items()])
        )
    return tables


SINGLE = (ClipDirection.title, Musiq.title, Inception.title)
"""Metrics that have one figure, of the whole picture."""


def _cell(title: str, value: float | None) -> str:
    if value is None:
        return "–"
    return f"{value:.2f}" if title in (Musiq.title, Inception.title) else f"{value:.4f}"


def _clip(text: EditText, weights: Path | None, device: str) -> ClipDirection:
    if text.edited is None:
        raise InputError(
            "the run followed no prompt: give --edit-prompt, what the scene shows after the edit"
        )
    if text.source is None:
        raise InputError("give --source-prompt, what the scene shows before the edit")
    return ClipDirection(text.source, text.edited, weights, device)
