"""Sources: the folder of the wanted size, images that are missing there, folders of other names."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from corner import Corner

from diga3d_warp.scene.load import load_scene
from diga3d_warp.scene.photographs.folders import image_folders
from diga3d_warp.scene.photographs.sources import find_sources


def write_small(folder: Path, corner: Corner, names: list[str], factor: int = 2) -> None:
    folder.mkdir()
    for name, image in zip(names, corner.images.values(), strict=True):
        small = cv2.resize(image, None, fx=1 / factor, fy=1 / factor, interpolation=cv2.INTER_AREA)
        cv2.imwrite(str(folder / name), small[..., ::-1])


OTHER_NAMES = [f"image{number:03d}.png" for number in range(6)]


def test_smaller_images_of_other_names_are_matched_by_their_order(colmap_scene, corner):
    """As LLFF writes them; each view has its own picture, and masks keep the names of the originals."""
    write_small(colmap_scene / "images_2", corner, OTHER_NAMES)
    corner.write_masks(colmap_scene / "masks")
    scene = load_scene(colmap_scene, image_scale=0.5, hold_out=0)
    assert [view.name for view in scene.views] == list(corner.images)
    assert all(view.mask is not None for view in scene.views)
    (note,) = scene.notes
    assert "matched by sorted order: view_00.png -> image000.png and so on" in note
    for view in scene.views:
        small = cv2.resize(corner.images[view.name], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        assert np.abs(view.pixels.astype(int) - small).mean() < 2


@pytest.mark.parametrize("change", ["order", "count"])
def test_images_of_other_names_and_order_are_not_read(colmap_scene, corner, change):
    names = OTHER_NAMES[::-1] if change == "order" else OTHER_NAMES
    write_small(colmap_scene / "images_2", corner, names)
    if change == "count":
        (colmap_scene / "images_2" / "image003.png").unlink()
    scene = load_scene(colmap_scene, image_scale=0.5, hold_out=0)
    assert "6 images are missing there and read from images" in scene.notes[0]
    for view in scene.views:
        small = cv2.resize(corner.images[view.name], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        assert np.abs(view.pixels.astype(int) - small).mean() < 2


def test_only_smaller_images_of_other_names(colmap_scene, corner):
    """As in LLFF's own data, which leave the originals out."""
    for path in (colmap_scene / "images").iterdir():
        path.unlink()
    write_small(colmap_scene / "images_4", corner, OTHER_NAMES, factor=4)
    scene = load_scene(colmap_scene, hold_out=0)
    assert [view.name for view in scene.views] == list(corner.images)
    assert scene.views[0].pixels.shape == (45, 60, 3) and "matched by sorted order" in scene.notes[0]


def test_an_image_that_lacks_in_the_smaller_folder_is_made_smaller(colmap_scene, corner):
    write_small(colmap_scene / "images_2", corner, [f"{name}.png" for name in corner.images])
    (colmap_scene / "images_2" / "view_03.png").unlink()
    scene = load_scene(colmap_scene, image_scale=0.5, hold_out=0)
    assert len(scene.views) == 6 and {view.pixels.shape for view in scene.views} == {(90, 120, 3)}
    assert scene.notes == (
        f"{colmap_scene / 'images_2'}: 1 images are missing there and read from images: view_03.png",
    )


def test_a_folder_that_is_named_is_the_one_that_is_read(colmap_scene, corner):
    write_small(colmap_scene / "images_2", corner, [f"{name}.png" for name in corner.images])
    scene = load_scene(colmap_scene / "images_2")
    assert {view.pixels.shape for view in scene.views} == {(90, 120, 3)}
    assert "whose poses are read" in scene.notes[0]


def test_two_images_that_differ_in_their_endings(tmp_path, corner):
    """Both are calibrated: each is read for itself, and their views are told apart."""
    corner.write_images(tmp_path / "images")
    names = [*(f"{name}.png" for name in corner.images), "view_00.jpg"]
    cv2.imwrite(str(tmp_path / "images" / "view_00.jpg"), np.full((180, 240, 3), 90, np.uint8))
    sources = find_sources(image_folders(tmp_path), names, 1.0)
    assert sources.found["view_00.jpg"].file.name == "view_00.jpg"
    assert sources.found["view_00.png"].file.name == "view_00.png"
    assert sources.notes == []
