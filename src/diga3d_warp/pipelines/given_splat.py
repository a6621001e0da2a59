"""A splat that the capture came with: how much of the photographs it shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.propagation.unseen import OPAQUE
from diga3d_warp.scene.scene import Scene
from diga3d_warp.splatting.render import render


@dataclass(frozen=True)
class WholeSettings:
    """When a splat counts as whole.

    Attributes:
        views: Photographs that it is rendered for, spread over the capture.
        side: Longer side of these renders [px]: only large gaps matter.
        alpha: Opacity below which a pixel is empty [1].
        empty: Share of empty pixels from which it is said [1]. Fitted splats leave less than a hundredth;
            those that were cropped, or whose sky was taken out, leave more.
    """

    views: int = 6
    side: int = 192
    alpha: float = 0.5
    empty: float = 0.05


WHOLE = WholeSettings()


def left_empty(scene: Scene, gaussians: Gaussians, settings: WholeSettings = WHOLE) -> float:
    """Share of the photographs' opaque pixels at which a splat is empty [1]."""
    import cv2

    count = min(settings.views, len(scene.views))
    empty = pixels = 0
    for number in np.linspace(0, len(scene.views) - 1, count).round().astype(int):
        view = scene.views[number]
        camera = view.camera.within(settings.side)
        with torch.no_grad():
            alpha = render(gaussians, camera).alpha.numpy()
        shown = (
            cv2.resize(view.opacity, (camera.width, camera.height), interpolation=cv2.INTER_AREA) >= OPAQUE
        )
        empty += int((shown & (alpha < settings.alpha)).sum())
        pixels += int(shown.sum())
    return empty / max(pixels, 1)


def what_is_missing(scene: Scene, name: str, gaussians: Gaussians) -> str | None:
    """A note for a splat that leaves much of the photographs empty; None for one that shows them.

    A file may be cut short where nothing in it tells: a .splat holds rows without their number.
    """
    share = left_empty(scene, gaussians)
    if share < WHOLE.empty:
        return None
    return (
        f"{name} leaves {100.0 * share:.0f} % of the photographs empty: it was cropped, or its file is cut "
        "short; if it should show more, export it again"
    )
