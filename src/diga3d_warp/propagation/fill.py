"""Fill the references one after another, and warp their fills to all other views (paper Sec. 3.3, 3.4).

The fills of earlier references are warped into each reference first, and only what is still missing is
inpainted, so that all fills are consistent. Each other view takes its fill from the reference of its cluster,
and from other references what that one does not show.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
import torch

from diga3d_warp.priors.protocol import Prior
from diga3d_warp.propagation.layers import complete_layers, near_layer, surroundings
from diga3d_warp.propagation.references import References
from diga3d_warp.propagation.tone import rim_of, tone_between
from diga3d_warp.propagation.unseen import OPAQUE, Background
from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.reproject import reproject


@dataclass(frozen=True, eq=False)
class Fill:
    """A view without the object.

    Attributes:
        image: RGB, shape (H, W, 3), float32 in [0, 1]: the photograph, what others observed, and the fill.
        depth: z of the fill [scene units], shape (H, W), float32; 0 outside `filled`.
        filled: Unseen pixels that have a fill, shape (H, W), bool.
        invented: The part of `filled` that the prior inpainted in this view, shape (H, W), bool.
        missing: Unseen pixels without a fill, shape (H, W), bool; `image` is not valid there.
    """

    image: np.ndarray
    depth: np.ndarray
    filled: np.ndarray
    invented: np.ndarray
    missing: np.ndarray


def fill_references(
    cameras: Sequence[Camera],
    backgrounds: Sequence[Background],
    depths: Sequence[np.ndarray],
    references: References,
    prior: Prior,
    seed: int,
    *,
    together: bool = True,
    own: Mapping[int, np.ndarray] = MappingProxyType({}),
) -> list[Fill]:
    """Fill the references one after another, in the order given.

    Args:
        cameras: One per view.
        backgrounds: What is known behind the object, one per view.
        depths: z of the splat without the object, one per view, shape (H, W); 0 where it shows nothing.
        references: Which views are references.
        prior: Fills what no view saw.
        seed: Seed of the prior.
        together: Whether the fills of earlier references are warped in first.
        own: Views that the user filled, RGB (H, W, 3), float32 in [0, 1], by index: taken as they are.
    """
    fills: list[Fill] = []
    for index in references.indices:
        if index in own:
            fills.append(_own_fill(own[index], backgrounds[index], depths[index]))
            continue
        earlier = _sources(fills if together else [], cameras, depths, references)
        known = _take(backgrounds[index], cameras[index], earlier)
        invented = known.missing
        image, depth = invent(
            known.image, np.where(known.filled, known.depth, depths[index]), invented, prior, seed,
            alpha=backgrounds[index].alpha,
        )  # fmt: skip
        unseen = known.filled | invented
        surface = np.where(unseen, depth, 0.0).astype(np.float32)
        fills.append(Fill(image, surface, unseen, invented, np.zeros_like(unseen)))
    return fills


def _own_fill(image: np.ndarray, background: Background, depth: np.ndarray) -> Fill:
    """The user's fill where no view saw the background, on the surface that its surroundings continue."""
    hole = background.unseen
    near = near_layer(depth, hole) if hole.any() else None
    surface = np.where(hole, complete_layers(depth, hole, near), 0.0).astype(np.float32)
    shown = np.where(hole[..., None], image, background.image).astype(np.float32)
    return Fill(shown, surface, hole, hole, np.zeros_like(hole))


