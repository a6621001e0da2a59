"""The knobs between accuracy and time, and the ways to render that are measured."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from diga3d_warp.config import Accuracy

ORACLE = replace(Accuracy.EXACT, alpha_min=1e-9, transmittance_min=1e-9, precision="float64")
"""Reference of all comparisons: float64, gaussians sorted for each pixel, no cut-off that float32 could
show."""


@dataclass(frozen=True)
class Way:
    """A way to render.

    Attributes:
        accuracy: Settings of the renderer.
        sh_degree: Highest degree of harmonics that is read.
        image_scale: Size of the rendering against the image that it is enlarged to.
    """

    accuracy: Accuracy = Accuracy.STANDARD
    sh_degree: int = 3
    image_scale: float = 1.0


STANDARD = Way()
PRESETS = {
    "DRAFT": Way(Accuracy.DRAFT),
    "STANDARD": STANDARD,
    "EXACT": Way(Accuracy.EXACT),
}


@dataclass(frozen=True)
class Knob:
    """One thing that trades accuracy for time, all others as in STANDARD.

    Attributes:
        name: Name in the tables.
        attribute: Name in the code.
        meaning: Approximation that it makes.
        settings: Ways to render, by the value of the setting.
        exact: The exact way for this setting: its own error is the difference to that one.
    """

    name: str
    attribute: str
    meaning: str
    settings: Mapping[str, Way]
    exact: Way


def _knob(
    name: str, attribute: str, meaning: str, settings: Mapping[str, Any], exact: Way | None = None
) -> Knob:
    """A knob of `Accuracy`; the last setting is the exact one, unless another is given."""
    ways = {label: Way(replace(Accuracy.STANDARD, **{attribute: value})) for label, value in settings.items()}
    return Knob(name, f"Accuracy.{attribute}", meaning, ways, exact or list(ways.values())[-1])


DOUBLE = Way(replace(Accuracy.STANDARD, precision="float64"))
"""In float64 the kernels call the library's exp."""

KNOBS = (
    _knob(
        "alpha skip",
        "alpha_min",
        "contributions of a gaussian to a pixel below it are left out, and boxes end there",
        {"1/64": 1 / 64, "1/255": 1 / 255, "1e-7": 1e-7},
    ),
    _knob(
        "transmittance stop",
        "transmittance_min",
        "a pixel is finished before its transmittance falls below",
        {"1e-2": 1e-2, "1e-4": 1e-4, "1e-7": 1e-7},
    ),
    _knob(
        "extent",
        "extent",
        "a splat is drawn within 3 standard deviations of its longer axis, or wherever it shows",
        {"circle": "circle", "ellipse": "ellipse"},
    ),
    _knob(
        "degree of exp",
        "exp_degree",
        "of the polynomial that stands for exp; held against the library's exp in float64",
        {str(degree): degree for degree in (3, 4, 5, 6)},
        DOUBLE,
    ),
    _knob(
        "order",
        "pixel_order",
        "gaussians are blended by the depths of their centres, or by their depths on each pixel's ray",
        {"of centres": False, "of each pixel": True},
    ),
    _knob(
        "footprint",
        "footprint",
        "projected by the Jacobian at the centre, or by sigma points through perspective and lens",
        {"affine": "affine", "unscented": "unscented"},
    ),
    _knob("precision", "precision", "of all kernels", {"float32": "float32", "float64": "float64"}),
    Knob(
        "harmonics",
        "Effects.sh_degree",
        "highest degree of spherical harmonics that is read; the scenes here have 3",
        {f"degree {degree}": Way(sh_degree=degree) for degree in range(4)},
        STANDARD,
    ),
    Knob(
        "image scale",
        "--image-scale",
        "a smaller image is rendered and enlarged",
        {"0.5": Way(image_scale=0.5), "1": STANDARD},
        STANDARD,
    ),
)


def ways() -> dict[Way, str]:
    """All ways to render that are timed, each once, with a name: presets, then each knob's settings."""
    named = {way: name for name, way in PRESETS.items()}
    for name, way in _settings():
        named.setdefault(way, name)
    return named


def _settings() -> Iterator[tuple[str, Way]]:
    for knob in KNOBS:
        for label, way in knob.settings.items():
            yield f"{knob.name} {label}", way
