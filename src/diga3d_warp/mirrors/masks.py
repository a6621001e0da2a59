"""Where views show the mirror image, and which gaussians stand for it."""

from __future__ import annotations

import numpy as np
import torch

from diga3d_warp.gaussians.lift import LiftSettings, Votes, object_rows
from diga3d_warp.gaussians.representation import Representation
from diga3d_warp.mirrors.comparing import stands_before
from diga3d_warp.mirrors.find import Mirror
from diga3d_warp.mirrors.reflection import Reflection
from diga3d_warp.mirrors.settings import MIRRORS, MirrorSettings
from diga3d_warp.scene.camera import Camera


def mirror_mask(
    mirror: Mirror, image: Reflection, camera: Camera, depth: np.ndarray, settings: MirrorSettings = MIRRORS
) -> np.ndarray:
    """Where a view shows the mirror image: the mirrored object, as far as the support goes, (H, W), bool.

    Args:
        mirror: The support.
        image: The mirrored object in the view.
        camera: Of the view.
        depth: z of the scene without the object [scene units], shape (H, W); 0 where nothing is known.
        settings: What counts as shown, and as standing before it.
    """
    import cv2

    column, row, z = mirror.frame.meet(camera)
    x, y = (np.where(np.isfinite(each), each, -9.0).astype(np.float32) for each in (column, row))
    on = cv2.remap(mirror.surface.astype(np.float32), x, y, cv2.INTER_LINEAR, borderValue=0.0) > 0.5
    above = float(mirror.frame.coordinates(camera.center)[2])
    z = np.where(np.isfinite(z), z, 1.0)
    before = stands_before(depth, z, above, mirror.height, settings)
    return np.asarray((image.cover > settings.shown) & on & ~before & (above > 0.0))


def mirrored_rows(
    gaussians: Representation, mirror: Mirror, votes: Votes, lift: LiftSettings
) -> torch.Tensor:
    """Which gaussians the fit has put under the support to show the mirror image, shape (N,), bool.

    Args:
        gaussians: N gaussians or anchors, those of the object among them or not.
        mirror: The support.
        votes: Their weights in the masks of the mirror image.
        lift: When a gaussian belongs to what is masked.
    """
    local = mirror.frame.coordinates(gaussians.means.double().numpy())
    under = local[:, 2] < -mirror.floor
    return object_rows(votes, lift) & torch.from_numpy(under)
