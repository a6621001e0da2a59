"""A shell of large gaussians behind everything, so that no view looks into nothing.

Views beside the training views reach where no photograph did. There the shell shows the colours of the
nearest directions that were photographed, without detail. It is made before the fit, which compares its
renderings over the shell: where a short fit is not opaque yet, the shell shows through as it was fitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from diga3d_warp.config import Effects
from diga3d_warp.gaussians.initialise import round_gaussians
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.gaussians.representation import Representation
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.photographs.images import BACKGROUND
from diga3d_warp.splatting.optics import optics_of
from diga3d_warp.splatting.render import Rendering, render


@dataclass(frozen=True)
class SurroundSettings:
    """Size and colours of the shell.

    Attributes:
        count: Gaussians of the shell, 8 degrees apart: together they hide 99.9 % of what is behind them.
        width: Standard deviation [distances between neighbours]. At 0.7 no gap shows.
        opacity: Of each of them.
        beyond: Radius [distances of the farthest gaussian]: the shell hides nothing.
        radius_least: Least radius [scene extents]; nearer, it would move against the scene as cameras move.
        radius_most: Gaussians farther away than this do not count [scene extents]: a few always run away.
        spread: Photographs count towards the colour of a direction by their angle from it, with this standard
            deviation [degrees]. Wider than a gaussian, so that the shell has no edges.
        far: Weight of all photographs together [parts of the largest weight]: decides on the directions that
            no photograph comes near.
        rows: Rays of a photograph that are looked at, in each direction.
    """

    count: int = 600
    width: float = 0.7
    opacity: float = 0.99
    beyond: float = 1.05
    radius_least: float = 10.0
    radius_most: float = 1000.0
    spread: float = 12.0
    far: float = 1e-3
    rows: int = 24


SURROUND = SurroundSettings()


def surround_of(
    cameras: Sequence[Camera], photographs: Sequence[np.ndarray], means: torch.Tensor, extent: float,
    coefficients: int,
) -> Gaussians:  # fmt: skip
    """The shell of a capture whose cameras lie around the origin.

    Args:
        cameras: One per photograph, in working units.
        photographs: RGB, each (H, W, 3), uint8.
        means: Centres of the gaussians before it, shape (N, 3).
        extent: Extent of the capture [scene units].
        coefficients: Spherical harmonics per gaussian; those above the first are zero.
    """
    directions = sphere(SURROUND.count)
    radius = _radius(means, extent)
    apart = radius * np.sqrt(4.0 * np.pi / SURROUND.count)
    log_scales = np.full(SURROUND.count, np.log(SURROUND.width * apart))
    colors = _colors(directions, cameras, photographs)
    return round_gaussians(radius * directions, log_scales, colors, SURROUND.opacity, coefficients)


def beyond(shell: Gaussians, means: torch.Tensor, extent: float) -> Gaussians:
    """The shell of a splat, made larger where the splat has grown beyond it; arguments as `surround_of`."""
    before = float(shell.means.norm(dim=1).max())
    ratio = max(1.0, _radius(means, extent) / max(before, 1e-300))
    return replace(shell, means=ratio * shell.means, log_scales=shell.log_scales + float(np.log(ratio)))


def behind_view(shell: Gaussians, camera: Camera) -> torch.Tensor:
    """What a camera sees of the shell, RGB, shape (h, w, 3): small, because it has no detail."""
    size = max(1, round(SURROUND.rows * camera.width / camera.height)), SURROUND.rows
    with torch.no_grad():
        return render(shell, camera.resized(*size)).color


def over_shell(
    color: torch.Tensor, alpha: torch.Tensor, behind: torch.Tensor, camera: Camera
) -> torch.Tensor:
    """A rendering with the shell behind it, RGB, shape (H, W, 3).

    Args:
        color: Over nothing, shape (H, W, 3).
        alpha: Its opacity, shape (H, W).
        behind: From `behind_view`.
        camera: Of the rendering.
    """
    size = (camera.height, camera.width)
    large = torch.nn.functional.interpolate(behind.permute(2, 0, 1)[None], size, mode="bilinear")[0]
    return color + (1.0 - alpha)[..., None] * large.permute(1, 2, 0)


@torch.no_grad()
def render_before(
    shell: Gaussians | None, gaussians: Representation, camera: Camera, effects: Effects
) -> Rendering:
    """A splat as viewers show it: over the shell, or over `BACKGROUND` where photographs have alpha.

    Opacity and depth are those of the splat alone. No gradients.
    """
    if shell is None:
        return render(gaussians, camera, effects=effects, background=BACKGROUND)
    seen = render(gaussians, camera, effects=effects)
    return seen._replace(color=over_shell(seen.color, seen.alpha, behind_view(shell, camera), camera))


def _radius(means: torch.Tensor, extent: float) -> float:
    distances = np.linalg.norm(means.detach().cpu().double().numpy(), axis=1)
    counted = distances[distances < SURROUND.radius_most * extent]
    return max(SURROUND.radius_least * extent, SURROUND.beyond * float(counted.max(initial=0.0)))


def sphere(count: int) -> np.ndarray:
    """Unit vectors spread evenly over the sphere (Fibonacci lattice), shape (count, 3)."""
    number = np.arange(count) + 0.5
    height, turn = 1.0 - 2.0 * number / count, np.pi * (1.0 + np.sqrt(5.0)) * number
    across = np.sqrt(1.0 - height**2)
    return np.stack([across * np.cos(turn), across * np.sin(turn), height], axis=1)


def _colors(
    directions: np.ndarray, cameras: Sequence[Camera], photographs: Sequence[np.ndarray]
) -> np.ndarray:
    """Colour of each direction in [0, 1]: a mean of the photographs, the nearer rays the more."""
    import cv2

    total, weight = np.zeros((len(directions), 3)), np.zeros(len(directions))
    mean, counted = np.zeros(3), 0
    for camera, photograph in zip(cameras, photographs, strict=True):
        size = max(1, round(SURROUND.rows * camera.width / camera.height)), SURROUND.rows
        pixels = cv2.resize(photograph, size, interpolation=cv2.INTER_AREA).reshape(-1, 3) / 255.0
        rays = optics_of(camera.resized(*size)).rays.reshape(-1, 2)
        reached = np.isfinite(rays).all(axis=1)
        ahead = np.concatenate([rays[reached], np.ones((int(reached.sum()), 1))], axis=1)
        world = ahead / np.linalg.norm(ahead, axis=1, keepdims=True) @ camera.pose[:3, :3]
        nearness = np.exp((directions @ world.T - 1.0) / np.radians(SURROUND.spread) ** 2)
        total += nearness @ pixels[reached]
        weight += nearness.sum(axis=1)
        mean, counted = mean + pixels[reached].sum(axis=0), counted + len(world)
    usual = SURROUND.far * max(float(weight.max()), 1e-12)
    return (total + usual * mean / max(counted, 1)) / (weight + usual)[:, None]
