"""Masks from boxes: the object in a box by its colours (GrabCut, Rother et al. 2004, in OpenCV)."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from diga3d_warp.errors import InputError
from diga3d_warp.scene.photographs.decoding import turned
from diga3d_warp.scene.photographs.orientation import inverse
from diga3d_warp.scene.scene import Scene, View

BOXES_MOST = 3
"""Boxes of a run: one shows the object, two more from other sides show its back."""


WIDE = 0.7
"""Part of a view from which on a box is noted: it holds little else to compare the object with."""


@dataclass(frozen=True)
class Box:
    """A box around the object in one view.

    Attributes:
        view: Name of the view, with or without the ending of its file.
        left, top, right, bottom: Edges [px], right and bottom not included; of the photograph as viewers show
            it, which its EXIF orientation may turn.
    """

    view: str
    left: int
    top: int
    right: int
    bottom: int


@dataclass(frozen=True)
class CutSettings:
    """Settings of GrabCut.

    Attributes:
        rounds: Rounds of colour models and graph cut. OpenCV's samples use 5; later ones change little.
        margin: Surroundings that colours are compared with [box sizes]: what lies further off says little
            of what is next to the object.
        part: Parts of a mask, and holes in it, that are smaller than this share of it are noise.
        core: Radius of the middle that is taken for the object [box sizes]. Without, a box around an object
            of several colours leaves all of it to the background.
        beyond: How much larger than that middle a mask must be: it then grew to some edge.
        side: Longer side of the window at which it is cut [px]. The graph cut of a 512 px window takes 4 s,
            and what it gains in sharpness the widening of masks covers; in a window of 60 px, the smoothness
            of the cut would outweigh the colours of a small object.
        seed: Of OpenCV's random numbers, which start the colour models.
    """

    rounds: int = 5
    margin: float = 0.6
    part: float = 0.05
    core: float = 0.3
    beyond: float = 1.15
    side: int = 320
    seed: int = 0


CUT = CutSettings()


def read_boxes(words: Sequence[Sequence[str]]) -> list[Box]:
    """Boxes as they are given on the command line: VIEW X0 Y0 X1 Y1 each.

    Raises:
        InputError: an edge is no whole number.
    """
    boxes = []
    for view, *edges in words:
        if not all(re.fullmatch(r"-?\d+", edge) for edge in edges):
            given = " ".join(edges)
            raise InputError(f"mask box of view {view!r}: {given!r} are not four whole numbers of pixels")
        boxes.append(Box(view, *map(int, edges)))
    return boxes


class Boxed(NamedTuple):
    """Boxes that were found.

    Attributes:
        boxes: By the name of their view, on its pixels.
        notes: How boxes were read that say little, or are of views that viewers turn, one line each.
    """

    boxes: dict[str, Box]
    notes: list[str]


def find_boxed(boxes: Sequence[Box], scene: Scene) -> Boxed:
    """The boxes by the name of their view.

    Raises:
        InputError: there are too many boxes, two in one view, an unknown view or one that is held out, or a
            box that is empty or not within its image.
    """
    if len(boxes) > BOXES_MOST:
        raise InputError(f"{len(boxes)} mask boxes: give at most {BOXES_MOST}, each in another view")
    held_out = {view.name: view for view in scene.test_views}
    views = {view.name: view for view in scene.views} | held_out
    found: dict[str, Box] = {}
    notes: list[str] = []
    for box in boxes:
        name = box.view if box.view in views else box.view.rpartition(".")[0]
        if name not in views:
            raise InputError(
                f"mask box: there is no view {box.view!r} in {scene.path}; the first is {next(iter(views))!r}"
            )
        if name in held_out:
            raise InputError(
                f"mask box: view {name!r} is kept for testing, and edits look at the others only: "
                "box another view, or use --hold-out 0"
            )
        if name in found:
            raise InputError(f"mask box: view {name!r} has two; give one box a view, around the whole object")
        view, edges = views[name], f"{box.left} {box.top} {box.right} {box.bottom}"
        height, width = _shown(view)
        if _is_within(box, height, width):
            found[name], meant = _as_stored(box, view), "viewers show it"
        elif view.orientation != 1 and _is_within(box, *view.pixels.shape[:2]):
            found[name], meant = box, "it is stored, where alone it fits"
        else:
            raise InputError(
                f"mask box {edges} of view {name!r} is not within its {width} x {height} px: give "
                f"X0 Y0 X1 Y1 with 0 <= X0 < X1 <= {width} and 0 <= Y0 < Y1 <= {height}"
            )
        if view.orientation != 1:
            notes.append(
                f"view {name} is kept as it is stored, not turned as EXIF says; mask box {edges} is taken "
                f"for one of the photograph as {meant}"
            )
        if (box.right - box.left) * (box.bottom - box.top) > WIDE * height * width:
            notes.append(
                f"mask box {edges} covers most of view {name}: the object is what stands out in its middle, "
                "as the mask sheet shows; a closer box finds it better"
            )
    return Boxed(found, notes)


def _shown(view: View) -> tuple[int, int]:
    """Height and width of a photograph as viewers show it [px]."""
    height, width = view.pixels.shape[:2]
    return (width, height) if view.orientation >= 5 else (height, width)


def _is_within(box: Box, height: int, width: int) -> bool:
    return 0 <= box.left < box.right <= width and 0 <= box.top < box.bottom <= height


def _as_stored(box: Box, view: View) -> Box:
    """A box of a photograph as viewers show it, on the pixels of its view."""
    area = np.zeros(_shown(view), bool)
    area[box.top : box.bottom, box.left : box.right] = True
    area = turned(area, inverse(view.orientation))
    rows, columns = np.flatnonzero(area.any(1)).tolist(), np.flatnonzero(area.any(0)).tolist()
    return replace(box, left=columns[0], top=rows[0], right=columns[-1] + 1, bottom=rows[-1] + 1)


def cut_out(view: View, box: Box) -> np.ndarray:
    """The object in a box, shape (H, W), bool.

    Raises:
        InputError: the colours in the box do not differ from those around it.
    """
    import cv2

    height, width = view.pixels.shape[:2]
    kinds = np.full((height, width), cv2.GC_BGD, np.uint8)
    core = _core(box, kinds.shape)
    kinds[box.top : box.bottom, box.left : box.right] = cv2.GC_PR_FGD
    kinds[core] = cv2.GC_FGD
    mask = _cut(view.pixels, kinds, box)
    if mask.sum() < CUT.beyond * core.sum():
        raise InputError(
            f"mask box of view {box.view!r}: no object stands out by its colours; draw the box closer around "
            "it, choose another view, or give masks with --masks"
        )
    return mask


def _core(box: Box, shape: tuple[int, ...]) -> np.ndarray:
    """The middle of a box, which almost always shows the object, shape (H, W), bool."""
    y, x = np.mgrid[: shape[0], : shape[1]] + 0.5
    across = (x - 0.5 * (box.left + box.right)) / (box.right - box.left)
    down = (y - 0.5 * (box.top + box.bottom)) / (box.bottom - box.top)
    return np.hypot(across, down) < CUT.core


def cut_along(pixels: np.ndarray, surely: np.ndarray, likely: np.ndarray, reach: int) -> np.ndarray:
    """The object in a view of which a rough mask is known, shape (H, W), bool.

    Args:
        pixels: RGB, shape (H, W, 3), uint8.
        surely: Certain foreground, shape (H, W), bool.
        likely: Possible foreground, shape (H, W), bool; includes `surely`.
        reach: Distance beyond `likely` up to which pixels may be foreground [px].

    Returns:
        The mask; `likely` itself where there is too little of it to compare colours.
    """
    import cv2

    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    near = cv2.dilate(likely.astype(np.uint8), disc) > 0
    kinds = np.full(likely.shape, cv2.GC_BGD, np.uint8)
    kinds[near], kinds[likely], kinds[surely] = cv2.GC_PR_BGD, cv2.GC_PR_FGD, cv2.GC_FGD
    rows, columns = np.flatnonzero(near.any(1)), np.flatnonzero(near.any(0))
    if likely.sum() < 25 or near.all():
        return likely
    box = Box("", int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1)
    return _cut(pixels, kinds, box)


def _without_holes(mask: np.ndarray) -> np.ndarray:
    """A mask without holes that are small against it: spots of another colour on the object."""
    import cv2

    _, label, stats, _ = cv2.connectedComponentsWithStats((~mask).astype(np.uint8), connectivity=4)
    small = stats[:, cv2.CC_STAT_AREA] < CUT.part * mask.sum()
    small[0] = False
    return mask | small[label]


def _cut(pixels: np.ndarray, kinds: np.ndarray, box: Box) -> np.ndarray:
    """GrabCut from a first guess `kinds` (H, W) in a window around a box; small parts are left out."""
    import cv2

    pad_x, pad_y = (int(CUT.margin * edge) + 4 for edge in (box.right - box.left, box.bottom - box.top))
    window = (
        slice(max(box.top - pad_y, 0), box.bottom + pad_y),
        slice(max(box.left - pad_x, 0), box.right + pad_x),
    )
    found = np.zeros(kinds.shape, bool)
    guess, image = kinds[window], pixels[window]
    full = (guess.shape[1], guess.shape[0])
    scale = CUT.side / max(full)
    size = (max(1, round(full[0] * scale)), max(1, round(full[1] * scale)))
    guess = cv2.resize(guess, size, interpolation=cv2.INTER_NEAREST)
    image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)[..., ::-1].copy()
    if not (guess == cv2.GC_BGD).any():  # a box over all of the image: its rim must do
        guess[[0, -1]] = guess[:, [0, -1]] = cv2.GC_BGD
    cv2.setRNGSeed(CUT.seed)
    models = np.zeros((1, 65)), np.zeros((1, 65))
    cv2.grabCut(image, guess, (0, 0, 0, 0), *models, CUT.rounds, cv2.GC_INIT_WITH_MASK)
    inside = ((guess == cv2.GC_FGD) | (guess == cv2.GC_PR_FGD)).astype(np.float32)
    cut = (cv2.resize(inside, full, interpolation=cv2.INTER_LINEAR) > 0.5).astype(np.uint8)
    cut = cv2.morphologyEx(cut, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    count, label, stats, _ = cv2.connectedComponentsWithStats(cut, connectivity=4)
    area = stats[:, cv2.CC_STAT_AREA]
    keep = area >= CUT.part * area[1:].sum() if count > 1 else np.zeros(1, bool)
    keep[0] = False
    found[window] = _without_holes(keep[label])
    return found
