"""Camera: intrinsics, lens distortion and pose of one image, in OpenCV / COLMAP axes."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import torch

from diga3d_warp.config import SPLATTING
from diga3d_warp.errors import InputError

LensKind = Literal["brown", "brown5", "fisheye"]

COEFFICIENTS = {"brown": 4, "brown5": 5, "fisheye": 4}
"""Number of coefficients of each kind of lens."""

PIXELS_MAX = 1e6
"""Largest focal length and principal point [px]. No image is larger; the product with the far end of a lens
polynomial, (1e6)^5 times `COEFFICIENT_MAX`, still is a float32."""

PIXELS_MIN = 1e-6
"""Smallest focal length [px]: its reciprocal bounds the slope of a ray."""

COEFFICIENT_MAX = 100.0
"""Largest coefficient of a lens [1]. Real ones stay below 10."""


@dataclass(frozen=True)
class Distortion:
    """Lens distortion of normalised camera coordinates, as COLMAP defines it.

    Attributes:
        kind: "brown" (radial and tangential, COLMAP's SIMPLE_RADIAL, RADIAL and OPENCV) or
            "brown5" (the same with a third radial coefficient, OpenCV's five-parameter model and Metashape's
            K1 to K3) or "fisheye" (equidistant, COLMAP's OPENCV_FISHEYE and its shorter forms).
        coefficients: (k1, k2, p1, p2) for "brown", (k1, k2, p1, p2, k3) for "brown5" and (k1, k2, k3, k4) for
            "fisheye". Unitless.
    """

    kind: LensKind
    coefficients: tuple[float, ...]

    def __post_init__(self) -> None:
        if self.kind not in COEFFICIENTS:
            raise InputError(f"lens kind {self.kind!r} is unknown: use one of {', '.join(COEFFICIENTS)}")
        count = COEFFICIENTS[self.kind]
        if len(self.coefficients) != count or not (np.abs(self.coefficients) <= COEFFICIENT_MAX).all():
            raise InputError(
                f"coefficients {self.coefficients} of a {self.kind} lens must be {count} numbers up to "
                f"{COEFFICIENT_MAX:g}"
            )

    @classmethod
    def brown(cls, k1: float, k2: float, p1: float, p2: float, k3: float = 0.0) -> Distortion | None:
        """The shortest Brown lens with these coefficients; None if all are zero."""
        if k3:
            return cls("brown5", (k1, k2, p1, p2, k3))
        return cls("brown", (k1, k2, p1, p2)) if any((k1, k2, p1, p2)) else None


@dataclass(frozen=True, eq=False)
class Camera:
    """One calibrated camera with its pose.

    Axes follow OpenCV and COLMAP: x right, y down, z forward. Pixel centres lie at +0.5, so the
    centre of the top-left pixel is (0.5, 0.5).

    Attributes:
        width, height: Image size [px].
        fx, fy: Focal lengths [px].
        cx, cy: Principal point [px], from the outer corner of the top-left pixel.
        world_to_camera: Rigid transform from world to camera space, shape (4, 4), float64. A tensor that
            requires gradient receives one from `render`; anything array-like is accepted.
        distortion: Lens distortion, or None for a pinhole camera.
        near: Nearest depth that is drawn [scene units]. `load_scene` sets it to `config.Splatting.near` times
            the extent of the scene; the default suits scenes of a few units.
        intrinsics: (fx, fy, cx, cy) [px], shape (4,), float64; see `with_intrinsics`.

    Raises:
        InputError: the size or a focal length is not positive, a number is not finite, or it is so large that
            its products would not be.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    world_to_camera: torch.Tensor
    distortion: Distortion | None = None
    near: float = SPLATTING.near
    intrinsics: torch.Tensor = field(init=False, repr=False)

    def __post_init__(self) -> None:
        pose = torch.as_tensor(self.world_to_camera).to(torch.float64)
        if pose.shape != (4, 4):
            raise InputError(f"world_to_camera must have shape (4, 4), not {tuple(pose.shape)}")
        numbers = (self.fx, self.fy, self.cx, self.cy)
        if not (np.isfinite(numbers).all() and bool(torch.isfinite(pose).all())):
            raise InputError("a camera holds a number that is not finite")
        if not 0.0 < self.near < SPLATTING.coordinate_max:
            raise InputError(f"a near plane at {self.near:g} units must lie in front of the camera")
        if not (self.width > 0 and self.height > 0 and self.fx > 0 and self.fy > 0):
            raise InputError(
                f"a camera of {self.width} x {self.height} px with focal lengths "
                f"({self.fx:g}, {self.fy:g}) px sees nothing: all four must be positive"
            )
        if max(self.width, self.height) > PIXELS_MAX:
            raise InputError(
                f"no image has {self.width} x {self.height} px: give the size of the photographs"
            )
        if min(self.fx, self.fy) < PIXELS_MIN or max(map(abs, numbers)) > PIXELS_MAX:
            raise InputError(
                f"intrinsics {numbers} must lie within {PIXELS_MAX:g} px, "
                f"focal lengths above {PIXELS_MIN:g} px"
            )
        if not bool((pose.abs() < SPLATTING.coordinate_max).all()):
            raise InputError(
                f"a camera {float(pose.abs().max()):g} units away lies beyond {SPLATTING.coordinate_max:g}: "
                "scale the scene down"
            )
        object.__setattr__(self, "world_to_camera", pose)
        object.__setattr__(self, "intrinsics", torch.tensor(numbers, dtype=torch.float64))

    @property
    def pose(self) -> np.ndarray:
        """World-to-camera transform as a NumPy array, shape (4, 4), float64, without gradient."""
        return self.world_to_camera.detach().cpu().numpy()

    @property
    def center(self) -> np.ndarray:
        """Camera centre in world space [scene units], shape (3,), float64."""
        pose = self.pose
        return -pose[:3, :3].T @ pose[:3, 3]

    @property
    def forward(self) -> np.ndarray:
        """Viewing direction in world space, unit length, shape (3,), float64."""
        return self.pose[2, :3].copy()

    def resized(self, width: int, height: int) -> Camera:
        """The same camera for an image of another size; each axis scales by its own ratio."""
        sx, sy = width / self.width, height / self.height
        scales = self.intrinsics.new_tensor([sx, sy, sx, sy])
        return replace(self, width=width, height=height).with_intrinsics(scales * self.intrinsics)

    def within(self, side: int) -> Camera:
        """The same camera for images whose longer side is `side` at most [px]."""
        scale = min(1.0, side / max(self.width, self.height))
        return self.resized(max(1, round(self.width * scale)), max(1, round(self.height * scale)))

    def without_lens(self) -> Camera:
        """The pinhole camera with the same intrinsics."""
        return replace(self, distortion=None).with_intrinsics(self.intrinsics)

    def with_pose(self, world_to_camera: torch.Tensor | np.ndarray) -> Camera:
        """The same camera at another pose."""
        moved = replace(self, world_to_camera=torch.as_tensor(world_to_camera))
        return moved.with_intrinsics(self.intrinsics)

    def with_near(self, near: float) -> Camera:
        """The same camera with another near plane [scene units]."""
        return replace(self, near=near).with_intrinsics(self.intrinsics)

    def relative_to(self, origin: np.ndarray) -> Camera:
        """The same camera in a world whose origin lies at `origin`, shape (3,)."""
        rotation = self.world_to_camera[:3, :3]
        pose = self.world_to_camera.clone()
        pose[:3, 3] = pose[:3, 3] + rotation @ torch.as_tensor(origin).to(rotation)
        return self.with_pose(pose)

    def with_intrinsics(self, intrinsics: torch.Tensor | np.ndarray) -> Camera:
        """The same camera with other focal lengths and principal point.

        Args:
            intrinsics: (fx, fy, cx, cy) [px], shape (4,). A tensor that requires gradient receives one from
                `render`.

        Raises:
            InputError: there are not four, one is not finite, or a focal length is not positive.
        """
        values = torch.as_tensor(intrinsics).to(torch.float64)
        if values.shape != (4,):
            raise InputError(f"intrinsics must be fx, fy, cx, cy, not of shape {tuple(values.shape)}")
        fx, fy, cx, cy = values.tolist()
        camera = replace(self, fx=fx, fy=fy, cx=cx, cy=cy)
        object.__setattr__(camera, "intrinsics", values)
        return camera


def look_at(
    eye: np.ndarray, target: np.ndarray, up: tuple[float, float, float] = (0.0, 0.0, 1.0)
) -> np.ndarray:
    """World-to-camera transform of a camera at `eye` looking at `target`, shape (4, 4), float64.

    Args:
        eye, target: Points in world space, shape (3,).
        up: Direction in world space that appears upwards in the image.
    """
    eye, target = np.asarray(eye, np.float64), np.asarray(target, np.float64)
    forward = target - eye
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, np.asarray(up, np.float64))
    right = right / np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = -rotation @ eye
    return pose
