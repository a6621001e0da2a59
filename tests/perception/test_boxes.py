"""Boxes: refused when they cannot be used, and cut out along the colours."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.perception.boxes import Box, cut_along, cut_out, find_boxed, read_boxes
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.photographs.decoding import turned
from diga3d_warp.scene.photographs.orientation import inverse
from diga3d_warp.scene.scene import Points, Scene, View


def disc_view(name: str = "a", shape=(120, 160), center=(90, 60), radius=30) -> tuple[View, np.ndarray]:
    """A red disc on a green ground, both with texture, and where it is."""
    rng = np.random.default_rng(0)
    pixels = np.clip([60, 120, 50] + 12 * rng.standard_normal((*shape, 3)), 0, 255).astype(np.uint8)
    disc = np.zeros(shape, np.uint8)
    cv2.circle(disc, center, radius, 1, -1)
    pixels[disc > 0] = np.clip([180, 40, 40] + 12 * rng.standard_normal((int(disc.sum()), 3)), 0, 255)
    camera = Camera(shape[1], shape[0], 100.0, 100.0, shape[1] / 2, shape[0] / 2, torch.eye(4))
    return View(name, camera, pixels), disc > 0


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    return (a & b).sum() / (a | b).sum()


@pytest.mark.parametrize("scale", [1, 4])
def test_a_box_finds_what_stands_out(scale):
    shape, center = (120 * scale, 160 * scale), (90 * scale, 60 * scale)
    view, disc = disc_view(shape=shape, center=center, radius=30 * scale)
    box = Box("a", 55 * scale, 24 * scale, 125 * scale, 96 * scale)
    mask = cut_out(view, box)
    assert overlap(mask, disc) > 0.95
    assert np.array_equal(mask, cut_out(view, box)), "the same each time"


def test_a_rough_mask_is_laid_along_the_colours():
    view, disc = disc_view()
    likely = np.roll(disc, 4, axis=1)
    surely = cv2.erode(disc.astype(np.uint8), np.ones((25, 25), np.uint8)) > 0
    assert overlap(likely, disc) < 0.85 < 0.95 < overlap(cut_along(view.pixels, surely, likely, 6), disc)
    nothing = np.zeros_like(disc)
    assert not cut_along(view.pixels, nothing, nothing, 6).any()


def test_a_box_over_one_colour_is_refused():
    view, _ = disc_view()
    plain = View("a", view.camera, np.full_like(view.pixels, 90))
    with pytest.raises(InputError, match="mask box of view 'a': no object stands out"):
        cut_out(plain, Box("a", 20, 20, 60, 60))


@pytest.fixture
def scene() -> Scene:
    views = [disc_view(name)[0] for name in ("a", "b", "c", "d")]
    return Scene(Path("scene"), "colmap", views[:3], views[3:], Points(np.zeros((0, 3)), np.zeros((0, 3))))


@pytest.mark.parametrize(
    ("boxes", "said"),
    [
        ([Box("x", 0, 0, 9, 9)], "there is no view 'x' in scene; the first is 'a'"),
        ([Box("a", 0, 0, 9, 9), Box("a.png", 1, 1, 9, 9)], "view 'a' has two"),
        ([Box(name, 0, 0, 9, 9) for name in "abcd"], "4 mask boxes: give at most 3"),
        ([Box("d", 0, 0, 9, 9)], "view 'd' is kept for testing"),
        ([Box("a", -1, 0, 9, 9)], "-1 0 9 9 of view 'a' is not within its 160 x 120 px"),
        ([Box("a", 0, 0, 161, 9)], "0 0 161 9 of view 'a' is not within"),
        ([Box("a", 5, 5, 5, 9)], "5 5 5 9 of view 'a' is not within"),
        ([Box("a", 0, 9, 9, 0)], "0 9 9 0 of view 'a' is not within"),
    ],
)
def test_boxes_that_cannot_be_used(scene, boxes, said):
    with pytest.raises(InputError) as caught:
        find_boxed(boxes, scene)
    assert said in str(caught.value) and "\n" not in str(caught.value)


def test_boxes_are_found_by_the_names_of_files_and_views(scene):
    found = find_boxed([Box("a.jpg", 0, 0, 110, 120), Box("c", 1, 2, 3, 4)], scene)
    assert list(found.boxes) == ["a", "c"] and found.notes == []


def test_a_box_over_most_of_a_view_is_noted(scene):
    (note,) = find_boxed([Box("a", 0, 0, 160, 120)], scene).notes
    assert note.startswith("mask box 0 0 160 120 covers most of view a: the object is what stands out")


@pytest.mark.parametrize("orientation", range(2, 9))
def test_a_box_is_one_of_the_photograph_as_viewers_show_it(scene, orientation):
    """A red disc off the middle, stored in some way: the box around it on screen finds it."""
    view, disc = disc_view(center=(50, 40), radius=20)
    stored = View("a", view.camera, turned(view.pixels, inverse(orientation)), orientation=orientation)
    shown = replace(scene, views=[stored, *scene.views[1:]])
    found = find_boxed([Box("a", 27, 17, 74, 64)], shown)
    assert overlap(cut_out(stored, found.boxes["a"]), turned(disc, inverse(orientation))) > 0.95
    assert "as viewers show it" in found.notes[0]


def test_a_box_that_fits_as_stored_only(scene):
    view, _ = disc_view()
    shown = replace(scene, views=[replace(view, orientation=6), *scene.views[1:]])
    assert find_boxed([Box("a", 100, 10, 160, 90)], shown).boxes["a"] == Box("a", 100, 10, 160, 90)
    assert "as it is stored" in find_boxed([Box("a", 100, 10, 160, 90)], shown).notes[0]
    with pytest.raises(InputError, match="is not within its 120 x 160 px"):
        find_boxed([Box("a", 100, 10, 160, 161)], shown)


def test_words_become_boxes():
    assert read_boxes([["a", "1", "2", "30", "40"]]) == [Box("a", 1, 2, 30, 40)]
    with pytest.raises(InputError, match="'1 2 3 x' are not four whole numbers"):
        read_boxes([["a", "1", "2", "3", "x"]])
