"""The light whose shadow explains how dark the surroundings of an object are.

The light is an even sky and one round lamp. What the object hides of them follows from its shape, so a shadow
has six unknowns only, and a rug's pattern or a stain is not taken for one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from diga3d_warp.shadows.casting import FEW, Caster, Lamp

ELEVATIONS, AZIMUTHS, NEARNESSES = (20.0, 30.0, 42.0, 55.0, 70.0), 24, (0.0, 0.25)
"""Lamps that are tried first: elevations [degrees], directions around, and nearnesses [ratio]."""

FIRST_RADIUS = 8.0
"""Angular radius of the lamps that are tried first [degrees]: that of a room's lamp or window, and near
enough to the sun's for the search to begin."""

BEST = 6
"""Lamps of the first trial that are compared robustly."""

STEPS = 60
"""Evaluations of the simplex search (Nelder and Mead 1965) over the four numbers of a lamp; after 60 the
elevation changes by less than a degree."""

OFF = 0.15
"""Scale of Cauchy's function for differences of ratios [1]: that of textures whose patches are alike."""

CLOSEST, WIDEST = 0.34, 25.0
"""Nearest and widest lamps: height of the object over that of the lamp [ratio], angular radius [degrees]. One
right above the object has a shadow of any size, and would explain a mat."""

STAINS = 16
"""Radii of round stains that are compared with lights."""

REWEIGHTINGS = 4

SHIFTS, SHIFT, FELT = 8, 1.0, 0.1
"""Directions in which shadows are tried at other places, how far [sizes of the area where the object hides
`FELT` of the sky], and that part of the sky."""

RIDGE = 0.3
"""Standard deviation that the gradient of the light without the object may have over the chart [1]."""


@dataclass(frozen=True, eq=False)
class Light:
    """Light on a support.

    Attributes:
        sky: Share that comes from an even sky [1].
        direct: Share that comes from the lamp [1].
        lamp: Where it is.
    """

    sky: float
    direct: float
    lamp: Lamp


@dataclass(frozen=True, eq=False)
class Measured:
    """Ratios that were measured at places of a chart.

    Attributes:
        index: Flat index of each place, shape (P,).
        at: Position, -1 to 1 over the chart, shape (P, 2).
        ratio: Brightness over that of places alike, shape (P,).
        weight: Trust, shape (P,).
    """

    index: np.ndarray
    at: np.ndarray
    ratio: np.ndarray
    weight: np.ndarray


@dataclass(frozen=True, eq=False)
class Fitted:
    """A light that was fitted.

    Attributes:
        light: The light.
        ratio: Share of the light that is left, shape (H, W).
        cost: Robust cost of what is measured under the light, of all places.
        cost_without: The same under a light that the object hides nothing of.
        cost_painted: Total cost if a round stain is around the foot of the object instead.
        chance: What a shadow of the same shape explains elsewhere on the support, against what it explains
            here [ratio]; zero where there is no other place.
    """

    light: Light
    ratio: np.ndarray
    cost: np.ndarray
    cost_without: np.ndarray
    cost_painted: float
    chance: float


