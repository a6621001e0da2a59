"""Data sets of the field: each found by its folders, with its own test views, masks and size."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from corner import HEIGHT, WIDTH, Corner
from test_load_scene import write_poses_bounds, write_transforms

from diga3d_warp.scene.camera import look_at
from diga3d_warp.scene.colmap.reconstruction import write_colmap
from diga3d_warp.scene.load import load_scene
from diga3d_warp.scene.scene import Scene

HELD = ("view_04", "view_05")
"""Views that show the scene without the object, where a data set has such."""

KEPT = ("view_00", "view_01", "view_02", "view_03")


def write_scaled(
    corner: Corner, folder: Path, factor: int, names: dict[str, str], suffix: str = ".png"
) -> None:
    """Photographs in folder, smaller by a factor, by their new names."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, new in names.items():
        pixels = cv2.resize(
            corner.images[name], (WIDTH // factor, HEIGHT // factor), interpolation=cv2.INTER_AREA
        )
        assert cv2.imwrite(str(folder / f"{new}{suffix}"), pixels[..., ::-1])


def spin_nerf(corner: Corner, root: Path) -> Path:
    same = {name: name for name in corner.images}
    write_scaled(corner, root / "images", 1, same)
    write_scaled(corner, root / "images_4", 4, same)
    write_poses_bounds(root, corner)
    corner.write_masks(root / "images_4" / "label", list(KEPT))
    corner.write_masks(root / "images_4" / "test_label", list(HELD))
    return root


def llff(corner: Corner, root: Path) -> Path:
    """As in nerf_llff_data: smaller images have other names."""
    write_scaled(corner, root / "images", 1, {name: name for name in corner.images})
    for factor in (4, 8):
        renamed = {name: f"image{place:03d}" for place, name in enumerate(corner.images)}
        write_scaled(corner, root / f"images_{factor}", factor, renamed)
    write_colmap(root, corner.cameras, corner.points)
    write_poses_bounds(root, corner)
    return root


def around(corner: Corner) -> Corner:
    """The same with two cameras that look the other way, as on a turn around something."""
    for name, place in (("view_01", (9.0, 9.0, 0.0)), ("view_03", (8.0, 9.0, 0.0))):
        camera = corner.cameras[name]
        corner.cameras[name] = camera.with_pose(look_at(np.array(place), np.array([-9.0, -9.0, 0.5])))
    return corner


def mip_nerf_360(corner: Corner, root: Path) -> Path:
    for factor in (1, 2, 4, 8):
        folder = root / ("images" if factor == 1 else f"images_{factor}")
        write_scaled(corner, folder, factor, {name: name for name in corner.images})
    write_colmap(root, corner.cameras, corner.points)
    write_poses_bounds(root, corner)
    return root


def in2n(corner: Corner, root: Path) -> Path:
    root.mkdir()
    write_transforms(root, corner)
    contents = json.loads((root / "transforms.json").read_text())
    names = {
        Path(frame["file_path"]).stem: f"frame_{place + 1:05d}"
        for place, frame in enumerate(contents["frames"])
    }
    for frame in contents["frames"]:
        frame["file_path"] = f"images/{names[Path(frame['file_path']).stem]}.png"
    (root / "transforms.json").write_text(json.dumps(contents))
    for factor in (1, 2, 4):
        write_scaled(corner, root / ("images" if factor == 1 else f"images_{factor}"), factor, names)
    return root


def usid(corner: Corner, root: Path) -> Path:
    """360-USID: one reconstruction of photographs in two folders, masks of the object and of the unseen."""
    write_scaled(corner, root / "images", 1, {name: name for name in KEPT}, ".jpg")
    write_scaled(corner, root / "test_images", 1, {name: name for name in HELD}, ".jpg")
    write_scaled(corner, root / "reference", 1, {KEPT[0]: KEPT[0]}, ".jpg")
    write_colmap(root, corner.cameras, corner.points, suffix=".jpg")
    corner.write_masks(root / "object_masks", list(KEPT))
    for name in KEPT:
        (root / "unseen_masks").mkdir(exist_ok=True)
        cv2.imwrite(str(root / "unseen_masks" / f"{name}.png"), np.full((HEIGHT, WIDTH), 255, np.uint8))
    return root


def inpaint360gs(corner: Corner, root: Path) -> Path:
    names = {name: f"IMG_{place + 1:04d}" for place, name in enumerate(KEPT)}
    names |= {name: f"test_IMG_{place + 51:04d}" for place, name in enumerate(HELD)}
    write_scaled(corner, root / "images", 1, names, ".JPG")
    write_scaled(corner, root / "images_2", 2, names, ".JPG")
    write_colmap(root, {names[name]: corner.cameras[name] for name in names}, corner.points, suffix=".JPG")
    return root


def line_of(scene: Scene) -> str:
    (line,) = [note for note in scene.notes if "the layout of" in note]
    return line


@pytest.mark.parametrize("write", [llff, mip_nerf_360, in2n, usid, inpaint360gs, spin_nerf])
def test_each_is_recognised_with_one_line(write: Callable[[Corner, Path], Path], tmp_path, monkeypatch):
    from diga3d_warp.scene import load

    monkeypatch.setattr(load, "check_frame", lambda *_: [])  # cameras of mip_nerf_360 show nothing
    corner = Corner()
    scene = load_scene(write(around(corner) if write is mip_nerf_360 else corner, tmp_path / "scene"))
    names = {
        llff: "LLFF", mip_nerf_360: "Mip-NeRF 360", in2n: "Instruct-NeRF2NeRF", usid: "360-USID",
        inpaint360gs: "Inpaint360GS", spin_nerf: "SPIn-NeRF",
    }  # fmt: skip
    assert f"scene: the layout of {names[write]}" in line_of(scene)
    assert scene.ground_truth == (write in (usid, inpaint360gs, spin_nerf))
    assert len(scene.views) + len(scene.test_views) == 6
    assert len(scene.test_views) == (2 if scene.ground_truth else 1)


def test_usid_reads_both_folders_and_the_masks_of_the_object(tmp_path, corner):
    scene = load_scene(usid(corner, tmp_path / "carton"))
    assert [view.name for view in scene.test_views] == list(HELD)
    assert [view.name for view in scene.views] == list(KEPT)
    assert all(view.mask is None for view in scene.test_views)
    for view in scene.views:
        assert 0 < view.mask.mean() < 0.2, "object_masks are read, not unseen_masks"
    for view in [*scene.views, *scene.test_views]:
        assert np.abs(view.pixels.astype(int) - corner.images[view.name]).mean() < 12
    assert not [note for note in scene.notes if "missing" in note or "left out" in note]
    half = load_scene(tmp_path / "carton", image_scale=0.5)
    assert {view.pixels.shape for view in [*half.views, *half.test_views]} == {(HEIGHT // 2, WIDTH // 2, 3)}
    assert "--image-scale 1" in line_of(half) and "--image-scale" not in line_of(scene)


def test_inpaint360gs_holds_out_the_views_without_the_object(tmp_path, corner):
    scene = load_scene(inpaint360gs(corner, tmp_path / "toys"), image_scale=0.5)
    assert [view.name for view in scene.test_views] == ["test_IMG_0051", "test_IMG_0052"]
    assert "give --masks" in line_of(scene) and "--image-scale" not in line_of(scene)
    assert "--image-scale 0.5" in line_of(load_scene(tmp_path / "toys"))


def test_mip_nerf_360_is_measured_at_its_own_sizes(tmp_path, monkeypatch):
    from diga3d_warp.scene import load

    monkeypatch.setattr(load, "check_frame", lambda *_: [])
    for name, factor in (("garden", 4), ("Counter", 2)):
        scene = load_scene(mip_nerf_360(around(Corner()), tmp_path / name))
        assert f"images_{factor}, which --image-scale {1 / factor:g} gives" in line_of(scene)


def test_mip_nerf_360_by_its_image_folders(tmp_path, corner):
    """Without poses_bounds.npy, as it is often handed on; 3DGS' convert.py makes the same of own videos."""
    root = mip_nerf_360(corner, tmp_path / "stump")
    (root / "poses_bounds.npy").unlink()
    assert "the layout of Mip-NeRF 360" in line_of(load_scene(root))
    (root / "input").mkdir()
    assert load_scene(root).notes == ()


def test_labels_without_test_labels_and_other_views_held_out(tmp_path, corner):
    root = llff(corner, tmp_path / "scene")
    corner.write_masks(root / "images_4" / "label")
    scene = load_scene(root, image_scale=0.25, hold_out=3)
    assert not scene.ground_truth and scene.views[0].mask.any()
    line = line_of(scene)
    assert "SPIn-NeRF, without test_label: test views are every 8th" in line
    assert "which --hold-out 8 gives; masks are those of label" in line and "--image-scale" not in line


def test_ordinary_captures_are_of_no_data_set(tmp_path, corner):
    """Names, folders and files that are alike, but not the data sets'."""
    corner.write_images(tmp_path / "all_test" / "images")
    write_colmap(tmp_path / "all_test", corner.cameras, corner.points)
    (tmp_path / "all_test" / "test_images").mkdir()
    corner.write_images(tmp_path / "all_test" / "test_images")  # copies of photographs that images has, too
    scene = load_scene(tmp_path / "all_test")
    assert not scene.ground_truth and scene.notes == ()
    names = {name: f"test_{name}" for name in corner.images}  # none is without test_
    write_scaled(corner, tmp_path / "prefixed" / "images", 1, names)
    cameras = {names[name]: camera for name, camera in corner.cameras.items()}
    write_colmap(tmp_path / "prefixed", cameras, corner.points)
    scene = load_scene(tmp_path / "prefixed")
    assert not scene.ground_truth and scene.notes == ()
    names = {name: name for name in KEPT} | {name: f"test_other{name[-1]}" for name in HELD}
    write_scaled(corner, tmp_path / "mixed" / "images", 1, names)
    cameras = {names[name]: camera for name, camera in corner.cameras.items()}
    write_colmap(tmp_path / "mixed", cameras, corner.points)
    assert not load_scene(tmp_path / "mixed").ground_truth


def test_a_data_set_that_was_downloaded_in_part(tmp_path, corner):
    """Views that are missing are named; what is there keeps its role."""
    root = usid(corner, tmp_path / "cone")
    (root / "test_images" / f"{HELD[0]}.jpg").unlink()
    (root / "object_masks" / f"{KEPT[1]}.png").unlink()
    scene = load_scene(root)
    assert [view.name for view in scene.test_views] == [HELD[1]] and scene.ground_truth
    assert any("1 images are missing: view_04" in note for note in scene.notes)
    assert [view.mask is None for view in scene.views] == [False, True, False, False]
