"""Assets: the object that is put into a scene, as a mesh with colours or as gaussians.

World axes of an asset: z up. It stands on z = 0 above the origin, and its larger horizontal edge or its
height, whichever is more, has length 1.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.objects.mesh_file import MeshPart, read_mesh
from diga3d_warp.objects.surface import unit
from diga3d_warp.scene.formats.read import read_splat
from diga3d_warp.scene.formats.recognise import splat_format

UPRIGHT_Y = (".glb", ".gltf", ".obj", ".dae")
"""Formats whose files have y up: glTF by its standard, OBJ and Collada by custom. Others have z up."""

Painter = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""Face (P,), weights of its corners (P, 3), position and normal in the asset's axes (P, 3) to display RGB."""


@dataclass(frozen=True, eq=False)
class MeshAsset:
    """A mesh with its colours.

    Attributes:
        vertices: Corners, shape (V, 3), float64.
        faces: Corner indices, shape (F, 3), int32, counter-clockwise from outside.
        normals: Outer unit normals at the corners of each face, shape (F, 3, 3).
        painter: Its colours without light.
        notes: Assumptions and omissions of the reader, one line each.
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    painter: Painter
    notes: tuple[str, ...] = ()

    @property
    def extent(self) -> np.ndarray:
        """Size along x, y and z, shape (3,)."""
        return np.ptp(self.vertices, axis=0)


@dataclass(frozen=True, eq=False)
class SplatAsset:
    """Gaussians that are an object.

    Attributes:
        gaussians: In the asset's axes.
        hull: Corners and faces of the convex hull of their middles, (V, 3) and (F, 3): casts the shadow.
        notes: Assumptions and omissions of the reader, one line each.
    """

    gaussians: Gaussians
    hull: tuple[np.ndarray, np.ndarray]
    notes: tuple[str, ...] = ()

    @property
    def extent(self) -> np.ndarray:
        """Size along x, y and z, shape (3,)."""
        return np.ptp(self.hull[0], axis=0)


Asset = MeshAsset | SplatAsset


def read_asset(path: Path) -> Asset:
    """Read a mesh with trimesh (.glb, .obj, .ply, .stl, ...), or a splat file.

    Raises:
        InputError: the file is missing, not readable, or holds no surface.
    """
    if not path.is_file():
        raise InputError(
            f"{path}: no such asset; give a mesh (.glb, .obj, .ply, .stl) or a splat (.ply, .spz, .sog)"
        )
    if splat_format(path) is not None:
        content = read_splat(path)
        return splat_asset(Gaussians.from_rows(content.rows), content.notes)
    file = read_mesh(path)
    if not file.parts:
        reason = f" ({file.notes[-1].partition(': ')[2]})" if file.notes else ""
        raise InputError(f"{path}: holds no faces{reason}; give a mesh, or a 3DGS .ply of gaussians")
    return mesh_asset(
        file.parts, upright_y=path.suffix.lower() in UPRIGHT_Y, name=str(path), notes=tuple(file.notes)
    )


def mesh_asset(
    parts: Sequence[MeshPart], *, upright_y: bool, name: str, painter: Painter | None = None,
    notes: tuple[str, ...] = (),
) -> MeshAsset:  # fmt: skip
    """An asset of one or more meshes.

    Args:
        parts: At least one, with at least one face each.
        upright_y: Whether y is up in them, rather than z.
        name: For error lines.
        painter: Colours; those of the parts if None.
        notes: As in `MeshAsset`.

    Raises:
        InputError: the meshes have no size, or one beyond what float32 holds.
    """
    corners = np.concatenate([part.corners for part in parts])
    normals = np.concatenate([part.normals for part in parts])
    if upright_y:
        corners, normals = _y_to_z(corners), _y_to_z(normals)
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    size = float((high - low).max())
    if not 0.0 < size < np.inf:
        raise InputError(f"{name}: has no size; export it again")
    middle = np.array([*(0.5 * (low + high))[:2], low[2]])
    vertices, faces = np.unique(((corners - middle) / size).reshape(-1, 3), axis=0, return_inverse=True)
    faces = faces.reshape(-1, 3).astype(np.int32)
    return MeshAsset(vertices, faces, unit(normals), painter or _colors_of(parts), notes)


def _y_to_z(vectors: np.ndarray) -> np.ndarray:
    return np.stack([vectors[..., 0], -vectors[..., 2], vectors[..., 1]], axis=-1)


def _colors_of(parts: Sequence[MeshPart]) -> Painter:
    """The colours that each part brings along."""
    starts = np.cumsum([0, *(len(part.corners) for part in parts)])

    def painted(face: np.ndarray, weights: np.ndarray, _: np.ndarray, __: np.ndarray) -> np.ndarray:
        colors = np.empty((len(face), 3))
        for part, start, end in zip(parts, starts, starts[1:], strict=False):
            rows = (face >= start) & (face < end)
            if rows.any():
                colors[rows] = part.colors(face[rows] - start, weights[rows])
        return colors

    return painted


def splat_asset(gaussians: Gaussians, notes: Sequence[str] = ()) -> SplatAsset:
    """An asset of gaussians; z is up in them. The notes are kept.

    Raises:
        InputError: fewer than four gaussians are opaque enough to be a body.
    """
    from scipy.spatial import ConvexHull, QhullError

    body = gaussians.means[gaussians.opacities > 0.3].double().numpy()
    if len(body) < 4:
        raise InputError("the splat asset has fewer than 4 opaque gaussians: give the splat of an object")
    low, high = np.percentile(body, [1, 99], axis=0)
    inside = body[((body >= low) & (body <= high)).all(axis=1)]
    size = float((high - low).max())
    middle = np.array([*(0.5 * (low + high))[:2], low[2]])
    placed = gaussians.detached()
    placed.means = ((placed.means.double() - torch.from_numpy(middle)) / size).float()
    placed.log_scales -= float(np.log(size))
    points = (inside - middle) / size
    try:
        hull = ConvexHull(points)
    except QhullError as error:
        raise InputError("the splat asset is flat: give the splat of an object") from error
    corner = np.full(len(points), -1)
    corner[hull.vertices] = np.arange(len(hull.vertices))
    surface = points[hull.vertices], corner[hull.simplices].astype(np.int32)
    return SplatAsset(placed, surface, tuple(notes))
