"""The stage that finds the shadow of the object on its support."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TypedDict

import numpy as np
import torch

from diga3d_warp.effects.plan import Choice, EffectsPlan
from diga3d_warp.effects.shadow import choose_shadow
from diga3d_warp.evaluation.record import EffectsRecord
from diga3d_warp.files import write_array, write_arrays, write_image, write_json
from diga3d_warp.gaussians.lift import LiftSettings, object_mask
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.pipelines.charting import frame_arrays, frame_of
from diga3d_warp.pipelines.clearing import Masks, MaskSettings, read_masks, widened
from diga3d_warp.pipelines.run import Run, say
from diga3d_warp.pipelines.stages import PLAN
from diga3d_warp.propagation.unseen import OPAQUE
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.scene import Scene, View
from diga3d_warp.shadows.find import Shadow, find_shadow
from diga3d_warp.shadows.picture import shadow_picture
from diga3d_warp.shadows.settings import SHADOWS
from diga3d_warp.shadows.support import Solid, find_support, on_floor
from diga3d_warp.splatting.render import render
from diga3d_warp.state import read_array, read_arrays, read_state
from diga3d_warp.surfaces.evidence import gather
from diga3d_warp.surfaces.photo import Photo
from diga3d_warp.surfaces.planes import find_planes, mean_eye
from diga3d_warp.surfaces.settings import SURFACES

PICTURE = "shadow.png"
"""The support before and after, and the share of the light between, in the run folder."""

SEARCH = replace(SURFACES, points=9000, trials=200, planes=3)
"""Search of the support: it holds a large part of what is around the object, so fewer points find it."""


class ShadeRecord(TypedDict):
    """What was found.

    Attributes:
        choice: As `effects.plan.Choice`.
        masked: Whether masks held the shadow.
    """

    choice: dict
    masked: bool


@dataclass(frozen=True, eq=False)
class Shade:
    """What goes with the object besides its gaussians.

    Attributes:
        rows: The object's gaussians, without support that masks held with the shadow, shape (N,), bool.
        edit_masks: Edit masks of all views, without that support.
        shadow: The shadow; None if the object casts none that shows.
    """

    rows: torch.Tensor
    edit_masks: Masks
    shadow: Shadow | None


def find_shade(
    run: Run, scene: Scene, edit_masks: Masks, source: Gaussians, rows: torch.Tensor,
    lift: LiftSettings, masking: MaskSettings, wish: bool | None, seed: int, *, filled: bool = False,
) -> Shade:  # fmt: skip
    """Find the shadow of the object, and part masks that hold it.

    Args:
        run: Run folder that receives the stage, the choice and a picture.
        scene: The capture.
        edit_masks: Of all views.
        source: The splat, N gaussians.
        rows: Those of the object, shape (N,).
        lift: Where the object's gaussians are in the way.
        masking: Dilation of the masks.
        wish: Whether the user insists on a shadow.
        seed: Of random choices.
        filled: Whether the user filled views, which show shadows as they should be.
    """
    if filled and wish is None:
        _record(
            run,
            Choice(
                "shadow",
                False,
                "not looked for: fills are given, which show shadows as they should be",
                "task",
            ),
        )
    if not run.effects.shadow:
        return Shade(rows, edit_masks, None)
    views = [*scene.views, *scene.test_views]

    def compute(folder: Path) -> None:
        solid = _solid(source.select(rows))
        chosen = _spread(scene.views)
        small = [_small(view.camera) for view in chosen]
        masks = [_resized(edit_masks[view.name], camera) for view, camera in zip(chosen, small, strict=True)]
        photos = _photos(run, chosen, small, masks, source.select(~rows))
        planes = find_planes(
            gather(photos, scene.points.positions, seed, SEARCH), mean_eye(small), seed, SEARCH
        )
        support = find_support(solid, planes, small)
        found, held = None, torch.zeros_like(rows)
        if support is not None:
            held[rows] = torch.from_numpy(on_floor(solid, support))
            if held.any():
                own = rows & ~held
                masks = [
                    mask & _about(source, camera, own, lift, masking, run)
                    for mask, camera in zip(masks, small, strict=True)
                ]
                photos = _photos(run, chosen, small, masks, source.select(~own))
            found = find_shadow(photos, _solid(source.select(rows & ~held)), support, seed)
        choice = choose_shadow(found[1] if found else None, wish)
        parted = choice.value and bool(held.any())
        if found and choice.value:
            shadow, _, chart = found
            arrays = {"ratio": shadow.ratio, "floor": np.array(shadow.floor)}
            write_arrays(folder / "shadow.npz", **arrays, **frame_arrays(shadow.frame))
            write_image(folder / PICTURE, shadow_picture(chart, shadow))
        if parted:
            own = rows & ~held
            for view in views:
                kept = edit_masks[view.name] & _about(source, view.camera, own, lift, masking, run)
                write_image(folder / "masks" / f"{view.name}.png", kept)
            write_array(folder / "object.npy", own)
        write_json(folder / "shade.json", {"choice": asdict(choice), "masked": parted})

    folder = run.stage("shadow", compute)
    record = read_state(folder / "shade.json", ShadeRecord)
    choice = Choice(**record["choice"])
    _record(run, choice)
    if record["masked"]:
        run.note("the masks hold the object's shadow: it is relit, and only the object itself is taken out")
        rows = torch.from_numpy(read_array(folder / "object.npy"))
        edit_masks = read_masks(folder / "masks", views)
    if not choice.value:
        return Shade(rows, edit_masks, None)
    run.publish(folder / PICTURE, PICTURE)
    arrays = read_arrays(folder / "shadow.npz")
    return Shade(rows, edit_masks, Shadow(frame_of(arrays), arrays["ratio"], float(arrays["floor"])))


def _record(run: Run, choice: Choice) -> None:
    data = read_state(run.folder / "stages" / "effects" / PLAN, EffectsRecord)
    plan = EffectsPlan.from_json(data).replaced(choice)
    run.effects = replace(run.effects, shadow=bool(choice.value))
    run.record("effects", plan.as_json())
    say(f"shadow: {'relit' if choice.value else 'none'} ({choice.evidence})")


def _solid(gaussians: Gaussians) -> Solid:
    return Solid(
        gaussians.means.double().numpy(),
        np.sort(gaussians.scales.numpy(), axis=1)[:, 1],
        gaussians.opacities.numpy(),
    )


def _spread(views: Sequence[View]) -> list[View]:
    count = min(SHADOWS.views, len(views))
    return [views[row] for row in np.linspace(0, len(views) - 1, count).round().astype(int)]


def _small(camera: Camera) -> Camera:
    scale = min(1.0, SHADOWS.side / max(camera.width, camera.height))
    return camera.resized(max(1, round(camera.width * scale)), max(1, round(camera.height * scale)))


def _resized(mask: np.ndarray, camera: Camera) -> np.ndarray:
    """A mask at the size of a camera: whatever it touches."""
    import cv2

    size = (camera.width, camera.height)
    return cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.0


def _photos(
    run: Run, views: Sequence[View], cameras: Sequence[Camera], masks: Sequence[np.ndarray], left: Gaussians
) -> list[Photo]:
    import cv2

    photos = []
    for view, camera, mask in zip(views, cameras, masks, strict=True):
        with torch.no_grad():
            seen = render(left, camera, effects=replace(run.effects, depth=True))
        depth = np.where(seen.alpha.numpy() > 0.5, seen.depth.numpy(), 0.0).astype(np.float32)
        size = (camera.width, camera.height)
        pixels = cv2.resize(view.pixels, size, interpolation=cv2.INTER_AREA)
        opaque = cv2.resize(view.opacity, size, interpolation=cv2.INTER_AREA) >= OPAQUE
        photos.append(Photo(camera, pixels, depth, ~mask & opaque, mask))
    return photos


def _about(
    source: Gaussians, camera: Camera, own: torch.Tensor, lift: LiftSettings, masking: MaskSettings, run: Run
) -> np.ndarray:
    """Where a view shows the object itself, and as far around as masks are widened, twice over."""
    shown = object_mask(source, camera, own, lift, run.effects)
    return widened(widened(shown, masking), masking)
