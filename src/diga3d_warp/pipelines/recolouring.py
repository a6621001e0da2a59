"""Stages of retexture: render the object in every view, repaint it, and fit its colours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from diga3d_warp.config import Effects
from diga3d_warp.files import to_bytes, write_arrays, write_image
from diga3d_warp.gaussians.density import spread_out
from diga3d_warp.gaussians.fit import FitSettings, fit
from diga3d_warp.gaussians.lift import lifted_colors, object_share
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.gaussians.representation import Representation
from diga3d_warp.gaussians.surround import render_before
from diga3d_warp.gaussians.target import Target
from diga3d_warp.kernels.harmonics import C0
from diga3d_warp.objects.repaint import Repainter
from diga3d_warp.objects.surface import Sight, pixel_width, without_floaters
from diga3d_warp.pipelines import stages
from diga3d_warp.pipelines.run import Run
from diga3d_warp.propagation.references import References
from diga3d_warp.scene.scene import View
from diga3d_warp.splatting.render import render
from diga3d_warp.state import read_arrays, read_picture, read_plane


@dataclass(frozen=True)
class SplitSettings:
    """Splitting of the object's gaussians before they get their new colours.

    Attributes:
        size: Geometric mean of the two larger standard deviations above which a gaussian is split [px]. A
            smooth old surface has large gaussians, which could not show a new texture.
        most: Most pieces of one gaussian.
        spread: Distance of the pieces from the mean [standard deviations], see `DensitySettings.spread`.
    """

    size: float = 1.2
    most: int = 12
    spread: float = 0.8


def look_at_object(
    run: Run, views: Sequence[View], source: Representation, rows: torch.Tensor
) -> list[Sight]:
    """The object in every view: the image before, the object's part in it, and its depth."""

    def compute(folder: Path) -> None:
        shell = stages.shell_of(run)
        for view in views:
            sight = _sight(source, rows, view, run.effects, shell)
            write_image(folder / f"{view.name}.png", sight.image)
            if sight.alpha is not None:
                write_image(folder / f"{view.name}.alpha.png", sight.alpha)
            write_arrays(
                folder / f"{view.name}.npz",
                own=sight.own, share=sight.share, depth=sight.depth, scene_depth=sight.scene_depth,
            )  # fmt: skip

    folder = run.stage("look", compute)
    sights = []
    for view in views:
        alpha = read_plane(folder / f"{view.name}.alpha.png") if run.effects.background else None
        planes = read_arrays(folder / f"{view.name}.npz")
        image = read_picture(folder / f"{view.name}.png")
        sights.append(Sight(camera=view.camera, image=image, alpha=alpha, **planes))
    return sights


@torch.no_grad()
def _sight(
    source: Representation, rows: torch.Tensor, view: View, effects: Effects, shell: Gaussians | None
) -> Sight:
    camera = view.camera
    without = source.brightened(~rows, 0.0)  # what is left is the object's part
    colors_only, with_depth = replace(effects, depth=False), replace(effects, depth=True)
    share = without_floaters(object_share(source, camera, rows, effects).numpy())
    whole = render_before(shell, source, camera, with_depth)
    depth = render(source.select(rows), camera, effects=with_depth).depth.numpy()
    return Sight(
        camera,
        whole.color.clamp(0.0, 1.0).numpy(),
        render(without, camera, effects=colors_only).color.numpy(),
        share,
        np.where(share > 0, depth, 0.0).astype(np.float32),
        whole.depth.numpy(),
        to_bytes(whole.alpha) if effects.background else None,
    )


def repaint(
    run: Run, views: Sequence[View], sights: Sequence[Sight], references: References, repainter: Repainter,
    seed: int,
) -> list[np.ndarray]:  # fmt: skip
    """Repaint the object in every view."""

    def compute(folder: Path) -> None:
        colors = repainter.repaint(sights, references.indices, seed)
        for view, sight, painted in zip(views, sights, colors, strict=True):
            write_image(folder / f"{view.name}.png", sight.repainted(painted))

    folder = run.stage("repaint", compute)
    return [read_picture(folder / f"{view.name}.png") for view in views]


def recolour(
    run: Run, source: Representation, rows: torch.Tensor, sights: Sequence[Sight],
    images: Sequence[np.ndarray], extent: float, settings: FitSettings, split: SplitSettings, seed: int,
) -> Representation:  # fmt: skip
    """Fit the object's gaussians to the repainted views; all others keep their values."""

    def compute(folder: Path) -> None:
        rest, thing = source.select(~rows), source.select(rows).plain([sight.camera for sight in sights])
        fine = _split(thing, sights, split, seed)
        painted = rest.joined(_painted(fine, rest, sights, images, run.effects))
        held = torch.arange(len(painted)) < len(rest)
        result = fit(
            painted, targets_of(sights, images), extent, settings, effects=run.effects, seed=seed, held=held,
            surround=stages.shell_of(run), checkpoint=folder / "checkpoint.pt", note=run.note, progress=True,
            label="refit",
        )  # fmt: skip
        stages.keep_fit(run, folder, result)

    return stages.fitted(run, "refit", compute)


def targets_of(sights: Sequence[Sight], images: Sequence[np.ndarray]) -> list[Target]:
    """Targets of the fit: the repainted views, with the depth of the object."""
    return [
        Target(
            sight.camera,
            torch.from_numpy(to_bytes(image)),
            depth=torch.from_numpy(sight.depth),
            alpha=stages.tensor_of(sight.alpha),
        )
        for sight, image in zip(sights, images, strict=True)
    ]


def _split(gaussians: Gaussians, sights: Sequence[Sight], settings: SplitSettings, seed: int) -> Gaussians:
    """The same gaussians, those wider than `SplitSettings.size` split."""
    area = gaussians.scales.sort(dim=1).values[:, 1:].prod(dim=1) / (settings.size * pixel_width(sights)) ** 2
    pieces = area.ceil().clamp(1, settings.most).long()
    generator = torch.Generator().manual_seed(seed)
    whole = gaussians.select(pieces == 1)
    broken = gaussians.select(torch.repeat_interleave(torch.arange(len(gaussians)), pieces * (pieces > 1)))
    return whole.joined(spread_out(broken, settings.spread, generator)) if len(broken) else whole


def _painted(
    gaussians: Gaussians, rest: Representation, sights: Sequence[Sight], images: Sequence[np.ndarray],
    effects: Effects,
) -> Gaussians:  # fmt: skip
    """Gaussians with the mean colour of the pixels that they show in, before and behind the rest."""
    cameras, masks = [sight.camera for sight in sights], [sight.mask for sight in sights]
    colors = lifted_colors(gaussians, cameras, images, masks, effects, among=rest)
    painted = gaussians.detached()
    painted.sh[:] = 0.0
    painted.sh[:, 0] = (colors - 0.5) / C0
    return painted
