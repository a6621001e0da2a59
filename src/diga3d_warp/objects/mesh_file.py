"""Meshes read from files with trimesh: their triangles in one place, their colours, and what is left out."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from diga3d_warp.errors import InputError
from diga3d_warp.objects.files_beside import FilesBeside
from diga3d_warp.objects.gltf import plain_gltf
from diga3d_warp.objects.mesh_colors import FaceColors, mesh_colors

if TYPE_CHECKING:
    from trimesh import Scene, Trimesh

GLTF = (".glb", ".gltf")

FACES_MOST = 400_000
"""Most faces of a mesh that is used as it is; larger ones only cost memory at the size of an object."""

SMOOTH = 0.82
"""Least cosine between a face and the normal at its corner for the corner to be smooth: 35 degrees."""


@dataclass(frozen=True, eq=False)
class MeshPart:
    """Triangles of one material, in the file's axes.

    Attributes:
        corners: Of each face, counter-clockwise from outside, shape (F, 3, 3), float64, finite.
        normals: Outer unit normals at the corners, shape (F, 3, 3).
        colors: What they show.
    """

    corners: np.ndarray
    normals: np.ndarray
    colors: FaceColors


@dataclass(frozen=True, eq=False)
class MeshFile:
    """Contents of a mesh file.

    Attributes:
        parts: Its meshes, each as often as it is placed; may be empty.
        notes: Omissions and assumptions of the reader, one line each.
    """

    parts: list[MeshPart]
    notes: list[str]


def read_mesh(path: Path) -> MeshFile:
    """Read a mesh file: .glb, .gltf, .obj, .ply, .stl, .off, .3mf, ...

    Raises:
        InputError: it is not readable as a mesh, is compressed in a way that is not read, or a texture is
            damaged or too large.
    """
    notes: list[str] = []
    try:
        scene = _loaded(path, notes)
        return MeshFile(list(_parts(path, scene, notes)), notes)
    except InputError:
        raise
    except ImportError as error:
        raise InputError(
            f"{path}: {path.suffix} files need {error.name or error}, which is not installed; "
            "export it as .glb"
        ) from error
    except RecursionError as error:
        raise InputError(f"{path}: not readable as a mesh (nested too deep); export it again") from error
    except Exception as error:  # trimesh's readers raise whatever a damaged file leads them to
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise InputError(f"{path}: not readable as a mesh ({reason}); export it as .glb or .ply") from error


def mesh_part(mesh: Trimesh) -> MeshPart:
    """A mesh made by trimesh, where it is."""
    return _placed(mesh, np.eye(4), mesh_colors(mesh, linear=False).at)[0]


def _loaded(path: Path, notes: list[str]) -> Scene:
    import trimesh

    kind = path.suffix.lower()
    if kind in GLTF:
        data, found = plain_gltf(path)
        notes += found
        return trimesh.load_scene(io.BytesIO(data), file_type="glb", process=False)
    beside = FilesBeside(path, notes)
    options: dict[str, Any] = {"skip_materials": True} if beside.only_corners_are_colored else {}
    scene = trimesh.load_scene(path, resolver=beside.resolver(), process=False, **options)
    beside.check()
    return scene


def _parts(path: Path, scene: Scene, notes: list[str]) -> Iterator[MeshPart]:
    """The meshes of a scene where they are placed."""
    import trimesh

    placed = [(scene.graph[node][0], scene.geometry[scene.graph[node][1]]) for node in _nodes(scene)]
    meshes = [(matrix, mesh) for matrix, mesh in placed if isinstance(mesh, trimesh.Trimesh)]
    total = sum(len(mesh.faces) for _, mesh in meshes)
    if total > FACES_MOST:
        raise InputError(f"{path}: has {total} faces; simplify it to at most {FACES_MOST}")
    dropped, found = 0, []
    for matrix, mesh in meshes:
        if len(mesh.faces) == 0:
            continue
        if int(mesh.faces.min()) < 0 or int(mesh.faces.max()) >= len(mesh.vertices):
            raise InputError(f"{path}: its faces name corners that it does not have; export it again")
        found.append(mesh_colors(mesh, linear=path.suffix.lower() in GLTF))
        part, broken = _placed(mesh, np.asarray(matrix, np.float64), found[-1].at)
        dropped += broken
        if len(part.corners):
            yield part
    if len(meshes) < len(placed):
        notes.append(f"{path.name}: its points and lines are left out; only triangles are drawn")
    if dropped:
        notes.append(f"{path.name}: {dropped} of {total} faces have corners that are not finite; left out")
    if found and not all(colors.colored for colors in found):
        whole = "it has" if not any(colors.colored for colors in found) else "some of its parts have"
        notes.append(f"{path.name}: {whole} no colours; shown in grey")
    if any(colors.transparent for colors in found):
        notes.append(f"{path.name}: parts of it are transparent, which is not simulated; shown opaque")


def _nodes(scene: Scene) -> list[str]:
    """The nodes that hold a mesh, in the file's order."""
    order = {name: index for index, name in enumerate(scene.geometry)}
    return sorted(scene.graph.nodes_geometry, key=lambda node: (order[scene.graph[node][1]], str(node)))


