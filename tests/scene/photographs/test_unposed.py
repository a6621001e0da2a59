"""Photographs without poses: what lies beside them is not mapped with them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from corner import Corner

from diga3d_warp.errors import InputError
from diga3d_warp.scene.load import load_scene
from diga3d_warp.scene.photographs.unposed import find_photographs


def names(root: Path) -> list[str]:
    return [path.relative_to(root).as_posix() for path in find_photographs(root).files]


PHOTOGRAPHS = [f"view_{number:02d}.jpg" for number in range(6)]


def write_grey(folder: Path, corner: Corner) -> None:
    folder.mkdir(parents=True)
    for name, image in corner.images.items():
        cv2.imwrite(str(folder / f"{name}.png"), image[..., 0])


@pytest.mark.parametrize("folder", ["masks", "depth", "keyframes/confidence", "Thumbnails", "normals"])
def test_folders_that_hold_no_photographs_by_their_names(tmp_path, corner, folder):
    corner.write_images(tmp_path, ".jpg")
    corner.write_images(tmp_path / folder)
    assert names(tmp_path) == PHOTOGRAPHS
    assert f"{folder} (6, by its name)" in find_photographs(tmp_path).notes[0]


def test_grey_images_beside_coloured_ones(tmp_path, corner):
    corner.write_images(tmp_path / "rgb", ".jpg")
    write_grey(tmp_path / "lidar", corner)
    assert names(tmp_path) == [f"rgb/{name}" for name in PHOTOGRAPHS]
    assert "lidar (6, grey beside coloured ones)" in find_photographs(tmp_path).notes[0]


def test_grey_photographs(tmp_path, corner):
    write_grey(tmp_path / "photos", corner)
    assert len(names(tmp_path)) == 6


@pytest.mark.parametrize("copy", ["corrected_images", "undistorted", "export/small"])
def test_copies_by_their_names(tmp_path, corner, copy):
    """Undistorted copies look different enough; their names tell."""
    corner.write_images(tmp_path / "raw", ".jpg")
    (tmp_path / copy).mkdir(parents=True)
    for name, image in corner.images.items():
        cv2.imwrite(str(tmp_path / copy / f"{name}.jpg"), np.roll(image, 30, axis=1))
    assert names(tmp_path) == [f"raw/{name}" for name in PHOTOGRAPHS]
    assert f"{copy} (6, copies of those in raw)" in find_photographs(tmp_path).notes[0]


def test_copies_by_their_looks(tmp_path, corner):
    corner.write_images(tmp_path / "a", ".jpg")
    corner.write_images(tmp_path / "b", ".png", scale=0.5)
    (tmp_path / "b" / "view_03.png").unlink()
    assert names(tmp_path) == [f"a/{name}" for name in PHOTOGRAPHS]


def test_two_cameras_with_equal_names_are_no_copies(tmp_path, corner):
    """The folders of a rig: same names, other pictures."""
    corner.write_images(tmp_path / "left", ".jpg")
    (tmp_path / "right").mkdir()
    for name, image in zip(corner.images, [*corner.images.values()][::-1], strict=True):
        cv2.imwrite(str(tmp_path / "right" / f"{name}.jpg"), image[..., ::-1])
    assert len(names(tmp_path)) == 12


def test_a_cover_beside_folders_of_photographs(tmp_path, corner):
    corner.write_images(tmp_path / "day 1", ".jpg")
    cv2.imwrite(str(tmp_path / "cover.jpg"), corner.images["view_00"])
    assert names(tmp_path) == [f"day 1/{name}" for name in PHOTOGRAPHS]


def test_masks_beside_photographs_under_their_names(tmp_path, corner):
    corner.write_images(tmp_path, ".jpg")
    corner.write_masks(tmp_path)
    found = find_photographs(tmp_path)
    assert [path.name for path in found.files] == PHOTOGRAPHS
    assert "6 images have the name of a photograph and another ending" in found.notes[0]


def test_runs_and_hidden_folders_are_skipped(tmp_path, corner):
    corner.write_images(tmp_path, ".jpg")
    corner.write_images(tmp_path / "run" / "views" / "after")
    (tmp_path / "run" / "stages").mkdir()
    (tmp_path / "run" / "manifest.json").write_text("{}")
    corner.write_images(tmp_path / ".cache")
    corner.write_images(tmp_path / "__MACOSX")
    (tmp_path / "._view_00.jpg").write_bytes(b"\0\5\x16\7")
    found = find_photographs(tmp_path)
    assert [path.name for path in found.files] == PHOTOGRAPHS and found.notes == []


@pytest.mark.parametrize("mark", ["cfg_args", "nerfstudio_models/step.ckpt"])
def test_results_of_other_programs_are_skipped(tmp_path, corner, mark):
    corner.write_images(tmp_path, ".jpg")
    corner.write_images(tmp_path / "output" / "train" / "gt")
    (tmp_path / "output" / mark).parent.mkdir(exist_ok=True)
    (tmp_path / "output" / mark).write_text("")
    assert names(tmp_path) == PHOTOGRAPHS


def test_images_that_are_not_read_are_named(tmp_path, corner):
    corner.write_images(tmp_path, ".jpg")
    (tmp_path / "view_00.CR3").touch()
    assert find_photographs(tmp_path).notes == []
    for number in (7, 8):
        (tmp_path / f"view_{number:02d}.HEIC").touch()
    (note,) = find_photographs(tmp_path).notes
    assert note.startswith(f"{tmp_path}: 2 are HEIC images, which are not read (view_07.HEIC)")


def test_originals_of_3dgs(tmp_path, corner):
    corner.write_images(tmp_path / "input", ".jpg")
    assert names(tmp_path) == [f"input/{name}" for name in PHOTOGRAPHS]


def test_nothing_but_masks(tmp_path, corner):
    corner.write_masks(tmp_path / "masks")
    with pytest.raises(InputError, match=r"not taken for photographs: masks .*none is left"):
        load_scene(tmp_path)
