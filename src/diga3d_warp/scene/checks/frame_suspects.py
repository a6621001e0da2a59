"""Common errors in the frame of a capture (suspects), and the transforms that correct them.

Poses are written in two kinds of axes (OpenCV: y down, z forward; OpenGL: y up, z backward) and in two
directions (world to camera, camera to world), and points may be rotated and scaled independently of them.
Files do not state their convention.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
"""From OpenCV axes of a camera to OpenGL's, and back."""

CONVENTIONS: Mapping[str, str] = {
    "nerfstudio": "transforms.json holds camera to world in OpenGL axes (y up, z backward)",
    "polycam": "Polycam's cameras hold camera to world in OpenGL axes (y up, z backward)",
    "llff": "poses_bounds.npy holds camera to world in LLFF's axes (down, right, backward)",
    "colmap": "COLMAP's images hold world to camera in OpenCV axes (y down, z forward), quaternions w x y z",
    "cameras": "cameras.json holds camera to world in OpenCV axes (y down, z forward)",
}
"""How poses are written, by `Recognised.kind`."""

UNITS = {1e3: "millimetres", 1e2: "centimetres", 1.0 / 0.3048: "feet"}
"""Units of length beside the metre, by how many make one."""


@dataclass(frozen=True)
class Suspect:
    """A common error in a frame.

    Attributes:
        fault: The error in words, which completes "they fit if ...".
        pose: Maps a world-to-camera transform (4, 4) as read to the corrected one, which may be no rotation.
        points: Maps positions (P, 3) as read to the corrected ones.
    """

    fault: str
    pose: Callable[[np.ndarray], np.ndarray] = lambda pose: pose
    points: Callable[[np.ndarray], np.ndarray] = lambda positions: positions


def _transposed(pose: np.ndarray) -> np.ndarray:
    """The rotation transposed, the last column kept."""
    return np.block([[pose[:3, :3].T, pose[:3, 3:]], [np.array([[0.0, 0.0, 0.0, 1.0]])]])


def _of_camera_to_world(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
    """The same change made to the inverse of a pose."""
    return lambda pose: np.linalg.inv(change(np.linalg.inv(pose)))


def _center_as_translation(pose: np.ndarray) -> np.ndarray:
    """A camera centre stands where the translation of world to camera belongs."""
    changed = pose.copy()
    changed[:3, 3] = -pose[:3, :3] @ pose[:3, 3]
    return changed


def _scalar_last(pose: np.ndarray) -> np.ndarray:
    """The rotation of a quaternion that was written (x, y, z, w) and read as (w, x, y, z)."""
    from scipy.spatial.transform import Rotation

    w, x, y, z = Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True)
    changed = pose.copy()
    changed[:3, :3] = Rotation.from_quat([w, x, y, z]).as_matrix()
    return changed


_FLIPPED = "the y and z axes of the cameras are flipped (OpenCV's for OpenGL's, or the reverse)"
_INVERSE = "the poses are inverted (world to camera for camera to world, or the reverse)"
_BOTH = "the poses are inverted and the y and z axes of the cameras flipped"
_TRANSPOSED = "the rotations are transposed"

POSES: Sequence[Suspect] = (
    Suspect(_FLIPPED, lambda pose: FLIP @ pose),
    Suspect(_INVERSE, np.linalg.inv),  # both in OpenCV axes
    Suspect(_INVERSE, lambda pose: FLIP @ np.linalg.inv(pose) @ FLIP),  # both in OpenGL axes
    Suspect(_BOTH, lambda pose: FLIP @ np.linalg.inv(pose)),
    Suspect(_BOTH, lambda pose: np.linalg.inv(pose) @ FLIP),
    Suspect(_TRANSPOSED, _transposed),  # of world to camera
    Suspect(_TRANSPOSED, _of_camera_to_world(_transposed)),
    Suspect(_TRANSPOSED, lambda pose: FLIP @ _of_camera_to_world(_transposed)(FLIP @ pose)),  # OpenGL axes
    Suspect("the translations are taken for camera centres", _center_as_translation),
    Suspect("the quaternions are taken as x, y, z, w", _scalar_last),
)
"""Common errors in poses."""


def _axis_rotations() -> Iterator[np.ndarray]:
    """The 23 rotations that map axes to axes, without the identity."""
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        matrix = np.diag(signs)[:, order]
        if np.linalg.det(matrix) > 0.0 and not np.array_equal(matrix, np.eye(3)):
            yield matrix


def _axes_in_words(matrix: np.ndarray) -> str:
    """The coordinates that a signed permutation gives, such as (x, z, -y)."""
    rows = [f"{'-' if row.sum() < 0 else ''}{'xyz'[int(np.abs(row).argmax())]}" for row in matrix]
    return f"({', '.join(rows)})"


def _exchanged(matrix: np.ndarray) -> Suspect:
    words = _axes_in_words(matrix)
    return Suspect(
        f"their coordinates are exchanged to {words}", points=lambda positions: positions @ matrix.T
    )


def _rescaled(factor: float, words: str) -> Suspect:
    return Suspect(f"they are scaled by {factor:g} ({words})", points=lambda places: factor * places)


def point_suspects() -> Iterator[Suspect]:
    """Common errors in points if the cameras are right."""
    for matrix in _axis_rotations():
        yield _exchanged(matrix)
    for per_metre, unit in UNITS.items():
        yield _rescaled(per_metre, f"as if the cameras were in {unit} and the points in metres")
        yield _rescaled(1.0 / per_metre, f"as if the points were in {unit} and the cameras in metres")