def _placed(mesh: Trimesh, matrix: np.ndarray, colors: FaceColors) -> tuple[MeshPart, int]:
    """A mesh where its node puts it, and how many of its faces have corners that are not finite."""
    vertices = np.asarray(mesh.vertices, np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
    faces = np.asarray(mesh.faces)
    finite = np.isfinite(vertices).all(axis=1)[faces].all(axis=1)
    rows = np.flatnonzero(finite)
    rows = rows[np.linalg.norm(_doubled(vertices[faces[rows]]), axis=1) > 0.0]
    given = _given_normals(mesh, matrix)
    corners, normals = vertices[faces[rows]], None if given is None else given[faces[rows]]
    order = np.array([0, 1, 2])
    if _inside_out(corners, normals) if normals is not None or closed(corners) else _mirrors(matrix):
        order = np.array([0, 2, 1])
        corners, normals = corners[:, order], None if normals is None else normals[:, order]

    def at(face: np.ndarray, weights: np.ndarray) -> np.ndarray:
        return colors(rows[face], weights[:, order])

    return MeshPart(corners, _smooth(corners, normals), at), int((~finite).sum())


def _given_normals(mesh: Trimesh, matrix: np.ndarray) -> np.ndarray | None:
    """Normals that the file gives its corners, as the node turns them, shape (V, 3); None without any."""
    given = mesh._cache["vertex_normals"]
    if given is None or np.shape(given) != np.shape(mesh.vertices):
        return None
    return np.asarray(given, np.float64) @ np.linalg.pinv(matrix[:3, :3])


def _doubled(corners: np.ndarray) -> np.ndarray:
    """Normals of faces (F, 3, 3) with twice their area as length, shape (F, 3)."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _mirrors(matrix: np.ndarray) -> bool:
    return bool(np.linalg.det(matrix[:3, :3]) < 0.0)


def _inside_out(corners: np.ndarray, normals: np.ndarray | None) -> bool:
    """Whether faces wind the other way than their normals say or, without any, than a body's do."""
    doubled = _doubled(corners)
    if normals is not None:
        return bool(np.nan_to_num((normals * doubled[:, None]).sum(axis=2)).sum() < 0.0)
    middle = corners.mean(axis=(0, 1))
    return bool(((corners[:, 0] - middle) * doubled).sum() < 0.0)


def closed(corners: np.ndarray) -> bool:
    """Whether each edge of faces (F, 3, 3) has another face on its other side, wound alike."""
    index = _merged(corners).reshape(-1, 3)
    edges = np.stack([index, np.roll(index, -1, axis=1)], axis=-1).reshape(-1, 2).astype(np.int64)
    there, back = edges @ [len(edges), 1], edges @ [1, len(edges)]
    return len(edges) > 0 and np.array_equal(np.sort(there), np.sort(back))


def _merged(corners: np.ndarray) -> np.ndarray:
    """One number for all corners at one place, shape (3 F,)."""
    return np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)[1].reshape(-1)


def _smooth(corners: np.ndarray, normals: np.ndarray | None) -> np.ndarray:
    """Unit normals at the corners of faces, shape (F, 3, 3): those given, or means over each corner."""
    flat = _doubled(corners)
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    if normals is None:
        normals = corner_means(corners, flat)
    length = np.linalg.norm(normals, axis=2, keepdims=True)
    usable = np.isfinite(length) & (length > 1e-12)
    unit = np.where(usable, normals / np.where(usable, length, 1.0), flat[:, None])
    # Corners of sharp edges have the mean of their faces' normals, which would round the edges off.
    sharp = (unit * flat[:, None]).sum(axis=2) < SMOOTH
    return np.where(sharp[..., None], flat[:, None], unit)


def corner_means(corners: np.ndarray, flat: np.ndarray) -> np.ndarray:
    """Means of the normals of all faces that meet at each corner, weighted by their angles there.

    Args:
        corners: Of each face, shape (F, 3, 3). Corners at one place are one corner.
        flat: Unit normals of the faces, shape (F, 3).

    Returns:
        Shape (F, 3, 3), not of unit length.
    """
    index = _merged(corners)
    after, before = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    lengths = np.linalg.norm(after, axis=2) * np.linalg.norm(before, axis=2)
    angles = np.arccos(np.clip((after * before).sum(axis=2) / np.maximum(lengths, 1e-300), -1.0, 1.0))
    weighted = (angles[..., None] * flat[:, None]).reshape(-1, 3)
    sums = np.stack([np.bincount(index, weighted[:, k]) for k in range(3)], axis=-1)
    return sums[index].reshape(corners.shape)
