"""A painted pillar on a glossy plane, or on a pane of glass: what photographs show is known exactly."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch

from diga3d_warp.config import Effects
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.kernels.harmonics import C0
from diga3d_warp.materials.painting import GAMMA
from diga3d_warp.mirrors.find import MirrorEvidence, find_mirror
from diga3d_warp.mirrors.reflection import reflection
from diga3d_warp.mirrors.settings import MIRRORS
from diga3d_warp.scene.camera import Camera
from diga3d_warp.shadows.support import Solid, Support
from diga3d_warp.splatting.placement import unprojected
from diga3d_warp.surfaces.chart import frame_on, sized
from diga3d_warp.surfaces.photo import Photo
from diga3d_warp.surfaces.planes import Plane
from tabletop import EYES, Pattern, camera_at, checks, level, photo

RADIUS, TALL = 0.12, 0.5
"""Of the pillar [m]."""

AROUND = [*EYES, (2.2, -1.2, 2.0), (2.0, 1.4, 2.1), (0.2, 2.5, 2.2), (-2.1, 1.0, 2.0), (-2.2, -1.0, 2.1)]
"""Places all around."""

FEW = replace(MIRRORS, texels=64, texels_least=40)
"""A coarser chart: tests take less time."""

Paint = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Turn and height on a pillar to its linear colour."""


def painted(turn: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Two hues around, two along: nothing too fine for the cameras."""
    around, along = 0.5 + 0.4 * np.sin(turn), 0.5 + 0.4 * np.sin(2.0 * np.pi * height / TALL)
    return np.stack([around, along, np.full_like(turn, 0.3)], axis=-1) ** GAMMA


def dark(turn: np.ndarray, height: np.ndarray) -> np.ndarray:
    return np.full((*turn.shape, 3), 0.03)


def met(
    origins: np.ndarray, directions: np.ndarray, radius: float, low: float, high: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where rays meet an upright pillar about the origin: whether they do, turn and height there."""
    a = (directions[..., :2] ** 2).sum(-1)
    b = (origins[..., :2] * directions[..., :2]).sum(-1)
    c = (origins[..., :2] ** 2).sum(-1) - radius**2
    root = b**2 - a * c
    along = (-b - np.sqrt(np.maximum(root, 0.0))) / a
    at = origins + along[..., None] * directions
    hit = (root > 0.0) & (along > 0.0) & (at[..., 2] >= low) & (at[..., 2] <= high)
    return hit, np.arctan2(at[..., 1], at[..., 0]), at[..., 2]


def on_plane(camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where each pixel meets the plane, whether it does, and its direction there."""
    z = level(camera, 0.0)
    shown = np.isfinite(z)
    points = unprojected(np.where(shown, z, 1.0), camera)
    return points, shown, points - camera.center


def mixed(seen: Photo, other: np.ndarray, share: float, shown: np.ndarray) -> Photo:
    """A photograph of the plane with other linear colours added to a share."""
    linear = (seen.pixels / 255.0) ** GAMMA
    both = np.where(shown[..., None], (1.0 - share) * linear + share * other, linear)
    return replace(seen, pixels=np.round(255.0 * np.clip(both, 0, 1) ** (1.0 / GAMMA)).astype(np.uint8))


def mirror_photo(
    eye: Sequence[float], pattern: Pattern, gloss: float, paint: Paint = painted, room: float = 0.5,
    with_pillar: bool = True, hole: float = 0.16,
) -> Photo:  # fmt: skip
    """The plane as a mirror shows it: the pillar, and a room that changes with the direction."""
    camera = camera_at(eye)
    points, shown, directions = on_plane(camera)
    directions = directions * [1.0, 1.0, -1.0]
    hit, turn, height = met(points, directions, RADIUS, 0.0, TALL)
    sideways = np.arctan2(directions[..., 1], directions[..., 0])
    above = np.repeat((room * (1.0 + 0.2 * np.sin(3.0 * sideways)))[..., None], 3, axis=-1)
    mirrored = np.where((hit & with_pillar)[..., None], paint(turn, height), above)
    return mixed(photo(camera, pattern, hole=hole), mirrored, gloss, shown)


def window_photo(
    eye: Sequence[float], pattern: Pattern, share: float, radius: float, deep: float, paint: Paint
) -> Photo:
    """The plane as a pane: a floor is seen through it, and a leg that reaches down under the pillar."""
    camera = camera_at(eye)
    points, shown, directions = on_plane(camera)
    hit, turn, height = met(points, directions, radius, -deep, 0.0)
    down = points + directions * (-deep / np.minimum(directions[..., 2], -1e-3))[..., None]
    floor = checks(down[..., 0], down[..., 1]) ** GAMMA
    return mixed(
        photo(camera, pattern, hole=0.16), np.where(hit[..., None], paint(turn, height), floor), share, shown
    )


def pillar(paint: Paint = painted, count: int = 3000) -> Gaussians:
    """Gaussians on the pillar, in its colours."""
    rng = np.random.default_rng(0)
    turn, height = rng.uniform(-np.pi, np.pi, count), rng.uniform(0.0, TALL, count)
    places = np.stack([RADIUS * np.cos(turn), RADIUS * np.sin(turn), height], axis=1)
    color = paint(turn, height) ** (1.0 / GAMMA)
    return Gaussians(
        torch.from_numpy(places).float(),
        torch.full((count, 3), float(np.log(0.012))),
        torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(count, 1),
        torch.full((count,), 3.0),
        torch.from_numpy((color - 0.5) / C0).float()[:, None, :],
    )


def support() -> Support:
    """The plane around the pillar's foot."""
    places = np.random.default_rng(1).uniform(-1.5, 1.5, (500, 2))
    plane = Plane(np.array([0.0, 0.0, 1.0]), 0.0, np.concatenate([places, np.zeros((500, 1))], axis=1))
    frame = frame_on(plane, camera_at(AROUND[0]))
    foot = frame.coordinates(np.zeros(3))[:2]
    return Support(sized(frame, foot - 1.4, foot + 1.4, 2.8 / 128), TALL, 0.02)


def solid_of(gaussians: Gaussians) -> Solid:
    return Solid(
        gaussians.means.double().numpy(), gaussians.scales.numpy()[:, 1], gaussians.opacities.numpy()
    )


def evidence_of(photos: Sequence[Photo], gaussians: Gaussians) -> MirrorEvidence | None:
    """What photographs tell of the mirror image of an object."""
    under = support()

    def reflect(placing):
        return [reflection(gaussians, each.camera, under.frame, Effects(), placing) for each in photos]

    found = find_mirror(photos, solid_of(gaussians), under, reflect, FEW)
    return None if found is None else found[1]
