"""Masks that no training view has, or that cover everything in some views."""

from pathlib import Path

import numpy as np
import torch

from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.masks import mask_notes, without_covering
from diga3d_warp.scene.scene import View


def view(name: str, mask: np.ndarray | None) -> View:
    camera = Camera(8, 6, 8.0, 8.0, 4.0, 3.0, torch.eye(4))
    return View(name, camera, np.zeros((6, 8, 3), np.uint8), mask)


def object_mask() -> np.ndarray:
    mask = np.zeros((6, 8), bool)
    mask[2:4, 3:5] = True
    return mask


def test_masks_of_held_out_views_only_are_noted():
    (note,) = mask_notes([view("a", None), view("b", None)], Path("masks"))
    assert "held-out" in note


def test_a_mask_that_covers_everything_is_not_used():
    views = [view("a", object_mask()), view("b", np.ones((6, 8), bool)), view("c", None)]
    kept = without_covering(views)
    assert kept[0].mask is views[0].mask and kept[1].mask is None and kept[2].mask is None
    assert any("covers everything" in note and "b" in note for note in mask_notes(views, Path("masks")))
