"""Conversion of the poses in files: rounded rotations, and matrices of several shapes."""

from __future__ import annotations

import numpy as np

from diga3d_warp.errors import InputError

# A rotation may be off by this much after passing through text with few digits, and is exact below the other
# limit, unitless.
_ROTATION_TOLERANCE, _EXACT = 1e-2, 1e-12


def world_to_camera(rotation: np.ndarray, center: np.ndarray) -> np.ndarray:
    """World-to-camera transform of a camera, shape (4, 4), float64.

    Args:
        rotation: From camera to world, OpenCV axes, shape (3, 3). The nearest rotation is taken, so one that
            lost digits in text is one again; one that is exact stays as it is.
        center: Camera centre [scene units], shape (3,).

    Raises:
        InputError: a number is not finite, or `rotation` is none.
    """
    if not (np.isfinite(rotation).all() and np.isfinite(center).all()):
        raise InputError("the pose holds a number that is not finite; export it again")
    left, stretches, right = np.linalg.svd(rotation)
    nearest = rotation if np.abs(stretches - 1.0).max() < _EXACT else left @ right
    if not np.abs(stretches - 1.0).max() < _ROTATION_TOLERANCE:
        raise InputError("the pose is not a rotation with a translation; export it again")
    if np.linalg.det(nearest) < 0:
        raise InputError("the pose is a mirror image, not a rotation; export it again with right-handed axes")
    pose = np.eye(4)
    pose[:3, :3] = nearest.T
    pose[:3, 3] = -nearest.T @ center
    return pose


def affine(numbers: np.ndarray) -> np.ndarray:
    """The matrix (3, 4) of a 4 x 4 or 3 x 4 transform of column vectors, also if it is given row by row.

    Raises:
        InputError: it has another shape, or its last row is not 0 0 0 1.
    """
    if numbers.shape in ((16,), (12,)):
        numbers = numbers.reshape(-1, 4)
    if numbers.shape == (3, 4):
        return numbers
    if numbers.shape != (4, 4):
        raise InputError(f"it has shape {numbers.shape}, not (4, 4) or (3, 4)")
    last = np.array([0.0, 0.0, 0.0, 1.0])
    if not np.abs(numbers[3] - last).max() < 1e-6:
        transposed = np.abs(numbers[:, 3] - last).max() < 1e-6
        row = " ".join(f"{number:g}" for number in numbers[3])
        raise InputError(
            f"its last row is {row}, not 0 0 0 1"
            + (": it is transposed; write the translation into the last column" if transposed else "")
        )
    return numbers[:3]


def without_scale(matrix: np.ndarray) -> tuple[np.ndarray, float]:
    """A transform (3, 4) with its rotation freed of a common factor, and that factor.

    A camera that is scaled about its own centre takes the same picture, so the factor can be left out.
    """
    scale = float(np.cbrt(abs(np.linalg.det(matrix[:, :3])))) if np.isfinite(matrix).all() else 1.0
    if not scale > 0.0 or abs(scale - 1.0) < _ROTATION_TOLERANCE:
        return matrix, 1.0
    return np.concatenate([matrix[:, :3] / scale, matrix[:, 3:]], axis=1), scale
