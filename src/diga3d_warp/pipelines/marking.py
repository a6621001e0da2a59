"""Marks of the object: the capture's own masks, boxes in a few views, or a prompt (the paper's T_m).

Boxes and prompts give masks in some views; `mask_propagation` extends them to all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.files import write_image
from diga3d_warp.perception.boxes import Box, cut_out, find_boxed, read_boxes
from diga3d_warp.perception.segmentation import TextSegmenter, locate_models, mask_words
from diga3d_warp.pipelines.run import Run
from diga3d_warp.scene.photographs.decoding import turned
from diga3d_warp.scene.photographs.orientation import inverse
from diga3d_warp.scene.scene import Scene, View
from diga3d_warp.state import read_mask


@dataclass(frozen=True)
class Words:
    """A prompt that names the object.

    Attributes:
        prompt: Such as "a watering can"; several objects are separated by full stops.
        models: Folder that holds `detector` and `cutter`; the Hugging Face cache if None.
    """

    prompt: str
    models: Path | None = None

    def segmenter(self) -> TextSegmenter:
        """Load the models; not cached, since they are large and one stage needs them.

        Raises:
            InputError: weights or libraries are missing, or broken.
        """
        return TextSegmenter.load(*locate_models(self.models), device="auto")


@dataclass(frozen=True)
class Marks:
    """How the object is marked: by boxes or a prompt; by the capture's own masks if both are empty.

    Attributes:
        boxes: Boxes around the object in up to three views.
        words: The prompt.
    """

    boxes: tuple[Box, ...] = ()
    words: Words | None = None

    @property
    def own(self) -> bool:
        """Whether the capture's own masks are used."""
        return not self.boxes and self.words is None

    def settings(self) -> dict[str, Any]:
        """The marks as JSON data for the manifest of a run."""
        return {
            "mask_boxes": [astuple(box) for box in self.boxes],
            "mask_prompt": self.words.prompt if self.words else None,
            "mask_models": self.words.models if self.words else None,
        }


OWN_MASKS = Marks()


def read_marks(
    masks: Path | None,
    mask_boxes: Sequence[Sequence[str]],
    mask_prompt: str | None,
    mask_models: Path | None,
    mask_ids: Sequence[int] = (),
) -> Marks:
    """Marks as they are given on the command line.

    Raises:
        InputError: two of them are given, an edge of a box is no whole number, the prompt is empty, or the
            weights for it are missing.
    """
    given = {"--masks": masks, "--mask-box": mask_boxes or None, "--mask-prompt": mask_prompt}
    names = [name for name, value in given.items() if value is not None]
    if len(names) > 1:
        raise InputError(f"{' and '.join(names)} each say where the object is: give one of them")
    if mask_ids and (mask_boxes or mask_prompt is not None):
        raise InputError(
            "--mask-ids chooses among the objects in masks: leave it out beside a box or a prompt"
        )
    if mask_prompt is None:
        if mask_models is not None:
            raise InputError("--mask-models is read for --mask-prompt only: give what the object is called")
        return Marks(tuple(read_boxes(mask_boxes)))
    mask_words(mask_prompt)
    locate_models(mask_models)
    return Marks(words=Words(mask_prompt, mask_models))


def quick_masks(scene: Scene, marks: Marks) -> Scene:
    """The scene with the masks that are quick to make: of all boxes, or of the first view with a detection.

    Raises:
        InputError: a box or the prompt is not usable, weights are missing or broken, or the prompt is found
            in no view.
    """
    if marks.words is None:
        return _boxed(scene, marks.boxes)
    segmenter = marks.words.segmenter()
    for view in scene.views:
        mask = _segmented(view, segmenter, marks.words.prompt)
        if mask.any():
            return _with_masks(scene, {view.name: mask})
    raise _unseen(scene, marks.words)


def mark(run: Run, scene: Scene, marks: Marks) -> Scene:
    """The scene with masks in the views whose boxes or photographs give them, none in others.

    The prompt is searched for in the training views. Without marks the scene is returned unchanged.

    Raises:
        InputError: as `quick_masks`.
    """
    words = marks.words
    if words is None:
        for note in find_boxed(marks.boxes, scene).notes:
            run.note(note)
        return _boxed(scene, marks.boxes)

    def compute(folder: Path) -> None:
        from tqdm import tqdm

        segmenter, found = words.segmenter(), False
        for view in tqdm(scene.views, "finding the object", unit="view", leave=False):
            file = folder / f"{view.name}.png"
            if not file.exists():  # else a killed attempt found it
                write_image(file, _segmented(view, segmenter, words.prompt))
            found |= bool(read_mask(file).any())
        if not found:
            raise _unseen(scene, words)

    folder = run.stage("find", compute)
    masks = {view.name: read_mask(folder / f"{view.name}.png") for view in scene.views}
    hits = {name: mask for name, mask in masks.items() if mask.any()}
    misses = [name for name in masks if name not in hits]
    if misses:
        run.note(
            f"the mask prompt {words.prompt!r} finds nothing in {len(misses)} of {len(masks)} views, "
            f"which take their masks from the object in 3D: {', '.join(misses)}"
        )
    return _with_masks(scene, hits)


def _boxed(scene: Scene, boxes: Sequence[Box]) -> Scene:
    """The scene with masks in the boxed views only, cut out by colour; as it is if there is no box."""
    if not boxes:
        return scene
    views = {view.name: view for view in scene.views}
    found = find_boxed(boxes, scene).boxes
    return _with_masks(scene, {name: cut_out(views[name], box) for name, box in found.items()})


def _with_masks(scene: Scene, masks: Mapping[str, np.ndarray]) -> Scene:
    """The scene with these masks by the names of their views, and no others."""

    def masked(views: Sequence[View]) -> list[View]:
        return [view.with_mask(masks.get(view.name)) for view in views]

    return replace(scene, views=masked(scene.views), test_views=masked(scene.test_views))


def _segmented(view: View, segmenter: TextSegmenter, prompt: str) -> np.ndarray:
    """What the prompt names in a view, shape (H, W), bool; the models see it upright."""
    upright = torch.from_numpy(turned(view.pixels, view.orientation)).float() / 255.0
    return turned(segmenter.mask(upright, prompt).numpy(), inverse(view.orientation))


def _unseen(scene: Scene, words: Words) -> InputError:
    return InputError(
        f"{scene.path}: no view shows {words.prompt[:60]!r}; "
        "say it in other words, or give --masks or --mask-box"
    )
