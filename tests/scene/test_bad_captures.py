"""Captures that are not usable: one line that names the file, what is wrong and what would mend it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from corner import Corner
from test_load_scene import (
    write_cameras_json,
    write_cloud,
    write_poses_bounds,
    write_splat,
    write_transforms,
)

from diga3d_warp.errors import InputError
from diga3d_warp.scene import load
from diga3d_warp.scene.colmap.reconstruction import write_colmap
from diga3d_warp.scene.load import load_scene
from diga3d_warp.scene.scene import Points


def refused(path: Path, match: str, **options) -> None:
    with pytest.raises(InputError, match=match) as caught:
        load_scene(path, **options)
    assert "\n" not in str(caught.value)


def edit_transforms(root: Path, corner: Corner, change) -> None:
    corner.write_images(root / "images")
    write_cloud(root / "points.ply", corner)
    write_transforms(root, corner, ply_file_path="points.ply")
    contents = json.loads((root / "transforms.json").read_text())
    change(contents)
    (root / "transforms.json").write_text(json.dumps(contents))


def test_no_such_folder(tmp_path):
    refused(tmp_path / "nowhere", "no such file or folder")


def test_nothing_recognised(tmp_path):
    (tmp_path / "notes.txt").write_text("hello")
    refused(tmp_path, r"no capture recognised; expected sparse/0")


def test_a_reconstruction_without_images_file(colmap_scene):
    (colmap_scene / "sparse/0/images.bin").unlink()
    refused(colmap_scene, "no capture recognised; expected sparse/0 with cameras and images files")


def test_missing_images_are_named_and_left_out(colmap_scene):
    (colmap_scene / "images/view_02.png").unlink()
    (colmap_scene / "images/view_04.png").unlink()
    scene = load_scene(colmap_scene)
    assert [v.name for v in scene.views] == ["view_01", "view_03", "view_05"]
    assert scene.notes == (f"{colmap_scene / 'images'}: 2 images are missing: view_02, view_04",)


def test_missing_image_folder(colmap_scene):
    shutil.rmtree(colmap_scene / "images")
    refused(colmap_scene, "no photographs found; put them into .*images")


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
@pytest.mark.parametrize("keep", [0.5, 0.99, 0.0])
def test_truncated_images_are_named_and_left_out(tmp_path, corner, suffix, keep):
    corner.write_images(tmp_path / "images", suffix)
    write_colmap(tmp_path, corner.cameras, corner.points, suffix)
    path = tmp_path / "images" / f"view_03{suffix}"
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * keep)])
    scene = load_scene(tmp_path)
    assert [v.name for v in scene.views] == ["view_01", "view_02", "view_04", "view_05"]
    (note,) = scene.notes
    assert note.startswith(f"left out: {path}: ") and note.endswith("copy it again")


def test_many_damaged_images_make_few_notes(colmap_scene, corner, monkeypatch):
    monkeypatch.setattr(load, "_REASONS", 2)
    for path in sorted((colmap_scene / "images").iterdir())[2:]:
        path.write_bytes(b"no image")
    first, second, rest = load_scene(colmap_scene).notes
    assert "view_02" in first and "view_03" in second
    assert rest == "left out: 2 more images that cannot be read"


def test_a_film_after_the_end_of_a_jpeg_does_not_count(tmp_path, corner):
    """Phones append a film to a photograph; its bytes hold any marker."""
    corner.write_images(tmp_path / "images", ".jpg")
    write_colmap(tmp_path, corner.cameras, corner.points, ".jpg")
    with (tmp_path / "images/view_03.jpg").open("ab") as file:
        file.write(b"\x00\xff\xd9film\xff\xda\x00\x10 no end")
    assert load_scene(tmp_path).notes == ()


@pytest.mark.parametrize("left", [0, 1])
def test_one_view_is_no_scene(colmap_scene, left):
    for path in sorted((colmap_scene / "images").iterdir())[left:-1]:
        path.unlink()
    last = max((colmap_scene / "images").iterdir())
    last.write_bytes(b"no image" if left else last.read_bytes())
    refused(colmap_scene, "at least two photographs with poses, not 1; .* missing: view_")


def test_images_of_another_aspect_ratio(colmap_scene):
    cv2.imwrite(str(colmap_scene / "images/view_01.png"), np.zeros((180, 180, 3), np.uint8))
    refused(colmap_scene, "view_01: 180 x 180 px as read, but calibrated at 240 x 180 px")


def test_an_image_is_not_read_for_two_names(tmp_path, corner):
    """view_01.jpg is calibrated and not there: view_01.png is another image of the calibration."""
    corner.write_images(tmp_path / "images")
    first, second = list(corner.cameras.values())[:2]
    write_colmap(tmp_path, {"view_01": first, "view_1x": second}, corner.points)
    path = tmp_path / "sparse/0/images.bin"
    path.write_bytes(path.read_bytes().replace(b"view_1x.png", b"view_01.jpg"))
    refused(tmp_path, "at least two photographs with poses, not 1; .* 1 images are missing: view_01")


@pytest.mark.parametrize("name", ["../../etc/passwd", "/etc/passwd", "images/../../secret.png"])
def test_a_frame_outside_the_scene(tmp_path, corner, name):
    edit_transforms(tmp_path, corner, lambda c: c["frames"][1].update(file_path=name))
    refused(tmp_path, r"transforms\.json: the path .* leaves the scene folder")


def test_points_outside_the_scene(tmp_path, corner):
    edit_transforms(tmp_path, corner, lambda c: c.update(ply_file_path="../other.ply"))
    refused(tmp_path, r"transforms\.json: the path .* leaves the scene folder")


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda c: c.pop("frames"), "lists no frames"),
        (lambda c: c.update(frames=[]), "lists no frames"),
        (lambda c: c["frames"][2].pop("transform_matrix"), "frame 2: transform_matrix is missing"),
        (lambda c: c["frames"][2].pop("file_path"), "frame 2: file_path is missing"),
        (lambda c: (c.pop("fl_x"), c.pop("fl_y")), "frame 0: fl_x or camera_angle_x is missing"),
        (
            lambda c: c["frames"][1].update(transform_matrix=[[1, 2], [3, 4]]),
            "frame 1: transform_matrix: .*shape",
        ),
        (lambda c: c["frames"][1].update(transform_matrix=np.zeros((3, 4)).tolist()), "frame 1: .*rotation"),
        (lambda c: c["frames"].__setitem__(1, "text"), "frame 1 is 'text', not an object"),
        (lambda c: c.update(camera_model="EQUIRECTANGULAR"), "'EQUIRECTANGULAR' is not supported"),
        (lambda c: c.update(camera_model="OPENCV", k4=0.1), "k4 is supported for fisheye lenses only"),
        (lambda c: c.update(fl_x=float("nan")), "frame 0: fl_x is nan, not a number"),
    ],
)
def test_damaged_transforms(tmp_path, corner, change, match):
    edit_transforms(tmp_path, corner, change)
    refused(tmp_path, rf"transforms\.json: .*{match}|transforms\.json: {match}")


@pytest.mark.parametrize("value", ["\ud800.jpg", "x" * 5000, "a\0b", "", "/", "."])
@pytest.mark.parametrize("name", ["file_path", "mask_path", "ply_file_path", "test_filenames"])
def test_names_that_no_file_has(tmp_path, corner, name, value):
    """Read without that file, or refused: no traceback."""

    def change(contents):
        given = [value] if name == "test_filenames" else value
        (contents["frames"][1] if name in ("file_path", "mask_path") else contents)[name] = given

    edit_transforms(tmp_path, corner, change)
    try:
        assert len(load_scene(tmp_path, hold_out=0).views) >= 5
    except InputError as error:
        assert str(tmp_path) in str(error) and "\n" not in str(error) and str(error).encode()


@pytest.mark.parametrize("depth", [500, 100_000])
@pytest.mark.parametrize("entry", ["frames", "odd"])
def test_transforms_nested_deep(tmp_path, corner, entry, depth):
    edit_transforms(tmp_path, corner, lambda contents: None)
    nested = "[" * depth + "]" * depth
    (tmp_path / "transforms.json").write_text(f'{{"{entry}": {nested}}}')
    refused(tmp_path, r"transforms\.json")


def test_transforms_that_are_not_json(tmp_path, corner):
    corner.write_images(tmp_path / "images")
    (tmp_path / "transforms.json").write_text('{"frames": [')
    refused(tmp_path, r"transforms\.json is not valid JSON")


@pytest.mark.parametrize("damage", ["empty", "half", "pickle", "header", "shape", "nan", "mirrored"])
def test_damaged_poses_bounds(tmp_path, corner, damage):
    corner.write_images(tmp_path / "images")
    write_poses_bounds(tmp_path, corner)
    path = tmp_path / "poses_bounds.npy"
    rows = np.load(path)
    if damage == "pickle":
        np.save(path, np.array([{"a": 1}], object), allow_pickle=True)
    elif damage == "shape":
        np.save(path, rows[:, :15])
    elif damage == "nan":
        rows[2, 3] = np.nan
        np.save(path, rows)
    elif damage == "header":
        path.write_bytes(path.read_bytes().replace(b"}", b"{", 1))
    elif damage == "mirrored":
        rows[2, [0, 5, 10]] *= -1
        np.save(path, rows)
    else:
        path.write_bytes(path.read_bytes()[: 0 if damage == "empty" else 300])
    refused(tmp_path, r"poses_bounds\.npy.* run LLFF's imgs2poses again")


def test_llff_with_a_missing_image(tmp_path, corner):
    corner.write_images(tmp_path / "images_2")
    write_poses_bounds(tmp_path, corner)
    (tmp_path / "images_2/view_03.png").unlink()
    refused(tmp_path, r"6 poses but 5 in images_2; .*restore the missing images")


def test_splat_without_cameras(tmp_path, corner):
    write_splat(tmp_path / "scene.ply", corner.points.positions)
    corner.write_images(tmp_path / "images")
    refused(tmp_path, r"scene\.ply: no cameras file; put the cameras\.json")
    refused(tmp_path / "scene.ply", r"scene\.ply: no cameras file; put the cameras\.json")


def test_splat_without_photographs(tmp_path, corner):
    write_splat(tmp_path / "scene.ply", corner.points.positions)
    write_cameras_json(tmp_path / "cameras.json", corner)
    refused(tmp_path, r"cameras\.json: it lists 6 cameras but .*images holds no photographs; copy or link")


def test_two_splats(tmp_path, corner):
    for name in "ab":
        write_splat(tmp_path / f"{name}.ply", corner.points.positions)
    refused(tmp_path, r"several splats \(a\.ply, b\.ply\); give the path of one")


def test_a_ply_that_is_no_splat(tmp_path, corner):
    write_cloud(tmp_path / "cloud.ply", corner)
    refused(tmp_path / "cloud.ply", "a .ply without gaussians")


@pytest.mark.parametrize("damage", ["half", "empty", "text", "letters"])
def test_damaged_point_cloud(tmp_path, corner, damage):
    edit_transforms(tmp_path, corner, lambda c: None)
    path = tmp_path / "points.ply"
    whole = path.read_text()
    path.write_text(
        {
            "half": whole[: len(whole) // 2],
            "empty": "",
            "text": "hello",
            "letters": whole[:-20] + "x" * 20,
        }[damage]
    )
    refused(tmp_path, r"points\.ply: .*export it again")


def test_half_a_splat(tmp_path, corner):
    corner.write_images(tmp_path / "images")
    write_cameras_json(tmp_path / "cameras.json", corner)
    path = tmp_path / "scene.ply"
    write_splat(path, corner.points.positions)
    path.write_bytes(path.read_bytes()[:-30])
    refused(tmp_path, r"scene\.ply: cut short or damaged")


def test_no_points_and_none_to_be_found(tmp_path, corner):
    """Blank photographs have no features."""
    (tmp_path / "images").mkdir()
    for name in corner.cameras:
        cv2.imwrite(str(tmp_path / "images" / f"{name}.png"), np.full((180, 240, 3), 90, np.uint8))
    write_colmap(tmp_path, corner.cameras, Points(np.empty((0, 3)), np.empty((0, 3), np.uint8)))
    refused(tmp_path, "no sparse points, and none could be triangulated")