def invent(
    image: np.ndarray, depth: np.ndarray, hole: np.ndarray, prior: Prior, seed: int,
    alpha: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Inpaint colour and depth of a hole that no view observes.

    Where the object stood on a surface clearly nearer than the background, the two are filled separately,
    each from its own surroundings.

    Args:
        image: RGB, shape (H, W, 3), float32 in [0, 1]. The hole's pixels are not read.
        depth: z along the camera axis [scene units], shape (H, W); 0 where unknown.
        hole: shape (H, W), bool. May be empty.
        prior: Inpaints the colours.
        seed: Seed of the prior.
        alpha: Opacity of the image, shape (H, W), uint8: transparent pixels are not continued into the hole.
            None if the image is opaque everywhere.

    Returns:
        Image and depth, known pixels unchanged, depth positive everywhere.
    """
    near = near_layer(depth, hole) if hole.any() else None
    completed = complete_layers(depth, hole, near)
    if not hole.any():
        return image, completed
    if near is None and alpha is None:
        return _filled(image, hole, completed, prior, seed), completed
    # The nearer surface and transparent pixels count as unknown, too; in the whole image they would be far
    # larger than the hole.
    around = surroundings(hole)
    unknown = hole if near is None else hole | near.front
    if alpha is not None and not (unknown | (alpha < OPAQUE))[around].all():
        unknown = unknown | (alpha < OPAQUE)
    behind = _filled(image[around], unknown[around], completed[around], prior, seed)
    filled = image.copy()
    filled[around] = np.where(hole[around][..., None], behind, image[around])
    if near is None:
        return filled, completed
    window = near.window
    front = _filled(image[window], ~near.surface[window], completed[window], prior, seed)
    filled[window] = np.where(near.part[window][..., None], front, filled[window])
    return filled, completed


def _filled(image: np.ndarray, mask: np.ndarray, depth: np.ndarray, prior: Prior, seed: int) -> np.ndarray:
    colors, missing, behind = (torch.from_numpy(np.ascontiguousarray(a)) for a in (image, mask, depth))
    return prior.fill(colors, missing, seed=seed, depth=behind).numpy()


def warp_fills(
    cameras: Sequence[Camera],
    backgrounds: Sequence[Background],
    depths: Sequence[np.ndarray],
    references: References,
    fills: Sequence[Fill],
) -> list[Fill]:
    """Fill every view: from its cluster's reference, then from the others, adapted to the view's tone.

    Args:
        cameras: One per view.
        backgrounds: One per view.
        depths: z of the splat without the object, one per view, shape (H, W); 0 where it shows nothing.
        references: References and clusters.
        fills: Of the references, in their order.
    """
    sources = _sources(fills, cameras, depths, references)
    warped = []
    for i, (camera, background) in enumerate(zip(cameras, backgrounds, strict=True)):
        if i in references.indices:
            warped.append(fills[references.indices.index(i)])
            continue
        own = int(references.cluster[i])
        order = [own] + [k for k in range(len(fills)) if k != own]
        warped.append(_take(background, camera, [sources[k] for k in order]))
    return warped


@dataclass(frozen=True)
class RestSettings:
    """When what no reference shows is filled in further views.

    Attributes:
        share: Part of a view's unseen pixels that may stay without a fill [1]: rims of a pixel or two between
            the fills of several references, which the fit closes.
        least: The same in pixels.
        views: Further views, at most; each takes as long as a reference.
    """

    share: float = 0.05
    least: int = 16
    views: int = 3


REST = RestSettings()


def fill_rest(
    cameras: Sequence[Camera],
    backgrounds: Sequence[Background],
    depths: Sequence[np.ndarray],
    fills: Sequence[Fill],
    prior: Prior,
    seed: int,
    settings: RestSettings = REST,
) -> list[Fill]:
    """Fill what no reference shows in the view that misses most, and warp it to the others; again until
    little is missing.

    Args:
        cameras: One per view.
        backgrounds: One per view.
        depths: z of the splat without the object, one per view, shape (H, W); 0 where it shows nothing.
        fills: From `warp_fills`.
        prior: Fills what is missing.
        seed: Seed of the prior.
        settings: When little is missing.
    """
    found = list(fills)
    for _ in range(settings.views):
        most = max(range(len(found)), key=lambda i: int(found[i].missing.sum()))
        missing = found[most].missing
        if missing.sum() < max(settings.share * backgrounds[most].unseen.sum(), settings.least):
            break
        at = found[most]
        image, depth = invent(
            at.image, np.where(at.filled, at.depth, depths[most]), missing, prior, seed,
            alpha=backgrounds[most].alpha,
        )  # fmt: skip
        surface = np.where(at.filled | missing, depth, 0.0).astype(np.float32)
        found[most] = Fill(image, surface, at.filled | missing, at.invented | missing, np.zeros_like(missing))
        alone = replace(found[most], depth=np.where(missing, surface, 0.0), filled=missing)
        rim = np.where(rim_of(missing), np.where(at.filled, at.depth, depths[most]), 0.0).astype(np.float32)
        source = _Source(alone, rim, cameras[most])
        for i, (camera, background) in enumerate(zip(cameras, backgrounds, strict=True)):
            if found[i].missing.any():
                left = replace(background, image=found[i].image, unseen=found[i].missing)
                more = _take(left, camera, [source])
                found[i] = Fill(
                    more.image, np.where(more.filled, more.depth, found[i].depth),
                    found[i].filled | more.filled, found[i].invented, more.missing,
                )  # fmt: skip
    return found


@dataclass(frozen=True, eq=False)
class _Source:
    """A filled reference that other views take from.

    Attributes:
        fill: The filled reference.
        rim: z of the known surface around the fill [scene units], shape (H, W); 0 elsewhere.
        camera: Camera of the reference.
    """

    fill: Fill
    rim: np.ndarray
    camera: Camera


def _sources(
    fills: Sequence[Fill], cameras: Sequence[Camera], depths: Sequence[np.ndarray], references: References
) -> list[_Source]:
    sources = []
    for fill, index in zip(fills, references.indices, strict=False):
        rim = np.where(rim_of(fill.filled), depths[index], 0.0).astype(np.float32)
        sources.append(_Source(fill, rim, cameras[index]))
    return sources


def _take(background: Background, camera: Camera, sources: Sequence[_Source]) -> Fill:
    """What the sources' fills show in the unseen part of a view, the first source first."""
    image = background.image.astype(np.float32).copy()
    depth = np.zeros(image.shape[:2], np.float32)
    missing = background.unseen.copy()
    for source in sources:
        if not missing.any():
            break
        colors = torch.from_numpy(source.fill.image)
        warp = reproject(colors, torch.from_numpy(source.fill.depth), source.camera, camera)
        around = reproject(colors, torch.from_numpy(source.rim), source.camera, camera)
        taken = missing & warp.visible.numpy()
        rim = around.visible.numpy() & ~background.unseen
        tone = tone_between(background.image, around.image.numpy(), rim, taken)
        image[taken] = np.clip(warp.image.numpy() + tone, 0.0, 1.0)[taken]
        depth[taken] = warp.depth.numpy()[taken]
        missing &= ~taken
    return Fill(image, depth, background.unseen & ~missing, np.zeros_like(missing), missing)
