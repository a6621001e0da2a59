"""Masks that no training view has, that cover everything, or that mark all but the object."""

from pathlib import Path

import numpy as np
import pytest
import torch

from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.masks.find import judge_masks
from diga3d_warp.scene.scene import View

HEIGHT, WIDTH = 24, 32


def view(name: str, mask: np.ndarray | None) -> View:
    camera = Camera(WIDTH, HEIGHT, 8.0, 8.0, 4.0, 3.0, torch.eye(4))
    return View(name, camera, np.zeros((HEIGHT, WIDTH, 3), np.uint8), mask)


def box(top: int, bottom: int, left: int, right: int) -> np.ndarray:
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[top:bottom, left:right] = True
    return mask


OBJECT = box(6, 16, 10, 20)


def test_masks_of_held_out_views_only_are_noted():
    _, notes, problem = judge_masks([view("a", None), view("b", None)], Path("masks"))
    assert notes == [] and problem == (
        "masks: the masks are those of held-out views only; add others, or use --hold-out 0"
    )


def test_a_mask_that_covers_everything_is_not_used():
    views = [view("a", OBJECT), view("b", np.ones_like(OBJECT)), view("c", None)]
    kept, notes, problem = judge_masks(views, Path("masks"))
    assert kept[0].mask is views[0].mask and kept[1].mask is None and kept[2].mask is None
    assert any("covers everything" in note and "b" in note for note in notes) and problem is None


@pytest.mark.parametrize(
    ("masks", "said"),
    [
        ([~OBJECT, ~OBJECT], "the masks cover 87 % of the images and most of their borders, as if inverted"),
        ([~box(10, 12, 10, 12), ~OBJECT], "as if inverted"),
        ([~box(2, 22, 6, 26), ~box(2, 22, 4, 28)], "as if inverted"),  # large objects
        ([~box(0, 8, 0, 8), ~box(4, 20, 8, 32), ~OBJECT], "as if inverted"),  # objects at the border
        ([np.zeros_like(OBJECT)] * 2, "every mask is empty"),
        ([np.ones_like(OBJECT)] * 2, "every mask covers its whole image"),
    ],
)
def test_masks_of_no_use(masks, said):
    views = [view(str(index), mask) for index, mask in enumerate(masks)]
    kept, notes, problem = judge_masks(views, Path("masks"))
    assert problem is not None and said in problem and problem.startswith("masks: ") and "\n" not in problem
    assert notes == [] and all(view.mask is None for view in kept)


@pytest.mark.parametrize(
    "mask",
    [
        box(0, 24, 0, 20),  # a large object that leaves the image on three sides
        box(2, 22, 2, 30),
        box(0, 24, 12, 16),  # thin, from border to border
        box(0, 1, 0, 32),
        box(10, 24, 0, 32),  # a floor from side to side
        box(0, 8, 0, 8) | box(16, 24, 24, 32),  # two objects in corners
    ],
)
def test_large_thin_and_touching_objects_are_objects(mask):
    kept, notes, problem = judge_masks([view("a", mask), view("b", OBJECT)], Path("masks"))
    assert problem is None and notes == [] and kept[0].mask is mask


def test_a_note_on_many_views_stays_short():
    views = [view(f"view_{index:04d}", OBJECT if index == 0 else None) for index in range(1200)]
    _, (note,), _ = judge_masks(views, Path("masks"))
    assert note.startswith("1199 views have no mask: view_0001") and len(note) < 200
