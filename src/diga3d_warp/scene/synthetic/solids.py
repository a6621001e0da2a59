"""Solids of the synthetic room: grids of triangles with normals, texture positions and materials.

World axes: x right, y away from the viewer, z up; metres. Faces are counter-clockwise seen from outside.
Surfaces are cut into small cells because light is computed at their corners.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from diga3d_warp.scene.synthetic.materials import MATERIALS, Material

WHITE = (1.0, 1.0, 1.0)


@dataclass(frozen=True, eq=False)
class Surface:
    """A triangle mesh that carries its materials.

    Attributes:
        vertices: World space [m], shape (V, 3).
        normals: Outer unit normals, shape (V, 3).
        uvs: Texture position, 1 = one repeat, shape (V, 2).
        tints: Linear RGB that multiplies the texture, shape (V, 3).
        faces: Corner indices, shape (F, 3), int32.
        materials: Index into `palette` of each face, shape (F,), int32.
        palette: The materials, each once.
    """

    vertices: np.ndarray
    normals: np.ndarray
    uvs: np.ndarray
    tints: np.ndarray
    faces: np.ndarray
    materials: np.ndarray
    palette: tuple[Material, ...]

    def moved(self, offset: Sequence[float]) -> Surface:
        """The same surface elsewhere; `offset` in metres."""
        return replace(self, vertices=self.vertices + np.asarray(offset))

    def turned(self, degrees: float, axis: str = "z") -> Surface:
        """The same surface turned about an axis through the origin, "x", "y" or "z", right-handed."""
        first, second = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
        cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        rotation = np.eye(3)
        rotation[[first, first, second, second], [first, second, first, second]] = cosine, -sine, sine, cosine
        return replace(self, vertices=self.vertices @ rotation.T, normals=self.normals @ rotation.T)

    def stretched(self, factors: Sequence[float]) -> Surface:
        """The same surface stretched along x, y and z; normals stay at right angles to it."""
        normals = self.normals / np.asarray(factors)
        normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        return replace(self, vertices=self.vertices * np.asarray(factors), normals=normals)


def joined(parts: Sequence[Surface]) -> Surface:
    """All parts as one surface; corners and faces keep the order of the parts."""
    starts = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    palette = tuple(dict.fromkeys(material for part in parts for material in part.palette))
    places = [np.array([palette.index(m) for m in part.palette], np.int32) for part in parts]
    return Surface(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.normals for part in parts]),
        np.concatenate([part.uvs for part in parts]),
        np.concatenate([part.tints for part in parts]),
        np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=True)]),
        np.concatenate([place[part.materials] for part, place in zip(parts, places, strict=True)]),
        palette,
    )


def _material(material: str | Material) -> Material:
    return MATERIALS[material] if isinstance(material, str) else material


def sheet(
    vertices: np.ndarray,
    normals: np.ndarray,
    uvs: np.ndarray,
    material: Material,
    tint: Sequence[float] | np.ndarray,
) -> Surface:
    """A grid of corners, arrays of shape (rows, columns, ...), as a surface of two triangles a cell.

    Args:
        vertices: World space [m], shape (R, C, 3); it faces columns x rows.
        normals: Outer unit normals, shape (R, C, 3).
        uvs: Texture position, 1 = one repeat, shape (R, C, 2).
        material: What it is made of.
        tint: Linear RGB that multiplies the texture.
    """
    rows, columns = vertices.shape[:2]
    corner = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return Surface(
        vertices.reshape(-1, 3),
        normals.reshape(-1, 3),
        uvs.reshape(-1, 2),
        np.broadcast_to(np.asarray(tint, np.float64), (rows * columns, 3)),
        faces,
        np.zeros(len(faces), np.int32),
        (material,),
    )


def panel(
    corner: Sequence[float] | np.ndarray,
    edge_u: Sequence[float] | np.ndarray,
    edge_v: Sequence[float] | np.ndarray,
    material: str | Material,
    *,
    tint: Sequence[float] | np.ndarray = WHITE,
    cell: float = 0.08,
    whole: bool = False,
) -> Surface:
    """A rectangle that faces edge_u x edge_v.

    Args:
        corner: Where both edges start [m], shape (3,).
        edge_u, edge_v: The edges [m]; the texture's u and v run along them.
        material: A material, or a key of `MATERIALS`.
        tint: Linear RGB that multiplies the texture.
        cell: Largest edge of a cell [m].
        whole: Show the texture once over the whole rectangle, instead of at its own size.
    """
    stuff = _material(material)
    start, along_u, along_v = (np.asarray(x, np.float64) for x in (corner, edge_u, edge_v))
    lengths = np.array([np.linalg.norm(along_u), np.linalg.norm(along_v)])
    columns, rows = np.ceil(lengths / cell - 1e-9).astype(int) + 1
    share = np.stack(np.meshgrid(np.linspace(0, 1, columns), np.linspace(0, 1, rows)), -1)
    normal = np.cross(along_u, along_v)
    vertices = start + share[..., :1] * along_u + share[..., 1:] * along_v
    # The start moves the texture, so that equal panels at different places do not look alike.
    uvs = share if whole else share * lengths / stuff.period + start.sum() * 0.37
    normals = np.broadcast_to(normal / np.linalg.norm(normal), vertices.shape)
    return sheet(vertices, normals, uvs, stuff, tint)


def box(
    low: Sequence[float],
    high: Sequence[float],
    material: str | Material,
    *,
    tint: Sequence[float] | np.ndarray = WHITE,
    cell: float = 0.08,
) -> Surface:
    """A box between two opposite corners [m], with the texture's u along the longer edge of each side."""
    near = np.asarray(low, np.float64)
    edges = np.diag(np.asarray(high, np.float64) - near)
    sides = []
    for axis in range(3):
        u, v = edges[(axis + 1) % 3], edges[(axis + 2) % 3]
        for corner, along, across in ((near + edges[axis], u, v), (near, v, u)):
            if along.sum() < across.sum():  # starting one corner further keeps the side facing outwards
                corner, along, across = corner + along, across, -along
            sides.append(panel(corner, along, across, material, tint=tint, cell=cell))
    return joined(sides)