class LightSearch:
    """Search of the light of a chart; what the object hides of each trial lamp is worked out once."""

    def __init__(self, caster: Caster) -> None:
        self.caster = caster
        self.sky = caster.shade_of_sky()
        self.lamps = [
            Lamp(360.0 * turn / AZIMUTHS, elevation, nearness, FIRST_RADIUS)
            for elevation in ELEVATIONS
            for turn in range(AZIMUTHS)
            for nearness in NEARNESSES
        ]
        self.trials = np.stack([caster.shade(lamp, FEW) for lamp in self.lamps])

    def fit(self, measured: Measured) -> Fitted:
        """The light that explains what is measured best."""
        from scipy.optimize import minimize

        sky = self.sky.ravel()[measured.index]
        drift = _drift(measured.at)
        shades = self.trials.reshape(len(self.trials), -1)[:, measured.index]
        without = _explained(measured, np.zeros((0, len(sky))), drift)
        gains = _gains(measured, np.stack([sky, *drift], axis=1), shades)
        compared = [
            (_explained(measured, np.stack([sky, shades[row]]), drift).total, row)
            for row in np.argsort(-gains)[:BEST]
        ]
        start = self.lamps[min(compared)[1]]

        def lamp_of(numbers: np.ndarray) -> Lamp:
            azimuth, elevation, nearness, radius = numbers.tolist()
            return Lamp(
                10.0 * azimuth, 10.0 * elevation, min(abs(nearness), CLOSEST), min(abs(10.0 * radius), WIDEST)
            )

        def cost_of(numbers: np.ndarray) -> float:
            shade = self.caster.shade(lamp_of(numbers)).ravel()[measured.index]
            return _explained(measured, np.stack([sky, shade]), drift).total

        first = np.array([start.azimuth / 10.0, start.elevation / 10.0, start.nearness, start.radius / 10.0])
        simplex = first + np.concatenate([np.zeros((1, 4)), np.diag([1.0, 1.0, 0.15, -0.4])])
        best = minimize(
            cost_of, first, method="Nelder-Mead", options={"maxfev": STEPS, "initial_simplex": simplex}
        )
        lamp = lamp_of(best.x)
        shade = self.caster.shade(lamp)
        found = _explained(measured, np.stack([sky, shade.ravel()[measured.index]]), drift)
        light = Light(float(found.shares[0]), float(found.shares[1]), lamp)
        chance = self._chance(measured, drift, float(gains.max()))
        painted = self._painted(measured, drift)
        return Fitted(light, self.ratio(light, shade), found.cost, without.cost, painted, chance)

    def _painted(self, measured: Measured, drift: np.ndarray) -> float:
        """Least cost of a round stain around the foot, which is as dark everywhere."""
        away = self.caster.away.ravel()[measured.index]
        radii = np.quantile(away, np.linspace(0.02, 0.6, STAINS))
        return min(
            _explained(measured, (away < radius)[None].astype(np.float32), drift).total for radius in radii
        )

    def _chance(self, measured: Measured, drift: np.ndarray, here: float) -> float:
        """The upper quartile of what the trials explain at other places, over what they explain here."""
        rows, columns = self.caster.frame.size
        row, column = np.unravel_index(measured.index, (rows, columns))
        reach = self.sky > FELT
        held = int(reach.ravel()[measured.index].sum())
        step = SHIFT * float(np.sqrt(reach.sum()))
        gains = []
        for turn in 2.0 * np.pi * np.arange(SHIFTS) / SHIFTS:
            for far in (1.0, 2.0):
                r = row - round(far * step * float(np.sin(turn)))
                c = column - round(far * step * float(np.cos(turn)))
                inside = (r >= 0) & (r < rows) & (c >= 0) & (c < columns)
                r, c = np.where(inside, r, 0), np.where(inside, c, 0)
                if (inside & reach[r, c]).sum() < 0.5 * held:
                    continue
                sky = np.where(inside, self.sky[r, c], 0.0)
                shades = np.where(inside, self.trials[:, r, c], 0.0)
                gains.append(_gains(measured, np.stack([sky, *drift], axis=1), shades).max())
        return float(np.quantile(gains, 0.75)) / max(here, 1e-12) if gains else 0.0

    def ratio(self, light: Light, shade: np.ndarray | None = None) -> np.ndarray:
        """Share of a light that the object leaves, shape (H, W)."""
        shade = self.caster.shade(light.lamp) if shade is None else shade
        return 1.0 - light.sky * self.sky - light.direct * shade


def _drift(at: np.ndarray) -> np.ndarray:
    """Functions of the place by which the light may change without the object, shape (6, P)."""
    u, v = at.T.astype(np.float64)
    return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v])


@dataclass(frozen=True, eq=False)
class _Explained:
    shares: np.ndarray
    cost: np.ndarray

    @property
    def total(self) -> float:
        return float(self.cost.sum())


def _explained(measured: Measured, shades: np.ndarray, drift: np.ndarray) -> _Explained:
    """Shares of lights (K, P) that explain the ratios, none negative and together at most 1."""
    count = len(shades)
    columns = np.concatenate([-shades, drift]).T.astype(np.float64)
    wanted = measured.ratio - 1.0
    weight = measured.weight.astype(np.float64)
    penalty = np.zeros(columns.shape[1])
    penalty[count + 1 :] = OFF**2 / RIDGE**2 * 0.01 * weight.sum()
    shares, residual = np.zeros(columns.shape[1]), wanted
    for _ in range(REWEIGHTINGS):
        shares = _bounded(columns, wanted, weight, penalty, count)
        residual = wanted - columns @ shares
        weight = measured.weight / (1.0 + (residual / OFF) ** 2)
    return _Explained(shares[:count], measured.weight * np.log1p((residual / OFF) ** 2))


def _bounded(
    columns: np.ndarray, wanted: np.ndarray, weight: np.ndarray, penalty: np.ndarray, count: int
) -> np.ndarray:
    """Weighted least squares whose first `count` unknowns are not negative and sum up to 1 at most."""
    normal = (columns * weight[:, None]).T @ columns + np.diag(penalty + 1e-9 * weight.sum())
    right = (columns * weight[:, None]).T @ wanted
    used = np.ones(len(right), bool)
    while True:
        found = np.zeros(len(right))
        found[used] = np.linalg.solve(normal[np.ix_(used, used)], right[used])
        negative = np.flatnonzero(found[:count] < 0.0)
        if not len(negative):
            break
        used[negative] = False
    total = found[:count].sum()
    if total > 1.0:
        found[:count] /= total
        rest = slice(count, None)
        found[rest] = np.linalg.solve(normal[rest, rest], right[rest] - normal[rest, :count] @ found[:count])
    return found


def _gains(measured: Measured, others: np.ndarray, shades: np.ndarray) -> np.ndarray:
    """What each shade (K, P) alone adds to the explanation by others (P, M), in weighted squares."""
    wanted = measured.ratio - 1.0
    weight = measured.weight / (1.0 + (wanted / (2.0 * OFF)) ** 2)
    weighted = others * weight[:, None]
    inverse = np.linalg.inv(weighted.T @ others + 1e-9 * weight.sum() * np.eye(others.shape[1]))
    left = shades.T - others @ (inverse @ (weighted.T @ shades.T))
    agreeing = np.maximum(-(left * (weight * wanted)[:, None]).sum(axis=0), 0.0)
    return agreeing**2 / np.maximum((left**2 * weight[:, None]).sum(axis=0), 1e-3 * weight.sum())
