"""Figures that speak for or against an effect, each measured from the scene alone."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import torch

from diga3d_warp.config import Effects
from diga3d_warp.effects.observations import Observations
from diga3d_warp.effects.thresholds import LEVELS, Thresholds
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.gaussians.surround import SURROUND, sphere
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.scene import View
from diga3d_warp.scene.visible_points import visible_points
from diga3d_warp.splatting.optics import optics_of
from diga3d_warp.splatting.render import render
from diga3d_warp.splatting.shade import MAX_DEGREE

MID_GREY = 0.5
"""Where a colour transform is judged: gain and offset trade off at the ends, not in the middle."""

ROUNDS, REWEIGHTINGS = 4, 3
"""Rounds of colours and transforms in turn, and of weights within one; more change the drift by under 1 %."""


def lens_shift(cameras: Iterable[Camera]) -> float:
    """Largest displacement that a lens causes at a corner of an image [px]; 0 for pinholes.

    Infinity if the lens model does not reach a corner.
    """
    largest = 0.0
    for camera in cameras:
        if camera.distortion is None:
            continue
        rows, columns = np.array([0, 0, -1, -1]), np.array([0, -1, 0, -1])
        rays = optics_of(camera).rays.reshape(camera.height, camera.width, 2)[rows, columns]
        pinhole = rays.astype(np.float64) * (camera.fx, camera.fy) + (camera.cx, camera.cy)
        pixels = np.stack([columns % camera.width, rows % camera.height], axis=1) + 0.5
        shift = np.linalg.norm(pinhole - pixels, axis=1)
        largest = max(largest, float(np.where(np.isfinite(shift), shift, np.inf).max()))
    return largest


def footprint_spread(observed: Observations) -> float:
    """Median over points of the largest over the smallest sampling in the views that see them [ratio]."""
    nearest, farthest = np.nanmax(observed.sampling, 0), np.nanmin(observed.sampling, 0)
    return float(np.median(nearest / farthest))


def transparency(views: Sequence[View]) -> tuple[float, int]:
    """Transparent part of the area of all photographs [ratio], and how many have any."""
    parts = [0.0 if view.alpha is None else 1.0 - float(view.alpha.mean()) / LEVELS for view in views]
    areas = [view.pixels.shape[0] * view.pixels.shape[1] for view in views]
    return float(np.average(parts, weights=areas)), sum(part > 0.0 for part in parts)


def directions_seen(cameras: Sequence[Camera]) -> float:
    """Share of all directions that at least one camera looks into [ratio]."""
    around = sphere(SURROUND.count)
    seen = np.zeros(len(around), bool)
    for camera in cameras:
        seen[visible_points(camera, camera.center + around).index] = True
    return float(seen.mean())


def color_transforms(observed: Observations, thresholds: Thresholds) -> np.ndarray:
    """Gain and offset of each view and channel against the colours that all views agree on, (V, 2, 3).

    Robust: colours and transforms are found in turn, colours as medians over views, transforms with weights
    that fall with the residual (Cauchy). The mean gain is 1 and the mean offset 0. A view that sees too few
    points keeps gain 1 and offset 0.
    """
    views = len(observed.colors)
    transforms = np.zeros((views, 2, 3))
    transforms[:, 0] = 1.0
    for _ in range(ROUNDS):
        agreed = np.nanmedian(corrected(observed.colors, transforms), axis=0)
        for view in range(views):
            seen = observed.seen[view]
            if seen.sum() >= thresholds.points_least:
                transforms[view] = _robust_lines(agreed[seen], observed.colors[view, seen], transforms[view])
        transforms[:, 0] /= transforms[:, 0].mean(0)
        transforms[:, 1] -= transforms[:, 1].mean(0)
    return transforms


def corrected(colors: np.ndarray, transforms: np.ndarray) -> np.ndarray:
    """Colours (V, P, 3) with the transforms (V, 2, 3) of their views undone."""
    return (colors - transforms[:, None, 1]) / transforms[:, None, 0]


def drift(transforms: np.ndarray) -> float:
    """Shift of a mid-grey by transforms (V, 2, 3), root mean square over views and channels [levels]."""
    shift = transforms[:, 0] * MID_GREY + transforms[:, 1] - MID_GREY
    return float(LEVELS * np.sqrt((shift**2).mean()))


def view_dependence(observed: Observations, colors: np.ndarray, thresholds: Thresholds) -> list[float]:
    """Error of colours in views left out, for harmonics of degree 0 to 3, root mean square [levels].

    Each point's colours are predicted for one view from all others (leave-one-out residuals of a ridge
    regression in closed form). Colours that are the same from everywhere gain nothing by a higher degree. No
    errors where too few points have enough views.

    Args:
        observed: Directions.
        colors: Colours of the same points, exposure undone if it drifts, shape (V, P, 3).
        thresholds: What is left out, and regularisation.
    """
    colors, directions = colors.swapaxes(0, 1), observed.directions.swapaxes(0, 1)
    deviation = np.abs(colors - np.nanmedian(colors, axis=1, keepdims=True)).max(2)
    used = deviation < thresholds.outlier  # NaN, where a view does not see the point, is not
    enough = used.sum(1) >= thresholds.views_least
    used, colors, directions = used[enough], np.nan_to_num(colors[enough]), directions[enough]
    if len(colors) < thresholds.points_least:
        return []
    squares = []
    for degree in range(MAX_DEGREE + 1):
        basis = harmonics(directions, degree) * used[..., None]
        penalty = np.full(basis.shape[2], thresholds.ridge)
        penalty[0] = 1e-9
        normal = basis.swapaxes(1, 2) @ basis + np.diag(penalty)
        solved = np.linalg.solve(normal, basis.swapaxes(1, 2))
        leverage = np.einsum("pvk,pkv->pv", basis, solved)
        residual = colors - basis @ (solved @ (colors * used[..., None]))
        left_out = residual / (1.0 - leverage).clip(1e-6)[..., None] * used[..., None]
        squares.append((left_out**2).sum((1, 2)) / (3 * used.sum(1)))
    kept = squares[0] <= np.quantile(squares[0], 1.0 - thresholds.worst_share)
    return [float(LEVELS * np.sqrt(square[kept].mean())) for square in squares]


def harmonics(directions: np.ndarray, degree: int) -> np.ndarray:
    """Real spherical harmonics of unit vectors (..., 3) up to a degree of 3, in the order of 3DGS.

    Signs are left out: a fit takes them up.
    """
    x, y, z = np.moveaxis(directions, -1, 0)
    values = [np.full_like(x, 0.28209479)]
    if degree > 0:
        values += [0.4886025 * axis for axis in (y, z, x)]
    if degree > 1:
        values += [1.0925484 * x * y, 1.0925484 * y * z, 0.31539157 * (3 * z * z - 1)]
        values += [1.0925484 * x * z, 0.5462742 * (x * x - y * y)]
    if degree > 2:
        values += [0.5900436 * y * (3 * x * x - y * y), 2.8906114 * x * y * z]
        values += [0.4570458 * y * (5 * z * z - 1), 0.3731763 * z * (5 * z * z - 3)]
        values += [0.4570458 * x * (5 * z * z - 1), 1.4453057 * z * (x * x - y * y)]
        values += [0.5900436 * x * (x * x - 3 * y * y)]
    return np.stack(values, axis=-1)


def order_change(gaussians: Gaussians, cameras: Sequence[Camera], thresholds: Thresholds) -> float:
    """What sorting each pixel by its own depths changes in pictures, root mean square [levels]."""
    squares = []
    for camera in cameras:
        small = camera.within(thresholds.order_side)
        with torch.no_grad():
            by_centers, by_pixels = (
                render(gaussians, small, effects=Effects(depth=False, pixel_order=own)).color.clamp(0.0, 1.0)
                for own in (False, True)
            )
        squares.append(float((by_centers - by_pixels).square().mean()))
    return float(LEVELS * np.sqrt(np.mean(squares)))


def _robust_lines(x: np.ndarray, y: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Gain and offset (2, 3) from colours x to y, both (M, 3), weighted by Cauchy's function."""
    gain, offset = start
    for _ in range(REWEIGHTINGS):
        residual = y - gain * x - offset
        width = 2.0 * (1.4826 * np.median(np.abs(residual), axis=0) + 1.0 / LEVELS)
        weight = 1.0 / (1.0 + (residual / width) ** 2)
        weight /= weight.sum(0)
        mean_x, mean_y = (weight * x).sum(0), (weight * y).sum(0)
        spread = (weight * (x - mean_x) ** 2).sum(0)
        # A ridge towards gain 1 of a hundredth of white squared: flat views do not tell gain from offset.
        ridge = 0.01**2
        gain = ((weight * (x - mean_x) * (y - mean_y)).sum(0) + ridge) / (spread + ridge)
        offset = mean_y - gain * mean_x
    return np.stack([gain, offset])