def revolved(
    profile: Sequence[tuple[float, float]],
    material: str | Material,
    *,
    tint: Sequence[float] | np.ndarray = WHITE,
    repeats: tuple[float, float] = (1.0, 1.0),
    segments: int = 40,
) -> Surface:
    """A profile turned about the z axis.

    Args:
        profile: (radius, height) from the bottom up along the outer side [m]. A point given twice is a
            sharp rim, elsewhere the surface is smooth.
        material: A material, or a key of `MATERIALS`.
        tint: Linear RGB that multiplies the texture.
        repeats: Repeats of the texture around (a whole number, or the seam shows) and along the profile.
        segments: Cells around.
    """
    points = np.asarray(profile, np.float64)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    length = np.concatenate([[0], np.cumsum(steps)]) / steps.sum()
    slopes = np.empty_like(points)
    runs = np.split(np.arange(len(points)), np.flatnonzero(steps < 1e-6) + 1)
    for run in runs:
        slopes[run] = np.gradient(points[run], length[run], axis=0)
    angle = np.linspace(0, 2 * np.pi, segments + 1)
    around = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], -1)
    up = np.array([0.0, 0.0, 1.0])
    vertices = points[:, :1, None] * around + points[:, 1:, None] * up
    normals = slopes[:, 1:, None] * around - slopes[:, :1, None] * up
    normals = normals / np.linalg.norm(normals, axis=-1, keepdims=True)
    uvs = np.stack(
        np.broadcast_arrays(angle / (2 * np.pi) * repeats[0], (1 - length[:, None]) * repeats[1]), -1
    )
    return sheet(vertices, normals, uvs, _material(material), tint)


def smooth_profile(points: Sequence[tuple[float, float]], count: int) -> list[tuple[float, float]]:
    """`count` points of a Catmull-Rom curve through `points`, (radius, height) [m]."""
    knots = np.asarray(points, np.float64)
    padded = np.concatenate([2 * knots[:1] - knots[1:2], knots, 2 * knots[-1:] - knots[-2:-1]])
    position = np.linspace(0, len(knots) - 1, count)
    index = np.minimum(position.astype(int), len(knots) - 2)
    t = (position - index)[:, None]
    a, b, c, d = (padded[index + k] for k in range(4))
    curve = b + 0.5 * t * (c - a + t * (2 * a - 5 * b + 4 * c - d + t * (3 * (b - c) + d - a)))
    return [(max(float(radius), 0.0), float(height)) for radius, height in curve]


def ball(
    radius: float, material: str | Material, *, repeats: tuple[float, float] = (1.0, 1.0), segments: int = 40
) -> Surface:
    """A sphere about the origin; `radius` in metres, `segments` cells around and half as many up."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, segments // 2 + 1)
    profile = [(radius * float(np.cos(a)), radius * float(np.sin(a))) for a in angle]
    return revolved(profile, material, repeats=repeats, segments=segments)
