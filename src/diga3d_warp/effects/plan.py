"""plan_effects: which effects a scene calls for, and why."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from itertools import pairwise
from typing import Any

import numpy as np

from diga3d_warp.config import Effects
from diga3d_warp.effects import evidence
from diga3d_warp.effects.observations import Observations, observe
from diga3d_warp.effects.thresholds import THRESHOLDS, Thresholds
from diga3d_warp.evaluation.tables import Table
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.scene.scene import Scene
from diga3d_warp.splatting.shade import MAX_DEGREE, degree_of


@dataclass(frozen=True)
class Choice:
    """One effect.

    Attributes:
        effect: Its name, a field of `config.Effects`.
        value: On or off, or the degree of the harmonics.
        evidence: The measurement in words and numbers; kept if the user overrides the choice.
        by: Who decided: "scene", "splat" (what a given splat was fitted with), "task" (what the pipeline
            needs, whatever the scene), "default" (the scene does not tell), or "user".
        cost_ms: Processor time of a training step, image forward and backward, that the effect takes where it
            is on, and would take where it is off [ms]; None where that was not measured.
        cost_share: The same as a part of the whole step [ratio].
    """

    effect: str
    value: bool | int
    evidence: str
    by: str = "scene"
    cost_ms: float | None = None
    cost_share: float | None = None

    def cells(self) -> list[str]:
        """The row of the table, under `COLUMNS`."""
        state = ("on" if self.value else "off") if isinstance(self.value, bool) else str(self.value)
        if self.cost_ms is None or self.cost_share is None:
            cost = "not measured"
        else:
            cost = f"{self.cost_ms:.1f} ms ({100 * self.cost_share:.0f} %)"
            cost = cost if self.value else f"would be {cost}"
        return [self.effect, state, self.by, self.evidence, cost]


ORDERED_VIEWS = 3
"""Views in which the order is compared: sorting each pixel is slow."""

COLUMNS = ("effect", "choice", "by", "evidence", "cost of a training step")


@dataclass(frozen=True)
class EffectsPlan:
    """Effects to simulate, with the evidence for each.

    Attributes:
        choices: One for each effect, in the order of `config.Effects`.
        notes: Limits of the evidence, one line each.
    """

    choices: tuple[Choice, ...]
    notes: tuple[str, ...] = field(default_factory=tuple)

    @property
    def effects(self) -> Effects:
        """The chosen effects, for `render` and `fit`."""
        return Effects(**{choice.effect: choice.value for choice in self.choices})  # type: ignore[arg-type]

    def replaced(self, choice: Choice) -> EffectsPlan:
        """The plan with a choice in place of the one for the same effect."""
        choices = (choice if other.effect == choice.effect else other for other in self.choices)
        return replace(self, choices=tuple(choices))

    def table(self) -> Table:
        """Each effect with its evidence and its cost."""
        title = " ".join(["What the scene calls for.", *self.notes])
        return Table(title, COLUMNS, [choice.cells() for choice in self.choices])

    def as_json(self) -> dict[str, Any]:
        """The plan as JSON data, with its table as the report shows it."""
        return {
            "choices": [asdict(choice) for choice in self.choices],
            "notes": list(self.notes),
            "table": self.table().as_json(),
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> EffectsPlan:
        """The plan back from JSON data."""
        return cls(tuple(Choice(**choice) for choice in data["choices"]), tuple(data["notes"]))


def plan_effects(
    scene: Scene,
    gaussians: Gaussians | None = None,
    *,
    antialiased: bool = False,
    surrounded: bool = False,
    takes_out: bool = False,
    overrides: Mapping[str, bool | int] | None = None,
    thresholds: Thresholds = THRESHOLDS,
) -> EffectsPlan:
    """Decide from a scene which effects to simulate.

    The evidence is that of the training views: displacement by the lens, drift of colours between views and
    their change with direction on the sparse points, the spread of distances, the reach of gaussians in
    depth, and transparent pixels. Nothing is fitted. It takes a few seconds.

    Args:
        scene: With sparse points and at least two views.
        gaussians: A splat that the scene came with. It is rendered as it was fitted: with all its harmonics,
            by the order of centres, without exposure.
        antialiased: Whether that splat was fitted with anti-aliasing.
        surrounded: Whether that splat came with a surround.
        takes_out: Whether an object is taken out. Its shadow and its mirror image are then looked for once
            its gaussians are known, see `effects.shadow` and `effects.mirror`.
        overrides: Effects on which the user insists, by name; later evidence takes them into account. See
            `parse_overrides`.
        thresholds: When the evidence suffices.

    Returns:
        The plan, without prices; see `prices.priced`.
    """
    chosen = dict(overrides or {})
    choices: list[Choice] = []

    def choose(effect: str, value: bool | int, said: str, by: str = "scene") -> bool | int:
        by = "user" if effect in chosen else by
        value = chosen.get(effect, value)
        choices.append(Choice(effect, value, said, by))
        return value

    notes = []
    if gaussians is not None:
        said = "its file says that it was fitted with it" if antialiased else "the splat is taken as it is"
        choose("antialias", antialiased, said, "splat")
        choose("exposure", False, "the splat is taken as it is", "splat")
        choose("sh_degree", degree_of(gaussians.sh), "all that the splat has", "splat")
        choose("pixel_order", False, _splat_order(scene, gaussians, thresholds), "splat")
    else:
        choose("pixel_order", False, "not measured: only a splat would tell", "default")
        observed = observe(scene, thresholds)
        if observed.colors.shape[1] >= thresholds.points_least:
            choose("antialias", *_antialias(observed, thresholds))
            transforms = evidence.color_transforms(observed, thresholds)
            drift = evidence.drift(transforms)
            said = f"mid-grey drifts by {drift:.1f} levels between views"
            exposure = choose("exposure", drift >= thresholds.exposure_drift, said)
            colors = evidence.corrected(observed.colors, transforms) if exposure else observed.colors
            choose("sh_degree", *_degree(observed, colors, thresholds))
        else:
            notes.append(
                f"Only {observed.colors.shape[1]} sparse points are seen by {thresholds.views_least} views or"
                " more: too few to compare colours and distances, so those effects keep their defaults."
            )
            for effect, value in (("antialias", False), ("exposure", False), ("sh_degree", MAX_DEGREE)):
                choose(effect, value, "not measured", "default")
    shift = evidence.lens_shift(_distinct(view.camera for view in scene.views))
    lens = f"the lens moves a corner by {shift:.2f} px" if shift else "the cameras are pinholes"
    choose("lens", shift >= thresholds.lens_shift, lens)
    choose("depth", False, "stages that compare depth ask for it", "task")
    choose("median_depth", False, "no stage compares it", "task")
    choose("normals", False, "no stage compares them", "task")
    cut_out = choose("background", *_background(scene, thresholds))
    if gaussians is not None:
        said = "it lies behind the splat" if surrounded else "the splat is taken as it is"
        choose("surround", surrounded, said, "splat")
    else:
        choose("surround", *_surround(scene, bool(cut_out), thresholds))
    for effect in ("shadow", "mirror"):
        looked_for = "looked for once the object is known" if chosen.get(effect, True) else "not looked for"
        choose(effect, takes_out, looked_for if takes_out else "no object is taken out", "task")
    choose("deterministic", False, "sums on CPU have a fixed order without it", "task")
    order = [entry.name for entry in fields(Effects)]
    return EffectsPlan(tuple(sorted(choices, key=lambda c: order.index(c.effect))), tuple(notes))


def _degree(observed: Observations, colors: np.ndarray, thresholds: Thresholds) -> tuple[int, str]:
    errors = evidence.view_dependence(observed, colors, thresholds)
    if not errors:
        return MAX_DEGREE, "not measured: the colours of points agree in too few views"
    gains = [float(np.sqrt(max(0.0, low**2 - high**2))) for low, high in pairwise(errors)]
    useful = [number + 1 for number, gain in enumerate(gains) if gain >= thresholds.view_dependence]
    listed = ", ".join(f"{gain:.1f}" for gain in gains)
    return max(useful, default=0), f"degrees 1, 2, 3 explain {listed} levels of change with direction"


def _antialias(observed: Observations, thresholds: Thresholds) -> tuple[bool, str]:
    spread = evidence.footprint_spread(observed)
    return (
        spread >= thresholds.footprint_spread,
        f"the median point is seen at distances of 1 : {spread:.2f}",
    )


def _background(scene: Scene, thresholds: Thresholds) -> tuple[bool, str]:
    part, count = evidence.transparency(scene.views)
    if not count:
        return False, "the photographs cover their frames"
    said = f"{100 * part:.3g} % of all pixels are transparent, in {count} of {len(scene.views)} photographs"
    return part >= thresholds.transparency, said


def _surround(scene: Scene, cut_out: bool, thresholds: Thresholds) -> tuple[bool, str]:
    seen = evidence.directions_seen([view.camera for view in scene.views])
    said = f"the photographs look into {100 * seen:.0f} % of all directions"
    if cut_out:
        return False, f"{said}, and what was cut out has nothing behind it"
    return seen < thresholds.directions, said


def _splat_order(scene: Scene, gaussians: Gaussians, thresholds: Thresholds) -> str:
    rows = np.linspace(0, len(scene.views) - 1, min(ORDERED_VIEWS, len(scene.views))).round().astype(int)
    change = evidence.order_change(gaussians, [scene.views[row].camera for row in rows], thresholds)
    return f"fitted without; sorting each pixel would change it by {change:.1f} levels"


def _distinct(cameras: Iterable) -> list:
    """Cameras that differ in lens or size: a phone's views share one."""
    return list({(c.width, c.height, c.fx, c.fy, c.cx, c.cy, c.distortion): c for c in cameras}.values())
