"""Masks: found, matched, repaired, or refused by name."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from corner import HEIGHT, WIDTH

from diga3d_warp.errors import InputError
from diga3d_warp.scene.load import load_scene
from diga3d_warp.scene.masks import read_mask


@pytest.fixture
def box() -> np.ndarray:
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[40:100, 60:150] = 255
    return mask


def stored_forms(box: np.ndarray) -> dict[str, np.ndarray]:
    color = np.random.default_rng(1).integers(0, 255, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    return {
        "0/255": box,
        "0/1": box // 255,
        "0/38": box // 255 * 38,
        "colour": np.dstack([box, box * 0, box * 0]),
        "alpha": np.dstack([color, box]),
        "opaque": np.dstack([box, box, box, np.full_like(box, 255)]),
        "16 bit": box.astype(np.uint16) * 257,
        "numbers": box // 255 * 2 + np.roll(box, 200, axis=1) // 255,
    }


@pytest.mark.parametrize("form", stored_forms(np.zeros((HEIGHT, WIDTH), np.uint8)))
def test_stored_forms(tmp_path, box, form):
    stored = stored_forms(box)[form]
    cv2.imwrite(str(tmp_path / "m.png"), stored)
    expected = stored > 0 if form == "numbers" else box > 0
    np.testing.assert_array_equal(read_mask(tmp_path / "m.png", WIDTH, HEIGHT), expected)


def test_jpeg_noise_is_no_mask(tmp_path, box):
    cv2.imwrite(str(tmp_path / "m.jpg"), box, [cv2.IMWRITE_JPEG_QUALITY, 30])
    assert (cv2.imread(str(tmp_path / "m.jpg"), 0) > 0).sum() > (box > 0).sum() + 100
    mask = read_mask(tmp_path / "m.jpg", WIDTH, HEIGHT)
    assert (mask != (box > 0)).mean() < 0.002


def test_rows_too_many_are_cut(tmp_path, box):
    cv2.imwrite(str(tmp_path / "m.png"), np.vstack([box, box[:3] * 0 + 255]))
    np.testing.assert_array_equal(read_mask(tmp_path / "m.png", WIDTH, HEIGHT), box > 0)


@pytest.mark.parametrize("factor", [2, 0.5])
def test_another_size_of_the_same_aspect_ratio(tmp_path, box, factor):
    size = (int(WIDTH * factor), int(HEIGHT * factor))
    cv2.imwrite(str(tmp_path / "m.png"), cv2.resize(box, size, interpolation=cv2.INTER_NEAREST_EXACT))
    np.testing.assert_array_equal(read_mask(tmp_path / "m.png", WIDTH, HEIGHT), box > 0)


@pytest.mark.parametrize("shape", [(HEIGHT + 10, WIDTH), (HEIGHT, WIDTH + 20), (WIDTH, HEIGHT)])
def test_another_aspect_ratio_is_refused(tmp_path, shape):
    cv2.imwrite(str(tmp_path / "m.png"), np.ones(shape, np.uint8))
    with pytest.raises(
        InputError, match=rf"m\.png: the mask is {shape[1]} x {shape[0]} px for an image of 240"
    ):
        read_mask(tmp_path / "m.png", WIDTH, HEIGHT)


def test_a_damaged_mask(tmp_path):
    (tmp_path / "m.png").write_bytes(b"")
    with pytest.raises(InputError, match=r"m\.png: not readable"):
        read_mask(tmp_path / "m.png", WIDTH, HEIGHT)


def test_masks_are_found_by_themselves(colmap_scene, corner):
    corner.write_masks(colmap_scene / "masks")
    scene = load_scene(colmap_scene)
    assert scene.notes == ()
    assert all(view.mask.any() and not view.mask.all() for view in [*scene.views, *scene.test_views])


@pytest.mark.parametrize("ending", ["", ".png"])
def test_masks_named_by_the_user_come_first(colmap_scene, corner, ending):
    corner.write_masks(colmap_scene / "masks")
    corner.write_masks(
        colmap_scene / "mine", [name + ending for name in corner.images], size=(WIDTH * 2, HEIGHT * 2)
    )
    for path in (colmap_scene / "mine").iterdir():
        cv2.imwrite(str(path), cv2.rotate(cv2.imread(str(path), 0), cv2.ROTATE_180))
    mask = load_scene(colmap_scene, masks=colmap_scene / "mine").views[0].mask
    assert mask[HEIGHT * 5 // 8, WIDTH * 5 // 8] and not mask[HEIGHT * 3 // 8, WIDTH * 3 // 8]


def test_views_without_a_mask_are_named(colmap_scene, corner):
    corner.write_masks(colmap_scene / "masks", [f"view_{i:02d}" for i in (0, 1, 2, 5)])
    scene = load_scene(colmap_scene)
    assert scene.notes == ("2 views have no mask: view_03, view_04",)
    assert [view.mask is None for view in scene.views] == [False, False, True, True, False]


def test_masks_of_other_names(colmap_scene, corner):
    corner.write_masks(colmap_scene / "mine", ["IMG_7", "IMG_8"])
    with pytest.raises(
        InputError, match=r"no mask has the name of an image \(mask 'IMG_7', image 'view_00'\)"
    ):
        load_scene(colmap_scene, masks=colmap_scene / "mine")


@pytest.mark.parametrize("make", [False, True])
def test_a_mask_folder_without_masks(colmap_scene, make):
    if make:
        (colmap_scene / "mine").mkdir()
    with pytest.raises(InputError, match="mine: there are no mask images"):
        load_scene(colmap_scene, masks=colmap_scene / "mine")


@pytest.mark.parametrize(("level", "match"), [(0, "every mask is empty"), (255, "covers its whole image")])
def test_empty_and_covering_masks(colmap_scene, corner, level, match):
    corner.write_masks(colmap_scene / "masks")
    for i, path in enumerate(sorted((colmap_scene / "masks").iterdir())[1:], start=1):
        cv2.imwrite(str(path), np.full((HEIGHT, WIDTH), level, np.uint8))
        if i == 2:
            (note,) = load_scene(colmap_scene).notes
            assert note.startswith("2 views have ") and note.endswith("view_01, view_02")
    with pytest.raises(InputError, match=match) as caught:
        load_scene(colmap_scene)
    assert "\n" not in str(caught.value)
