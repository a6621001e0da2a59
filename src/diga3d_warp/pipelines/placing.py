"""Stages of replace: place the new object, compose it into every view, and fit to those views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from diga3d_warp.config import Effects
from diga3d_warp.files import to_bytes, write_array, write_image
from diga3d_warp.gaussians.fit import FitSettings, fit
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.gaussians.representation import Representation
from diga3d_warp.gaussians.storage import load
from diga3d_warp.gaussians.surround import render_before
from diga3d_warp.gaussians.target import Target
from diga3d_warp.materials.painting import GAMMA
from diga3d_warp.objects.asset import Asset, MeshAsset
from diga3d_warp.objects.decal import decal, shown_depth
from diga3d_warp.objects.frame import Frame
from diga3d_warp.objects.light import Light, estimate_light
from diga3d_warp.objects.placement import Placed, PlacedMesh, PlacedSplat
from diga3d_warp.objects.shadow import Shadow
from diga3d_warp.objects.support import find_place
from diga3d_warp.objects.surface import Sight, fuse, pixel_width
from diga3d_warp.pipelines import clearing, stages
from diga3d_warp.pipelines.run import Run
from diga3d_warp.scene.photographs.images import BACKGROUND
from diga3d_warp.scene.scene import View
from diga3d_warp.splatting.placement import unprojected
from diga3d_warp.state import read_array, read_picture, read_plane
from diga3d_warp.surfaces.chart import Chart


@dataclass(frozen=True)
class PlacingSettings:
    """Thresholds of occlusion, support and shadow where the new object meets the scene.

    Attributes:
        behind: Distance in front of the object from which the scene hides it [object sizes]: the depth of the
            filled floor is noisy.
        around: How far around the middle the support reaches for certain [object sizes].
        room: How far around the middle the object itself reaches, with a margin [object sizes].
        floor: Height up to which a gaussian is the support itself [object sizes].
        low: Height up to which anything around is the support, or a bump in it [object sizes].
        inside: How far behind its front a gaussian still stands before it [object sizes]: within it.
        blocked: Part of the views in which a gaussian must stand before it, of those that show its place.
        shaded: Share of the light that is left under which a gaussian takes the shadow.
        changed: Share of the light under which a pixel counts as edited.
    """

    behind: float = 0.12
    around: float = 1.2
    room: float = 0.8
    floor: float = 0.04
    low: float = 0.35
    inside: float = 0.02
    blocked: float = 0.2
    shaded: float = 0.985
    changed: float = 0.97


@dataclass(frozen=True, eq=False)
class Staged:
    """The new object in the scene, before the last fit.

    Attributes:
        gaussians: All of the scene, the new object's last.
        held: Rows that keep their values, shape (N,), bool.
        targets: What the training views should show.
    """

    gaussians: Representation
    held: torch.Tensor
    targets: list[Target]


@dataclass(frozen=True, eq=False)
class _Stand:
    """Where the new object stands.

    Attributes:
        frame: Its place.
        scale: Its size [scene units].
        settings: Thresholds of occlusion, support and shadow.
    """

    frame: Frame
    scale: float
    settings: PlacingSettings

    def emptied(self, points: np.ndarray, base: float | None = None) -> np.ndarray:
        """Points (P, 3) in the space of the new object or low around it, which must be empty, shape (P,).

        Args:
            points: World space.
            base: Height from which on they count [object sizes]; `PlacingSettings.floor` if None.
        """
        local = self.frame.inward(points) / self.scale
        away = np.hypot(local[:, 0], local[:, 1])
        top = np.where(away < self.settings.room, 1.0 + self.settings.low, self.settings.low)
        above = self.settings.floor if base is None else base
        return (away < self.settings.around) & (local[:, 2] > above) & (local[:, 2] < top)


def place_object(
    run: Run, views: Sequence[View], others: Sequence[View], edit_masks: clearing.Masks,
    changed: clearing.Masks, sights: Sequence[Sight], cleared: Representation,
    charts: Sequence[Chart], asset: Asset,
    settings: PlacingSettings,
) -> Staged:  # fmt: skip
    """Put an asset where the old object stood, with its shadow, and draw it into every view.

    Args:
        run: Run folder that receives the stage.
        views: Training views.
        others: Held-out views; only their masks are extended by the new object.
        edit_masks: Edit masks of the old object, of both.
        changed: Masks of all that its removal changed, of both.
        sights: The old object in the training views.
        cleared: The scene without it.
        charts: Surfaces behind it, filled.
        asset: The new object.
        settings: Thresholds of occlusion, support and shadow.
    """
    glossy = [chart for chart in charts if chart.trusted and not chart.deep]

    def compute(folder: Path) -> None:
        surface, *apart = fuse(sights).parts()
        if apart:
            run.note(
                f"the masks hold {1 + len(apart)} objects that stand apart; the new one takes the place of "
                "the largest"
            )
        around = np.concatenate([sight.shown[::7] for sight in sights])
        light = estimate_light(surface.normals, surface.colors, around)
        cameras = [view.camera for view in views]
        place = find_place(surface, cameras, cleared, told=[chart.frame.plane for chart in glossy])
        floor = None if place.told is None else glossy[place.told]
        if not place.supported:
            run.note("no surface was found under the object; the new one stands at the height of its base")
        scale = place.scale(asset.extent)
        effects, shell = replace(run.effects, depth=True), stages.shell_of(run)
        stand = _Stand(place.frame, scale, settings)
        placed, shadow = _put(asset, place.frame, scale, light, effects)
        looks = [placed.look(camera) for camera in cameras]
        blocking = _blocking(cleared, views, edit_masks, looks, stand)
        scene = cleared.select(~blocking)
        for view in [*views, *others]:
            mask = edit_masks[view.name]
            image, depth, edited, alpha = _composed(
                scene, placed, shadow, view, mask, stand, effects, floor, shell
            )
            write_image(folder / "masks" / f"{view.name}.png", changed[view.name] | edited)
            write_image(folder / f"{view.name}.png", image)
            write_array(folder / f"{view.name}.npy", depth)
            if effects.background:
                write_image(folder / f"{view.name}.alpha.png", alpha)
        added = placed.gaussians(pixel_width(sights), scene.coefficients)
        if floor is None:
            dark, shaded = _darkened(scene, shadow, settings)
        else:
            dark, shaded = scene, np.zeros(len(scene), bool)
            discs = decal(shadow, floor, scene.coefficients, settings.shaded)
            added = added if discs is None else discs.joined(added)
        whole = dark.joined(added)
        whole.save(folder, antialiased=run.effects.antialias)
        held = np.concatenate([~shaded, np.zeros(len(whole) - len(dark), bool)])
        write_array(folder / "held.npy", held)
        write_array(folder / "blocking.npy", blocking)

    folder = run.stage("place", compute)
    targets = []
    for view in views:
        pixels = to_bytes(read_picture(folder / f"{view.name}.png"))
        depth = torch.from_numpy(read_array(folder / f"{view.name}.npy"))
        alpha = read_plane(folder / f"{view.name}.alpha.png") if run.effects.background else None
        target = Target(view.camera, torch.from_numpy(pixels), depth=depth, alpha=stages.tensor_of(alpha))
        targets.append(target)
    held = torch.from_numpy(read_array(folder / "held.npy"))
    return Staged(load(folder), held, targets)


def settle(run: Run, staged: Staged, extent: float, settings: FitSettings, seed: int) -> Representation:
    """Fit the new object and the shaded floor to the composed views."""

    def compute(folder: Path) -> None:
        result = fit(
            staged.gaussians, staged.targets, extent, settings, effects=run.effects, seed=seed,
            held=staged.held, surround=stages.shell_of(run),
            checkpoint=folder / "checkpoint.pt", note=run.note,
            progress=True, label="settle",
        )  # fmt: skip
        stages.keep_fit(run, folder, result)

    return stages.fitted(run, "settle", compute)


def _put(asset: Asset, frame: Frame, scale: float, light: Light, effects: Effects) -> tuple[Placed, Shadow]:
    if isinstance(asset, MeshAsset):
        mesh = asset.vertices, asset.faces
        return PlacedMesh(asset, frame, scale, light), Shadow(*mesh, frame, scale, light)
    return PlacedSplat(asset, frame, scale, effects), Shadow(*asset.hull, frame, scale, light)


def _blocking(
    cleared: Representation, views: Sequence[View], edit_masks: clearing.Masks,
    looks: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]], stand: _Stand,
) -> torch.Tensor:  # fmt: skip
    """Gaussians that stand before the new object and cannot be anything real, shape (N,), bool.

    They are bumps in the fill, invisible while nothing was behind them: where the old object was visible
    nothing was in front of it, and what lies low around it is the support.
    """
    means = cleared.means.double().numpy()
    emptied = stand.emptied(means)
    blocks, shown = np.zeros(len(means)), np.zeros(len(means))
    for view, (_, coverage, depth) in zip(views, looks, strict=True):
        camera, pose = view.camera, view.camera.pose
        x, y, z = (means @ pose[:3, :3].T + pose[:3, 3]).T
        front = z > 1e-9
        z = np.where(front, z, 1.0)
        column = np.floor(camera.fx * x / z + camera.cx).clip(-1, camera.width).astype(int)
        row = np.floor(camera.fy * y / z + camera.cy).clip(-1, camera.height).astype(int)
        inside = front & (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
        place = row[inside], column[inside]
        over = (coverage[place] > 0.5) & (edit_masks[view.name][place] | emptied[inside])
        shown[inside] += 1
        blocks[inside] += over & (z[inside] < depth[place] + stand.settings.inside * stand.scale)
    return torch.from_numpy((blocks > 0) & (blocks >= stand.settings.blocked * shown))


def _composed(
    cleared: Representation, placed: Placed, shadow: Shadow, view: View, edit_mask: np.ndarray, stand: _Stand,
    effects: Effects, floor: Chart | None, shell: Gaussians | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """A view with the new object: its image, depth, where it differs from the cleared one, and opacity.

    `floor` is a glossy support, on which the shadow falls where it is, not where its gaussians are.
    """
    camera = view.camera
    seen = render_before(shell, cleared, camera, effects)
    base, behind, alpha = seen.color.clamp(0.0, 1.0).numpy(), seen.depth.numpy(), seen.alpha.numpy()
    color, coverage, depth = placed.look(camera)
    shown = behind if floor is None else shown_depth(floor, camera, behind)
    surface = unprojected(shown, camera).reshape(-1, 3)
    real = ~edit_mask & ~stand.emptied(surface, base=-np.inf).reshape(behind.shape)
    hidden = real & (behind > 0) & (behind < depth - stand.settings.behind * stand.scale)
    coverage = np.where(hidden, 0.0, coverage)[..., None]
    color = np.where(hidden[..., None], 0.0, color)
    light = shadow.at(surface).reshape(behind.shape)
    light = np.where(alpha > 0.5 if effects.background else behind > 0, light, 1.0)
    image = base * (light ** (1.0 / GAMMA))[..., None] * (1.0 - coverage) + color
    alpha = alpha + (1.0 - alpha) * coverage[..., 0]
    if effects.background:
        image = image + (1.0 - alpha)[..., None] * np.array(BACKGROUND, np.float32)
    covered = coverage[..., 0] > 0.5
    edited = (coverage[..., 0] > 0.02) | (light < stand.settings.changed)
    return image.clip(0, 1), np.where(covered, depth, behind).astype(np.float32), edited, alpha


def _darkened(
    cleared: Representation, shadow: Shadow, settings: PlacingSettings
) -> tuple[Representation, np.ndarray]:
    """The scene with the shadow on its gaussians, and which of them it falls on, shape (N,), bool."""
    light = shadow.at(cleared.means.double().numpy())
    shaded = light < settings.shaded
    factor = torch.from_numpy(np.where(shaded, light ** (1.0 / GAMMA), 1.0).astype(np.float32))
    return cleared.brightened(torch.ones(len(cleared), dtype=torch.bool), factor), shaded
