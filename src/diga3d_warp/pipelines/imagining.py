"""Stages of replace by free text: inpaint the new object in every view, estimate its depth, fit to both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path
from typing import TypedDict

import numpy as np
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.files import to_bytes, write_array, write_image, write_json
from diga3d_warp.gaussians.fit import FitSettings, fit
from diga3d_warp.gaussians.initialise import from_image
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.gaussians.representation import Representation
from diga3d_warp.gaussians.surround import render_before
from diga3d_warp.gaussians.target import Target
from diga3d_warp.objects.surface import Sight
from diga3d_warp.perception.depth import DepthEstimator
from diga3d_warp.pipelines import stages
from diga3d_warp.pipelines.coarse import SEEDS_PER_REFERENCE
from diga3d_warp.pipelines.free_text import FreeText
from diga3d_warp.pipelines.run import Run, sampling_bar, say
from diga3d_warp.priors.editing import edit_views
from diga3d_warp.propagation.references import References
from diga3d_warp.scene.scene import View
from diga3d_warp.state import read_array, read_picture, read_state

MEASURED = "measured.json"


class Measured(TypedDict):
    """In `MEASURED`: for each view, whether its depth was estimated."""

    measured: list[bool]


@dataclass(frozen=True, eq=False)
class Imagined:
    """A view with the new object in it.

    Attributes:
        view: Camera, and opacity of the photograph.
        mask: The edit mask of the old object, within which the new one is, shape (H, W), bool.
        image: RGB in [0, 1], shape (H, W, 3), float32.
        depth: First guess of z [scene units], shape (H, W), float32; 0 where there is none.
        measured: Whether the depth was estimated from the image. If not, it is that of the old object.
    """

    view: View
    mask: np.ndarray
    image: np.ndarray
    depth: np.ndarray
    measured: bool

    @property
    def target(self) -> Target:
        """Target of the fit: colours, and the depth where it was estimated from the new object.

        A prior has no alpha channel: what it generates is opaque.
        """
        depth = torch.from_numpy(self.depth) if self.measured else None
        image = torch.from_numpy(to_bytes(self.image))
        alpha = self.view.alpha
        if alpha is not None:
            alpha = np.where(self.mask, np.uint8(255), alpha)
        return Target(
            self.view.camera, image, depth=depth, relative_depth=self.measured, alpha=stages.tensor_of(alpha)
        )


def imagine(
    run: Run,
    views: Sequence[View],
    edit_masks: Sequence[np.ndarray],
    sights: Sequence[Sight],
    cleared: Representation,
    references: References,
    words: FreeText,
    seed: int,
) -> list[np.ndarray]:
    """The coarse images: every view with the new object where the old one's mask is (paper Sec. 3.3).

    Sampling starts from the inverted views with the old object, so the new one takes over its pose and light.
    It follows no edges and no depth: they would be the old object's. Around the mask the images show the
    cleared scene, to which the new object is added; the removal may have changed a little there.
    """

    def compute(folder: Path) -> None:
        masks = [torch.from_numpy(mask) for mask in edit_masks]
        images = [
            torch.where(mask[..., None], torch.from_numpy(sight.image), _seen(run, cleared, view)[0])
            for mask, sight, view in zip(masks, sights, views, strict=True)
        ]
        imagined = edit_views(
            words.prior,
            images,
            masks,
            words.guidance,
            words.sampling,
            references=references.indices,
            inverted=words.inverted,
            seed=seed,
            say=say,
            progress=sampling_bar("imagine"),
        )
        for view, image in zip(views, imagined, strict=True):
            write_image(folder / f"{view.name}.png", image.numpy())

    folder = run.stage("imagine", compute)
    return [read_picture(folder / f"{view.name}.png") for view in views]


def measure(
    run: Run,
    views: Sequence[View],
    edit_masks: Sequence[np.ndarray],
    sights: Sequence[Sight],
    images: Sequence[np.ndarray],
    cleared: Representation,
    estimator: DepthEstimator | None,
) -> list[Imagined]:
    """Depth of the coarse images: estimated and aligned to the scene around (paper Sec. 3.5).

    Without an estimator, or where its estimate contradicts the scene, the old object's depth initialises the
    gaussians, and the fit has no depth loss.
    """

    def compute(folder: Path) -> None:
        measured = []
        for view, mask, sight, image in zip(views, edit_masks, sights, images, strict=True):
            behind = _seen(run, cleared, view)[1]
            depth = None if estimator is None else _estimated(run, view, mask, image, behind, estimator)
            measured.append(depth is not None)
            if depth is None:
                depth = np.where(sight.mask, sight.depth, behind.numpy())
            write_array(folder / f"{view.name}.npy", depth.astype(np.float32))
        write_json(folder / MEASURED, {"measured": measured})

    folder = run.stage("measure", compute)
    measured = read_state(folder / MEASURED, Measured)["measured"]
    return [
        Imagined(view, mask, image, read_array(folder / f"{view.name}.npy"), known)
        for view, mask, image, known in zip(views, edit_masks, images, measured, strict=True)
    ]


def grow(
    run: Run,
    cleared: Representation,
    imagined: Sequence[Imagined],
    references: References,
    extent: float,
    settings: FitSettings,
    seed: int,
) -> Representation:
    """Gaussians where the references show the new object, fitted to all views; the scene stays.

    Args:
        run: Run folder that receives the stage.
        cleared: The scene without the old object.
        imagined: The views.
        references: Those of which pixels become gaussians.
        extent: Extent of the scene [scene units].
        settings: Iterations, budget and learning rates of the fit.
        seed: Seed of the fit.
    """

    def compute(folder: Path) -> None:
        chosen = [imagined[index] for index in references.indices]
        seeds = [
            from_image(
                each.image, each.depth, each.mask, each.view.camera, cleared.coefficients, SEEDS_PER_REFERENCE
            )
            for each in chosen
        ]
        start = cleared.joined(reduce(Gaussians.joined, seeds))
        result = fit(
            start, [each.target for each in imagined], extent, settings, effects=run.effects, seed=seed,
            held=torch.arange(len(start)) < len(cleared),
            surround=stages.shell_of(run),
            checkpoint=folder / "checkpoint.pt", note=run.note,
            progress=True, label="grow",
        )  # fmt: skip
        stages.keep_fit(run, folder, result)

    return stages.fitted(run, "grow", compute)


def _seen(run: Run, cleared: Representation, view: View) -> tuple[torch.Tensor, torch.Tensor]:
    """Colour (H, W, 3) and z (H, W) of the cleared scene in a view."""
    effects = replace(run.effects, depth=True)
    rendering = render_before(stages.shell_of(run), cleared, view.camera, effects)
    return rendering.color.clamp(0.0, 1.0), rendering.depth


def _estimated(
    run: Run, view: View, mask: np.ndarray, image: np.ndarray, behind: torch.Tensor, estimator: DepthEstimator
) -> np.ndarray | None:
    """z of a coarse image [scene units], shape (H, W), or None where the estimate is of no use."""
    try:
        return estimator.aligned(torch.from_numpy(image), behind, torch.from_numpy(~mask)).numpy()
    except InputError as error:
        run.note(f"{view.name}: {error}; the old object's depth stands in")
        return None
