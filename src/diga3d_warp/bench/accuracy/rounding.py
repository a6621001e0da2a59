"""Rounding error of float32: STANDARD against itself in float64, with pixels near a cut-off apart.

Skipping a small alpha and stopping at a small transmittance are discontinuous: where a value lies within
rounding of its cut-off, float32 and float64 may decide differently, and the pixel differs by what is skipped.
Higher precision makes such pixels rarer, but not their difference smaller, so they are counted apart.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import torch

from diga3d_warp.bench.accuracy.knobs import DOUBLE, STANDARD
from diga3d_warp.bench.accuracy.measure import Error, error, rendered
from diga3d_warp.bench.accuracy.scenes import Subject
from diga3d_warp.config import Effects
from diga3d_warp.evaluation.tables import Table
from diga3d_warp.splatting.render import render


@dataclass(frozen=True)
class Margin:
    """Distance to a cut-off within which rounding may decide [share of the cut-off].

    Attributes:
        alpha: Of the skip. Rounding of an exponent of ln 255 is some 1e-6, on needles 1e-5 to 1e-4.
        transmittance: Of the stop. Each opaque gaussian before it divides the rounding of its alpha by
            1 - alpha, down to 0.01.
    """

    alpha: float = 1e-4
    transmittance: float = 1e-3


NOTE = f"""\
Rounding is what float32 alone makes of STANDARD. A pixel is undecided where an alpha lies within
{Margin.alpha:g} of the skip or a transmittance within {Margin.transmittance:g} of the stop, relatively: there
float32 may skip or stop where float64 does not, and the pixel is off by what is left out. Undecided pixels
that are off by more than any decided one are counted as decided otherwise.

"""


@dataclass(frozen=True)
class Rounding:
    """Errors of float32 in one scene.

    Attributes:
        error: Over the whole image.
        decided: Over the pixels that are decided.
        undecided: Share of the others.
        otherwise: Number of undecided pixels that are off by more than any decided one.
    """

    error: Error
    decided: Error
    undecided: float
    otherwise: int


def rounding(subject: Subject, margin: Margin = Margin()) -> Rounding:
    """Measure STANDARD against float64 with the same cut-offs."""
    decided = decided_pixels(subject, margin)
    found, truth = rendered(subject, STANDARD), rendered(subject, DOUBLE)
    far = (found.color - truth.color).abs().amax(-1)
    kept, kept_truth = rendered(subject, STANDARD, decided), rendered(subject, DOUBLE, decided)
    kept = kept._replace(color=torch.where(decided[..., None], kept.color, kept_truth.color))
    return Rounding(
        error(found, truth),
        error(kept, kept_truth),
        float((~decided).double().mean()),
        int((far > far[decided].max())[~decided].sum()),
    )


def decided_pixels(subject: Subject, margin: Margin = Margin()) -> torch.Tensor:
    """Pixels without an alpha or a transmittance near its cut-off, shape (H, W), bool.

    They are those whose float64 image stays the same, to the bit, as the cut-offs move across the margin.
    """
    double = DOUBLE.accuracy
    lower, upper = (
        replace(
            double,
            alpha_min=double.alpha_min * (1.0 + sign * margin.alpha),
            transmittance_min=double.transmittance_min * (1.0 + sign * margin.transmittance),
        )
        for sign in (-1.0, 1.0)
    )
    with torch.no_grad():
        first, second = (
            render(subject.gaussians, subject.camera, effects=Effects(depth=False), accuracy=accuracy)
            for accuracy in (lower, upper)
        )
    return (first.color == second.color).all(-1) & (first.alpha == second.alpha)


def rounding_table(results: Mapping[str, Rounding]) -> Table:
    """A row for each scene."""
    rows = [
        (
            name,
            *(f"{x:.1e}" for each in (found.error, found.decided) for x in (each.largest, each.gradient)),
            f"{100 * found.undecided:.2f}",
            str(found.otherwise),
        )
        for name, found in results.items()
    ]
    columns = [
        "scene", "max", "gradient", "max, decided", "gradient, decided", "undecided [%]", "otherwise [px]",
    ]  # fmt: skip
    return Table("Rounding: STANDARD against float64 with the same cut-offs", columns, rows)
