"""An asset placed in a scene: its renderings and its gaussians."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
import warp as wp

from diga3d_warp.config import Effects
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.kernels.harmonics import C0
from diga3d_warp.kernels.raycast import gathered_light, nearest_hits
from diga3d_warp.materials.painting import GAMMA
from diga3d_warp.objects.asset import MeshAsset, SplatAsset
from diga3d_warp.objects.frame import Frame
from diga3d_warp.objects.light import Light, exposed
from diga3d_warp.objects.surface import unit
from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.optics import optics_of
from diga3d_warp.splatting.render import render


@dataclass(frozen=True)
class PlacementSettings:
    """Sampling of an asset's renderings and gaussians.

    Attributes:
        supersampling: Rays per pixel and axis.
        strata: Rays per axis of the hemisphere for ambient occlusion: 64 rays, 3 % noise.
        bounce: Light from occluded directions [share of open ones]: about the albedo of a floor.
        gaussians: Most gaussians on its surface.
        width: Deviation of a gaussian along the surface [distance to its neighbours]: closes the gaps.
        thickness: Deviation across the surface [of that along it].
        opacity: Initial opacity of its gaussians.
        seed: Seed of the positions and rays.
    """

    supersampling: int = 2
    strata: int = 8
    bounce: float = 0.35
    gaussians: int = 30_000
    width: float = 0.62
    thickness: float = 0.15
    opacity: float = 0.95
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Sample:
    """Points on the surface of a placed asset.

    Attributes:
        points, normals: World space, shape (P, 3).
        colors: Lit display RGB, shape (P, 3).
        area: Surface behind each [scene units^2].
    """

    points: np.ndarray
    normals: np.ndarray
    colors: np.ndarray
    area: float


class PlacedMesh:
    """A mesh asset placed in a scene."""

    def __init__(
        self, asset: MeshAsset, frame: Frame, scale: float, light: Light,
        settings: PlacementSettings | None = None,
    ) -> None:  # fmt: skip
        """Put an asset onto the base of a frame.

        Args:
            asset: The asset.
            frame: Its place; the asset's axes become the frame's.
            scale: Its size [scene units].
            light: Light of the scene.
            settings: Sampling of renderings and gaussians.
        """
        self.asset, self.frame, self.scale, self.light = asset, frame, scale, light
        self.settings = settings or PlacementSettings()
        self.vertices = frame.outward(asset.vertices * scale)

    def look(self, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Render it alone.

        Returns:
            Display colours premultiplied by coverage (H, W, 3), coverage in [0, 1] (H, W), and z of its
            front [scene units], 0 where it is not (H, W), all float32.
        """
        grid = self.settings.supersampling
        fine = camera.resized(camera.width * grid, camera.height * grid)
        rays = optics_of(fine).rays.reshape(-1, 2).astype(np.float64)
        directions = np.concatenate([rays, np.ones((len(rays), 1))], axis=1)
        length = np.linalg.norm(directions, axis=1)
        near = np.flatnonzero(np.isfinite(length) & self._may_meet(rays, camera))
        if len(near) == 0:
            nothing = np.zeros((camera.height, camera.width), np.float32)
            return np.zeros((camera.height, camera.width, 3), np.float32), nothing, nothing
        world = (directions[near] / length[near, None]) @ camera.pose[:3, :3]
        face, distance, weights = self._cast(np.broadcast_to(camera.center, world.shape), world)
        hit = face >= 0
        points = camera.center + world[hit] * distance[hit, None]
        colors, depths = np.zeros((len(rays), 3)), np.full(len(rays), np.inf)
        colors[near[hit]] = self._lit(face[hit], weights[hit], points)
        depths[near[hit]] = distance[hit] / length[near[hit]]
        shape = (camera.height, grid, camera.width, grid)
        coverage = np.isfinite(depths).reshape(shape).mean(axis=(1, 3))
        color = colors.reshape(*shape, 3).mean(axis=(1, 3))
        depth = depths.reshape(shape).min(axis=(1, 3))
        depth = np.where(np.isfinite(depth), depth, 0.0)
        return color.astype(np.float32), coverage.astype(np.float32), depth.astype(np.float32)

    def _may_meet(self, rays: np.ndarray, camera: Camera) -> np.ndarray:
        """Which rays (x / z, y / z) of shape (P, 2) pass the rectangle around all corners, shape (P,)."""
        local = self.vertices @ camera.pose[:3, :3].T + camera.pose[:3, 3]
        if local[:, 2].min() < 1e-6:  # partly behind the camera: the rectangle has no meaning
            return np.ones(len(rays), bool)
        flat = local[:, :2] / local[:, 2:]
        return ((rays >= flat.min(axis=0)) & (rays <= flat.max(axis=0))).all(axis=1)

    def sample(self, count: int) -> Sample:
        """Points spread evenly over its surface, lit."""
        rng = np.random.default_rng([self.settings.seed, 1])
        corners = self.vertices[self.asset.faces]
        areas = 0.5 * np.linalg.norm(
            np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
        )
        # Even steps through the areas, each moved a little: no clumps and no holes, as pure chance leaves.
        steps = (np.arange(count) + rng.random(count)) / count * areas.sum()
        face = np.minimum(np.searchsorted(np.cumsum(areas), steps), len(areas) - 1)
        a, b = np.sqrt(rng.random(count)), rng.random(count)
        weights = np.stack([1 - a, a * (1 - b), a * b], axis=1)
        points = (corners[face] * weights[..., None]).sum(axis=1)
        return Sample(
            points, self._normals(face, weights), self._lit(face, weights, points), float(areas.sum()) / count
        )

    def gaussians(self, pixel: float, coefficients: int) -> Gaussians:
        """Flat gaussians that lie on its surface, in its colours.

        Args:
            pixel: Width of a pixel at its distance [scene units]; finer than that gains nothing.
            coefficients: Spherical harmonics per gaussian; those above the first are zero.
        """
        corners = self.vertices[self.asset.faces]
        crossed = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        total = 0.5 * float(np.linalg.norm(crossed, axis=1).sum())
        count = int(np.clip(total / pixel**2, 500, self.settings.gaussians))
        sample = self.sample(count)
        width = self.settings.width * np.sqrt(sample.area)
        sh = torch.zeros(count, coefficients, 3)
        sh[:, 0] = (torch.from_numpy(sample.colors.astype(np.float32)) - 0.5) / C0
        across = np.log(width * self.settings.thickness)
        scales = torch.tensor([np.log(width), np.log(width), across], dtype=torch.float32)
        logit = float(np.log(self.settings.opacity / (1 - self.settings.opacity)))
        return Gaussians(
            means=torch.from_numpy(sample.points.astype(np.float32)),
            log_scales=scales.repeat(count, 1),
            quaternions=torch.from_numpy(turning_z_to(sample.normals).astype(np.float32)),
            opacity_logits=torch.full((count,), logit),
            sh=sh,
        )

    @cached_property
    def mesh(self) -> wp.Mesh:
        """The mesh in the frame [frame's size 1], where rays have lengths of order 1."""
        return warp_mesh(self.asset.vertices, self.asset.faces)

    def _cast(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Face (-1 where nothing is met), distance [scene units] and weights of the face's corners."""
        inward = self.frame.inward(origins) / self.scale
        hits = nearest_hits(self.mesh, vectors(inward), vectors(self.frame.turned(directions)))
        first, second = hits.barycentric.numpy().astype(np.float64).T
        weights = np.stack([first, second, 1 - first - second], axis=1)
        return hits.face.numpy(), hits.distance.numpy().astype(np.float64) * self.scale, weights

    def _normals(self, face: np.ndarray, weights: np.ndarray) -> np.ndarray:
        inside = (self.asset.normals[face] * weights[..., None]).sum(axis=1)
        return unit(inside) @ self.frame.axes

    def _lit(self, face: np.ndarray, weights: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Display RGB of points on its faces under the light, darker where they are closed in."""
        inside = self.frame.inward(points) / self.scale
        normals = self._normals(face, weights)
        albedo = self.asset.painter(face, weights, inside, self.frame.turned(normals)) ** GAMMA
        lit = albedo * (self.light.on(normals) * self._openness(face, weights))[:, None]
        return exposed(lit)

    def _openness(self, face: np.ndarray, weights: np.ndarray) -> np.ndarray:
        return (self._corner_openness[face] * weights).sum(axis=1)

    @cached_property
    def _corner_openness(self) -> np.ndarray:
        """Ambient light at the corners of each face, relative to an unoccluded one, shape (F, 3)."""
        vertices, faces = self.asset.vertices, self.asset.faces
        floor = np.array([[-9.0, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]])
        around = warp_mesh(
            np.concatenate([vertices, floor]),
            np.concatenate([faces, len(vertices) + np.array([[0, 1, 2], [0, 2, 3]])]),
        )
        corners = vertices[faces]
        # A little off the corner, towards the middle of its face: on an edge rounding would decide.
        inset = corners + 0.05 * (corners.mean(axis=1, keepdims=True) - corners)
        inset[..., 2] = np.maximum(inset[..., 2], 2e-3)
        open_share = openness(around, inset.reshape(-1, 3), self.asset.normals.reshape(-1, 3), self.settings)
        # Relative to an unoccluded point on an infinite floor: a vertical face sees half the sky.
        upward = self.asset.normals.reshape(-1, 3)[:, 2]
        expected = np.maximum(0.5 + 0.5 * upward, 0.0)
        bounce = self.settings.bounce
        seen = open_share + bounce * (1 - open_share)
        best = expected + bounce * (1 - expected)
        return np.clip(seen / best, 0.3, 1.0).reshape(faces.shape)


def openness(
    mesh: wp.Mesh, points: np.ndarray, normals: np.ndarray, settings: PlacementSettings
) -> np.ndarray:
    """Share of the sky that points see past a mesh, weighted by the cosine, in [0, 1], shape (P,)."""
    dark = wp.zeros(len(mesh.points), dtype=wp.vec3, device="cpu")
    light = gathered_light(
        mesh, dark, vectors(points), vectors(normals), sky=wp.vec3(1.0, 1.0, 1.0),
        strata=settings.strata, seed=settings.seed,
    )  # fmt: skip
    return light.numpy()[:, 0].astype(np.float64)


def vectors(array: np.ndarray) -> wp.array:
    """Points or directions (P, 3) for a kernel."""
    return wp.array(np.ascontiguousarray(array, np.float32), dtype=wp.vec3, device="cpu")


def warp_mesh(vertices: np.ndarray, faces: np.ndarray) -> wp.Mesh:
    """Triangles, ready for rays."""
    flat = np.ascontiguousarray(faces, np.int32).reshape(-1)
    indices: wp.array = wp.array(flat, dtype=wp.int32, device="cpu")
    return wp.Mesh(points=vectors(vertices), indices=indices)


def turning_z_to(directions: np.ndarray) -> np.ndarray:
    """Quaternions (w, x, y, z) that turn the z axis to unit directions (P, 3), shape (P, 4)."""
    x, y, z = directions.T
    w = 1.0 + z
    opposite = w < 1e-6
    quaternions = np.stack([w, -y, x, np.zeros_like(x)], axis=1)
    quaternions[opposite] = [0.0, 1.0, 0.0, 0.0]
    return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)


class PlacedSplat:
    """A splat asset placed in a scene, in its own colours."""

    def __init__(self, asset: SplatAsset, frame: Frame, scale: float, effects: Effects) -> None:
        """Put an asset onto the base of a frame, as `PlacedMesh`, to be drawn with the scene's effects."""
        self._effects = effects
        placed = asset.gaussians.detached()
        inside = placed.means.double().numpy() * scale
        placed.means = torch.from_numpy(frame.outward(inside).astype(np.float32))
        placed.log_scales = placed.log_scales + float(np.log(scale))
        placed.quaternions = torch.from_numpy(_turned(frame.axes.T, placed.quaternions.numpy()))
        # Harmonics above the first belong to the directions of the asset's own scene.
        self._gaussians = placed
        self._gaussians.sh[:, 1:] = 0.0

    def look(self, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Render the asset alone; see `PlacedMesh.look`."""
        with torch.no_grad():
            seen = render(self._gaussians, camera, effects=self._effects)
        depth = np.where(seen.alpha.numpy() > 0.5, seen.depth.numpy(), 0.0)
        return seen.color.clamp(0.0, 1.0).numpy(), seen.alpha.numpy(), depth.astype(np.float32)

    def gaussians(self, pixel: float, coefficients: int) -> Gaussians:
        """Its gaussians with as many harmonics as the scene's; they are as fine as they are."""
        placed = self._gaussians.detached()
        sh = torch.zeros(len(placed), coefficients, 3)
        kept = min(coefficients, placed.sh.shape[1])
        sh[:, :kept] = placed.sh[:, :kept]
        placed.sh = sh
        return placed


Placed = PlacedMesh | PlacedSplat


def _turned(rotation: np.ndarray, quaternions: np.ndarray) -> np.ndarray:
    """Quaternions (w, x, y, z) of shape (P, 4) after a further rotation (3, 3)."""
    from scipy.spatial.transform import Rotation

    own = Rotation.from_quat(quaternions[:, [1, 2, 3, 0]])
    turned = (Rotation.from_matrix(rotation) * own).as_quat()
    return turned[:, [3, 0, 1, 2]].astype(np.float32)
