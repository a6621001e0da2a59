"""Assets: the object that is put into a scene, as a mesh with colours or as gaussians.

World axes of an asset: z up. It stands on z = 0 above the origin, and its larger horizontal edge or its
height, whichever is more, has length 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.gaussians.ply import read_ply
from diga3d_warp.objects.surface import unit
from diga3d_warp.objects.wrapping import sampled
from diga3d_warp.scene.splat import is_splat

if TYPE_CHECKING:
    from trimesh import Trimesh

UPRIGHT_Y = (".glb", ".gltf", ".obj", ".dae")
"""Formats whose files have y up: glTF by its standard, OBJ and Collada by custom. Others have z up."""

GREY = 0.7
"""Display value of a mesh without any colour."""

FACES_MOST = 400_000
"""Most faces of a mesh that is used as it is; larger ones only cost memory at the size of an object."""

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
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    painter: Painter

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
    """

    gaussians: Gaussians
    hull: tuple[np.ndarray, np.ndarray]

    @property
    def extent(self) -> np.ndarray:
        """Size along x, y and z, shape (3,)."""
        return np.ptp(self.hull[0], axis=0)


Asset = MeshAsset | SplatAsset


def read_asset(path: Path) -> Asset:
    """Read a mesh with trimesh (.glb, .obj, .ply, .stl, ...), or a 3DGS .ply.

    Raises:
        InputError: the file is missing, not readable, or holds no surface.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such asset; give a mesh (.glb, .obj, .ply, .stl) or a splat .ply")
    if path.suffix.lower() == ".ply" and is_splat(path):
        return splat_asset(read_ply(path).gaussians)
    return mesh_asset(_loaded(path), upright_y=path.suffix.lower() in UPRIGHT_Y, name=str(path))


def _loaded(path: Path) -> Trimesh:
    import trimesh

    try:
        loaded = trimesh.load_mesh(path)
    except Exception as error:  # its readers raise whatever a damaged file leads them to
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise InputError(f"{path}: not readable as a mesh ({reason}); export it as .glb or .ply") from error
    return loaded.to_mesh() if hasattr(loaded, "to_mesh") else loaded


def mesh_asset(mesh: Trimesh, *, upright_y: bool, name: str, painter: Painter | None = None) -> MeshAsset:
    """An asset of a trimesh mesh.

    Args:
        mesh: With texture, vertex colours, face colours or none.
        upright_y: Whether y is up in it, rather than z.
        name: For error lines.
        painter: Colours; those of the mesh if None.

    Raises:
        InputError: the mesh has no face, or corners that are not finite.
    """
    vertices = np.asarray(getattr(mesh, "vertices", np.zeros((0, 3))), np.float64)
    faces = np.asarray(getattr(mesh, "faces", np.zeros((0, 3))), np.int32)
    if len(faces) == 0 or len(vertices) == 0:
        raise InputError(f"{name}: holds no faces; give a mesh, or a 3DGS .ply of gaussians")
    if len(faces) > FACES_MOST:
        raise InputError(f"{name}: has {len(faces)} faces; simplify it to at most {FACES_MOST}")
    if not np.isfinite(vertices).all() or not np.ptp(vertices[faces.reshape(-1)], axis=0).any():
        raise InputError(f"{name}: has corners that are not finite, or no size; export it again")
    normals = np.asarray(mesh.vertex_normals, np.float64)[faces]
    flat = np.asarray(mesh.face_normals, np.float64)
    # Corners of sharp edges have the mean of their faces' normals, which would round the edges off.
    sharp = (normals * flat[:, None]).sum(axis=2) < SMOOTH
    normals = np.where(sharp[..., None], flat[:, None], normals)
    if upright_y:
        vertices, normals = _y_to_z(vertices), _y_to_z(normals)
    used = vertices[np.unique(faces)]
    low, high = used.min(axis=0), used.max(axis=0)
    middle = np.array([*(0.5 * (low + high))[:2], low[2]])
    return MeshAsset(
        (vertices - middle) / (high - low).max(), faces, unit(normals), painter or _own_colors(mesh)
    )


SMOOTH = 0.82
"""Least cosine between a face and the mean of its corner's faces for the corner to be smooth: 35 degrees."""


def _y_to_z(vectors: np.ndarray) -> np.ndarray:
    return np.stack([vectors[..., 0], -vectors[..., 2], vectors[..., 1]], axis=-1)


def _own_colors(mesh: Trimesh) -> Painter:
    """The colours that a mesh brings along."""
    visual: Any = mesh.visual
    faces = np.asarray(mesh.faces)
    image = _texture_of(visual)
    uv = getattr(visual, "uv", None)
    if image is not None and uv is not None and len(uv) == len(mesh.vertices):
        corners = np.asarray(uv, np.float64)[faces]

        def textured(face: np.ndarray, weights: np.ndarray, _: np.ndarray, __: np.ndarray) -> np.ndarray:
            place = (corners[face] * weights[..., None]).sum(axis=1)
            return sampled(image, place[:, 0], 1.0 - place[:, 1])

        return textured
    colors = _corner_colors(visual, faces)

    def interpolated(face: np.ndarray, weights: np.ndarray, _: np.ndarray, __: np.ndarray) -> np.ndarray:
        return (colors[face] * weights[..., None]).sum(axis=1)

    return interpolated


def _texture_of(visual: Any) -> np.ndarray | None:
    """The base colour texture as display RGB in [0, 1], shape (H, W, 3); None without one."""
    material = getattr(visual, "material", None)
    picture = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    return None if picture is None else np.asarray(picture.convert("RGB"), np.float64) / 255.0


def _corner_colors(visual: Any, faces: np.ndarray) -> np.ndarray:
    """Display RGB at the corners of each face, shape (F, 3, 3)."""
    kind = getattr(visual, "kind", None)
    if kind == "vertex":
        return np.asarray(visual.vertex_colors, np.float64)[:, :3][faces] / 255.0
    if kind == "face":
        return np.asarray(visual.face_colors, np.float64)[:, None, :3].repeat(3, axis=1) / 255.0
    main = getattr(getattr(visual, "material", None), "main_color", None)
    plain = np.full(3, GREY) if main is None else np.asarray(main, np.float64)[:3] / 255.0
    return np.broadcast_to(plain, (*faces.shape, 3))


def splat_asset(gaussians: Gaussians) -> SplatAsset:
    """An asset of gaussians; z is up in them.

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
    return SplatAsset(placed, (points[hull.vertices], corner[hull.simplices].astype(np.int32)))
