"""The coarse stage (paper Sec. 3.3): fill the references, warp or propagate to other views, fit the hole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import reduce
from pathlib import Path

import numpy as np
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.files import to_bytes, write_arrays, write_image
from diga3d_warp.gaussians.fit import FitSettings, fit
from diga3d_warp.gaussians.initialise import from_image
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.gaussians.representation import Representation
from diga3d_warp.gaussians.target import Target
from diga3d_warp.perception.depth import DepthEstimator
from diga3d_warp.pipelines import clearing, stages
from diga3d_warp.pipelines.method import Method
from diga3d_warp.pipelines.own_fills import NO_FILLS, Fills, by_index
from diga3d_warp.pipelines.run import Run, sampling_bar, say
from diga3d_warp.priors.protocol import DiffusionPrior, Prior
from diga3d_warp.propagation.appearance import propagate_appearance
from diga3d_warp.propagation.charted import chart_views, photos_of
from diga3d_warp.propagation.fill import Fill, fill_references, fill_rest, warp_fills
from diga3d_warp.propagation.references import References
from diga3d_warp.propagation.unseen import Background
from diga3d_warp.scene.scene import View
from diga3d_warp.state import read_arrays, read_picture
from diga3d_warp.surfaces.chart import Chart
from diga3d_warp.surfaces.surfels import surfels
from diga3d_warp.surfaces.votes import refused

SEEDS_PER_REFERENCE = 12_000
"""Most gaussians on the pixels that one reference inpainted: two thirds of the pixels of a tenth of a 504 x
378 image, about the density of a fitted image."""


def fill_views(
    run: Run,
    views: Sequence[View],
    backgrounds: Sequence[Background],
    depths: Sequence[np.ndarray],
    charts: Sequence[Chart],
    references: References,
    prior: Prior,
    method: Method,
    seed: int,
    own: Fills = NO_FILLS,
) -> list[Fill]:
    """Put the charts into all views, fill what these leave of the references, and warp that to the others.

    What no reference shows is filled in further views, unless every view is inpainted on its own later.

    References that the user filled are taken as they are, and other views take from them first: charts give
    their depth, and fill what they do not show.
    """
    cameras = [view.camera for view in views]
    together = method.propagation != "none"
    given = by_index(own, views)

    def compute(folder: Path) -> None:
        charted = chart_views(views, backgrounds, depths, charts)
        left, surfaces = list(backgrounds), list(depths)
        if not given:
            left, surfaces = [each.background for each in charted], [each.depth for each in charted]
        fills = fill_references(
            cameras, left, surfaces, references, prior, seed, together=together, own=given
        )
        if given:
            fills = [charted[i].under(fill) for i, fill in zip(references.indices, fills, strict=True)]
        warped = warp_fills(cameras, left, surfaces, references, fills)
        warped = [each.completed(fill) for each, fill in zip(charted, warped, strict=True)]
        if method.propagation == "warp":  # otherwise every view is inpainted on its own later
            warped = fill_rest(cameras, left, surfaces, warped, prior, seed)
        _keep(folder, views, warped)

    return read_fills(run.stage("fill", compute), views)


def propagate(
    run: Run,
    views: Sequence[View],
    backgrounds: Sequence[Background],
    depths: Sequence[np.ndarray],
    fills: Sequence[Fill],
    references: References,
    prior: Prior,
    method: Method,
    seed: int,
) -> list[Fill]:
    """Inpaint the hole of every other view, attending to the references if the method says so."""
    if method.propagation == "warp":
        return list(fills)
    assert isinstance(prior, DiffusionPrior), "check_method refuses others"

    sampling = method.sampling_for(prior)
    total = len(prior.schedule.timesteps(sampling.steps, sampling.strength))

    def compute(folder: Path) -> None:
        bar = sampling_bar("propagate")
        found = propagate_appearance(
            prior, fills, backgrounds, depths, references, sampling,
            attend=method.propagation == "attention", inversion=method.inversion or "none", seed=seed,
            say=say, progress=lambda done: bar(done, total),
        )  # fmt: skip
        _keep(folder, views, found)

    return read_fills(run.stage("propagate", compute), views)


def estimate_depth(
    run: Run,
    views: Sequence[View],
    backgrounds: Sequence[Background],
    depths: Sequence[np.ndarray],
    charts: Sequence[Chart],
    fills: Sequence[Fill],
    estimator: DepthEstimator | None,
) -> list[Fill]:
    """Depth of the filled views, estimated and aligned to the scene around (paper Sec. 3.5, L_depth).

    Charts know the surface that they show and keep its depth. Without an estimator, or where its estimate
    contradicts the scene, the depth is that which the surroundings continue.
    """
    if estimator is None:
        return list(fills)

    def compute(folder: Path) -> None:
        found = []
        charted = chart_views(views, backgrounds, depths, charts)
        for view, background, depth, fill, each in zip(
            views, backgrounds, depths, fills, charted, strict=True
        ):
            open_ = fill.filled & ~each.shown
            if open_.any():
                around = torch.from_numpy(~background.unseen)
                try:
                    guess = estimator.aligned(torch.from_numpy(fill.image), torch.from_numpy(depth), around)
                    fill = replace(fill, depth=np.where(open_, guess.numpy(), fill.depth).astype(np.float32))
                except InputError as error:
                    run.note(f"{view.name}: {error}; the surface around the hole is continued")
            found.append(fill)
        _keep(folder, views, found)

    return read_fills(run.stage("estimate", compute), views)


def targets_of(
    views: Sequence[View], backgrounds: Sequence[Background], fills: Sequence[Fill]
) -> list[Target]:
    """Targets of the fit: the filled views, with the depth of the fill."""
    return [
        Target(
            view.camera,
            torch.from_numpy(to_bytes(fill.image)),
            weight=torch.from_numpy((~fill.missing).astype(np.float32)),
            depth=torch.from_numpy(fill.depth),
            alpha=stages.tensor_of(background.alpha),
        )
        for view, background, fill in zip(views, backgrounds, fills, strict=True)
    ]


def seeds_of(
    views: Sequence[View], fills: Sequence[Fill], references: References, coefficients: int
) -> list[Gaussians]:
    """Gaussians on the pixels that each view inpainted.

    With attention, several views inpaint what no reference shows, mostly the same surface. Together they get
    as many gaussians as one reference.
    """
    invented = [int(fill.invented.sum()) for fill in fills]
    by_others = sum(count for i, count in enumerate(invented) if i not in references.indices)
    seeds = []
    for i, (view, fill) in enumerate(zip(views, fills, strict=True)):
        most = SEEDS_PER_REFERENCE
        if i not in references.indices and by_others > most:
            most = max(1, most * invented[i] // by_others)
        if invented[i]:
            seeds.append(from_image(fill.image, fill.depth, fill.invented, view.camera, coefficients, most))
    return seeds


def refit(
    run: Run,
    views: Sequence[View],
    cleared: clearing.Cleared,
    backgrounds: Sequence[Background],
    depths: Sequence[np.ndarray],
    charts: Sequence[Chart],
    fills: Sequence[Fill],
    references: References,
    extent: float,
    settings: FitSettings,
    seed: int,
) -> Representation:
    """Fit the hole to the filled views; gaussians outside it keep their values."""

    def compute(folder: Path) -> None:
        start = cleared.gaussians
        photos = photos_of(views, backgrounds, depths, charts)
        coefficients = start.coefficients
        seeds = [*surfels(charts, coefficients), *seeds_of(views, fills, references, coefficients)]
        seeds = [
            added.select(torch.from_numpy(~refused(added.means.double().numpy(), photos))) for added in seeds
        ]
        if seeds:
            start = start.joined(reduce(Gaussians.joined, seeds))
        result = fit(
            start, targets_of(views, backgrounds, fills), extent, settings, effects=run.effects,
            seed=seed, held=cleared.held(len(start)), surround=stages.shell_of(run),
            checkpoint=folder / "checkpoint.pt", note=run.note,
            progress=True, label="refit",
        )  # fmt: skip
        stages.keep_fit(run, folder, result)

    return stages.fitted(run, "refit", compute)


def _keep(folder: Path, views: Sequence[View], fills: Sequence[Fill]) -> None:
    for view, fill in zip(views, fills, strict=True):
        write_image(folder / f"{view.name}.png", fill.image)
        write_arrays(
            folder / f"{view.name}.npz",
            depth=fill.depth, filled=fill.filled, invented=fill.invented, missing=fill.missing,
        )  # fmt: skip


def read_fills(folder: Path, views: Sequence[View]) -> list[Fill]:
    """Read the fills from the folder of a stage, one a view."""
    fills = []
    for view in views:
        planes = read_arrays(folder / f"{view.name}.npz")
        fills.append(Fill(image=read_picture(folder / f"{view.name}.png"), **planes))
    return fills
