"""The support plane of an object, and the place of another object on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diga3d_warp.gaussians.representation import Representation
from diga3d_warp.objects.frame import Frame, frame_of, upward
from diga3d_warp.objects.surface import Surface, unit
from diga3d_warp.scene.camera import Camera
from diga3d_warp.surfaces.planes import Plane


@dataclass(frozen=True)
class SupportSettings:
    """Thresholds of the plane fit under an object (RANSAC, Fischler and Bolles 1981).

    Attributes:
        opacity: Least opacity of gaussians that are surface.
        reach: Distance from the object's axis within which the plane is searched [object sizes].
        depth, rise: Search range below and above its base [object sizes]. A plane that is told may lie as far
            above it as below: an object's mirror image, taken for its foot, puts the base too low.
        tolerance: Distance from a plane that counts as on it [object sizes].
        tilt: Least cosine between plane and vertical: 20 degrees.
        trials: Number of random planes. With half of the points on the floor, it is missed with probability
            1e-9.
        few: Least gaussians of a plane: fewer lie on one by chance.
        least: Least area of the gaussians of a plane [square object sizes], a tenth of a disc as wide as the
            object; with less there is no visible support. Areas, not numbers: a smooth floor has few
            gaussians, a textured cloth on it many, and both have more in larger photographs.
        widest: Largest deviation of a gaussian that counts [object sizes]; wider ones lie beside the object.
        seed: Seed of the trials.
    """

    opacity: float = 0.3
    reach: float = 1.2
    depth: float = 0.35
    rise: float = 0.15
    tolerance: float = 0.02
    tilt: float = 0.94
    trials: int = 300
    few: int = 8
    least: float = 0.08
    widest: float = 0.3
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Place:
    """Placement of an object.

    Attributes:
        frame: On the support surface, z at right angles to it; its extent is the room that there is.
        supported: Whether a support plane was found; if not, the frame is at the old object's base.
        told: Number of the given plane that supports it; None if gaussians tell.
    """

    frame: Frame
    supported: bool
    told: int | None = None

    def scale(self, extent: np.ndarray) -> float:
        """Scale of an asset of this extent (3,) that fills the old object's extent without exceeding it."""
        across, height = self.frame.extent[:2].max(), self.frame.extent[2]
        return float(min(across / max(extent[:2].max(), 1e-9), height / max(extent[2], 1e-9)))


def find_place(
    surface: Surface, cameras: Sequence[Camera], left: Representation,
    settings: SupportSettings | None = None, told: Sequence[Plane] = (),
) -> Place:  # fmt: skip
    """The place of an object that was taken out.

    Args:
        surface: Of the object that stood there.
        cameras: All that saw it.
        left: The scene without it.
        settings: Thresholds of the plane fit.
        told: Planes that are known better than by gaussians; one near the base is the support.
    """
    settings = settings or SupportSettings()
    centers = np.stack([camera.center for camera in cameras])
    up, middle = upward(cameras), surface.points.mean(axis=0)
    old = frame_of(surface.points, up, (centers - middle).mean(axis=0))
    old = _whole(old, centers)
    size = float(old.extent.max())
    solid = left.select(left.opacities > settings.opacity)
    local = old.inward(solid.means.double().numpy())
    axes = np.minimum(np.sort(solid.scales.double().numpy(), axis=1)[:, 1:] / size, settings.widest)
    near = np.hypot(local[:, 0], local[:, 1]) < settings.reach * size
    near &= (local[:, 2] > -settings.depth * size) & (local[:, 2] < settings.rise * size)
    number, plane = _told(told, old, size, settings)
    if plane is None:
        plane = _plane(local[near] / size, np.pi * axes[near].prod(axis=1), settings)
    if plane is None:
        return Place(old, supported=False)
    normal, offset = plane
    upright = unit(normal @ old.axes)
    back = unit(old.axes[1] - upright * (old.axes[1] @ upright))
    base = (offset / normal[2]) * size  # height of the plane under the middle of the object
    height = max(old.extent[2] - base, 0.25 * size)
    turned = np.stack([np.cross(back, upright), back, upright])
    origin = old.origin + base * old.axes[2]
    return Place(Frame(origin, turned, np.array([*old.extent[:2], height])), True, number)


def _told(
    planes: Sequence[Plane], old: Frame, size: float, settings: SupportSettings
) -> tuple[int | None, tuple[np.ndarray, float] | None]:
    """The first nearly level plane near the frame's base: its number, and normal (3,) and offset [object
    sizes] in the frame."""
    for number, plane in enumerate(planes):
        normal = old.axes @ plane.normal
        offset = (plane.offset - float(plane.normal @ old.origin)) / size
        sign = np.sign(normal[2] + 1e-12)
        normal, offset = sign * normal, sign * offset
        level = normal[2] > settings.tilt
        if level and abs(offset / normal[2]) < settings.depth:
            return number, (normal, float(offset))
    return None, None


def _whole(frame: Frame, centers: np.ndarray) -> Frame:
    """The frame of a whole object of which cameras on one side saw only the front.

    The object is assumed to be as deep as it is wide.
    """
    towards = unit(frame.inward(centers) * [1, 1, 0])
    one_sided = float(np.linalg.norm(towards.mean(axis=0)))
    width, depth = frame.extent[:2]
    if one_sided < 0.5 or depth >= width:
        return frame
    shift = 0.5 * (width - depth) * frame.axes[1]
    return Frame(frame.origin + shift, frame.axes, np.array([width, width, frame.extent[2]]))


def _plane(
    points: np.ndarray, areas: np.ndarray, settings: SupportSettings
) -> tuple[np.ndarray, float] | None:
    """Normal (3,) and offset of the nearly level plane with most of the area; None if none has enough.

    Args:
        points: Means of gaussians [object sizes], shape (P, 3).
        areas: What each covers [square object sizes], shape (P,).
        settings: Tolerances and trials.
    """
    if len(points) < settings.few or not areas.sum() > 0.0:
        return None
    rng = np.random.default_rng(settings.seed)
    shares = areas / areas.sum()
    corners = points[rng.choice(len(points), (settings.trials, 3), p=shares)]
    normals = unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    normals *= np.sign(normals[:, 2:] + 1e-12)
    level = normals[:, 2] > settings.tilt
    if not level.any():
        return None
    normals, offsets = normals[level], (normals[level] * corners[level, 0]).sum(axis=1)
    votes = areas @ (np.abs(points @ normals.T - offsets) < settings.tolerance)
    best = int(votes.argmax())
    normal, offset = normals[best], float(offsets[best])
    for _ in range(3):
        on = np.abs(points @ normal - offset) < settings.tolerance
        if on.sum() < settings.few or areas[on].sum() < settings.least:
            return None
        middle = np.average(points[on], axis=0, weights=areas[on])
        normal = np.linalg.eigh(np.cov(points[on].T, aweights=areas[on]))[1][:, 0]
        normal = normal * np.sign(normal[2] + 1e-12)
        offset = float(middle @ normal)
    return (normal, offset) if normal[2] > settings.tilt else None
