"""Finished jobs that are measured again, because weights are there now that were missing then."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from diga3d_warp.experiments.job import Job, Outcome


def has_more_weights(job: Job, outcome: Outcome) -> bool:
    """Whether a metric that a job could not measure for want of weights can be measured now."""
    if not outcome["missing"] or outcome["protocol"] is None:
        return False
    prompts = job.source_prompt is not None and (job.edit_prompt or job.options.get("prompt")) is not None
    return bool(outcome["missing"].keys() & _found(job.weights, prompts))


@cache
def _found(weights: str | None, prompts: bool) -> frozenset[str]:
    """Metrics whose weights are on this machine."""
    from diga3d_warp.evaluation.clip_direction import ClipDirection
    from diga3d_warp.evaluation.correspondences import LoftrMatcher
    from diga3d_warp.evaluation.frechet import Inception
    from diga3d_warp.evaluation.lpips import ALEX, VGG
    from diga3d_warp.evaluation.musiq import Musiq
    from diga3d_warp.evaluation.perceptual import EditText, Perceptual

    text = EditText("a", "b") if prompts else None
    missing = Perceptual.load(None if weights is None else Path(weights), "cpu", text).missing
    titles = {VGG.title, ALEX.title, Musiq.title, Inception.title, LoftrMatcher.title}
    return frozenset(titles | ({ClipDirection.title} if prompts else set())) - missing.keys()
