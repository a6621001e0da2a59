"""load_scene: each layout is recognised and read; the split, the size and the notes are as documented."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from corner import HEIGHT, WIDTH, Corner, same_camera

from diga3d_warp.errors import InputError
from diga3d_warp.scene.colmap.reconstruction import write_colmap
from diga3d_warp.scene.load import load_scene

OPENCV_TO_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


def write_transforms(root: Path, corner: Corner, **entries) -> None:
    frames = [
        {
            "file_path": f"images/{name}.png",
            "transform_matrix": (np.linalg.inv(camera.pose) @ OPENCV_TO_OPENGL).tolist(),
        }
        for name, camera in corner.cameras.items()
    ]
    lens = {"w": WIDTH, "h": HEIGHT, "fl_x": 200.0, "fl_y": 200.0, "cx": 120.0, "cy": 90.0}
    contents = {**lens, "camera_model": "PINHOLE", "frames": frames, **entries}
    (root / "transforms.json").write_text(json.dumps(contents))


def write_cloud(path: Path, corner: Corner) -> None:
    lines = [
        " ".join(map(str, (*xyz, *rgb)))
        for xyz, rgb in zip(corner.points.positions, corner.points.colors, strict=True)
    ]
    header = f"ply\nformat ascii 1.0\nelement vertex {len(lines)}\n"
    header += "".join(f"property double {axis}\n" for axis in "xyz")
    header += "".join(f"property uchar {channel}\n" for channel in ("red", "green", "blue"))
    path.write_text(header + "end_header\n" + "\n".join(lines) + "\n")


def write_poses_bounds(root: Path, corner: Corner, factor: int = 1) -> None:
    rows = []
    for _, camera in sorted(corner.cameras.items()):
        right, down, forward = camera.pose[:3, :3]
        hwf = np.array([HEIGHT, WIDTH, 200.0]) * factor
        matrix = np.stack([down, right, -forward, camera.center, hwf], axis=1)
        rows.append([*matrix.ravel(), 0.5, 9.0])
    np.save(root / "poses_bounds.npy", rows)


def write_splat(path: Path, positions: np.ndarray) -> None:
    names = [*"xyz", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"]
    names += [f"scale_{i}" for i in range(3)] + [f"rot_{i}" for i in range(4)]
    table = np.zeros((len(positions), len(names)), "<f4")
    table[:, :3] = positions
    table[:, 6:9] = (0.75 - 0.5) / 0.28209479177387814
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(positions)}\n"
    header += "".join(f"property float {name}\n" for name in names) + "end_header\n"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(header.encode() + table.tobytes())


def write_cameras_json(path: Path, corner: Corner) -> None:
    entries = [
        {
            "id": number,
            "img_name": name,
            "width": WIDTH,
            "height": HEIGHT,
            "position": camera.center.tolist(),
            "rotation": camera.pose[:3, :3].T.tolist(),
            "fx": 200.0,
            "fy": 200.0,
        }
        for number, (name, camera) in enumerate(corner.cameras.items())
    ]
    path.write_text(json.dumps(entries))


def check(scene, corner: Corner, kind: str) -> None:
    """All six views with their own pixels and cameras, split by the rule, and the points."""
    assert scene.kind == kind
    assert [v.name for v in scene.test_views] == ["view_00"]
    assert [v.name for v in scene.views] == [f"view_{i:02d}" for i in range(1, 6)]
    for view in [*scene.views, *scene.test_views]:
        same_camera(view.camera, corner.cameras[view.name])
        np.testing.assert_array_equal(view.pixels, corner.images[view.name])
    assert len(scene.points) == len(corner.points)
    np.testing.assert_allclose(scene.points.positions, corner.points.positions, atol=1e-6)


def test_colmap(colmap_scene, corner):
    scene = load_scene(colmap_scene)
    check(scene, corner, "colmap")
    assert scene.notes == () and scene.splat is None and not scene.ground_truth
    assert all(view.mask is None for view in scene.views)


@pytest.mark.parametrize("place", ["sparse", "colmap/sparse/0"])
def test_colmap_in_other_places(colmap_scene, corner, place):
    shutil.move(colmap_scene / "sparse" / "0", colmap_scene / "moved")
    shutil.rmtree(colmap_scene / "sparse")
    (colmap_scene / place).parent.mkdir(parents=True, exist_ok=True)
    shutil.move(colmap_scene / "moved", colmap_scene / place)
    check(load_scene(colmap_scene), corner, "colmap")


def test_nerfstudio(tmp_path, corner):
    corner.write_images(tmp_path / "images")
    write_cloud(tmp_path / "sparse_pc.ply", corner)
    # applied_transform is already in the poses and the points: it must change nothing.
    write_transforms(
        tmp_path,
        corner,
        ply_file_path="sparse_pc.ply",
        applied_transform=[[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0]],
    )
    for path in (tmp_path, tmp_path / "transforms.json"):
        scene = load_scene(path)
        check(scene, corner, "nerfstudio")
        np.testing.assert_array_equal(scene.points.colors, corner.points.colors)


@pytest.mark.parametrize(
    ("model", "entries", "kind", "coefficients"),
    [
        ("OPENCV", {"k1": 0.1, "k2": 0.2, "p1": 0.01, "p2": 0.02}, "brown", (0.1, 0.2, 0.01, 0.02)),
        ("OPENCV_FISHEYE", {"k1": 0.1, "k2": 0.2, "k3": 0.3, "k4": 0.4}, "fisheye", (0.1, 0.2, 0.3, 0.4)),
    ],
)
def test_nerfstudio_lenses(tmp_path, corner, model, entries, kind, coefficients):
    corner.write_images(tmp_path / "images")
    write_cloud(tmp_path / "points.ply", corner)
    write_transforms(tmp_path, corner, camera_model=model, ply_file_path="points.ply", **entries)
    lens = load_scene(tmp_path).views[0].camera.distortion
    assert (lens.kind, lens.coefficients) == (kind, coefficients)


def test_nerfstudio_intrinsics_of_one_frame(tmp_path, corner):
    corner.write_images(tmp_path / "images")
    write_cloud(tmp_path / "points.ply", corner)
    write_transforms(tmp_path, corner, ply_file_path="points.ply")
    contents = json.loads((tmp_path / "transforms.json").read_text())
    contents["frames"][2].update(fl_x=321.0)
    (tmp_path / "transforms.json").write_text(json.dumps(contents))
    views = load_scene(tmp_path, hold_out=0).views
    assert [view.camera.fx for view in views] == [200, 200, 321, 200, 200, 200]


def test_nerfstudio_with_angles_and_images_of_several_sizes(tmp_path, corner):
    """Without w and h each image's own size counts, here with half and with squeezed ones."""
    corner.write_images(tmp_path / "images")
    write_cloud(tmp_path / "points.ply", corner)
    angles = {"camera_angle_x": 2 * np.arctan(0.6), "camera_angle_y": 2 * np.arctan(0.45)}
    absent = dict.fromkeys(("w", "h", "fl_x", "fl_y", "cx", "cy"))
    write_transforms(tmp_path, corner, ply_file_path="points.ply", **angles, **absent)
    for name, size in (("view_01", (120, 90)), ("view_02", (240, 90))):
        assert cv2.imwrite(
            str(tmp_path / "images" / f"{name}.png"), cv2.resize(corner.images[name][..., ::-1], size)
        )
    cameras = {view.name: view.camera for view in load_scene(tmp_path, hold_out=0).views}
    for name, camera in cameras.items():
        size = {"view_01": (120, 90), "view_02": (240, 90)}.get(name, (240, 180))
        same_camera(camera, corner.cameras[name].resized(*size))


def test_nerfstudio_with_an_angle_and_smaller_copies_only(tmp_path, corner):
    corner.write_images(tmp_path / "images_2", scale=0.5)
    write_cloud(tmp_path / "points.ply", corner)
    absent = dict.fromkeys(("w", "h", "fl_x", "fl_y", "cx", "cy"))
    angle = 2 * np.arctan(0.6)
    write_transforms(tmp_path, corner, ply_file_path="points.ply", camera_angle_x=angle, **absent)
    (tmp_path / "images_2/view_05.png").write_bytes(b"damaged")
    scene = load_scene(tmp_path, hold_out=0)
    assert len(scene.views) == 5
    for view in scene.views:
        same_camera(view.camera, corner.cameras[view.name].resized(120, 90))


def test_implausible_calibrations_are_noted(tmp_path, corner):
    corner.write_images(tmp_path / "images")
    write_cloud(tmp_path / "points.ply", corner)
    write_transforms(tmp_path, corner, ply_file_path="points.ply", cx=-3.0)
    (note,) = load_scene(tmp_path).notes
    assert "the principal point (-3, 90) px lies outside an image of 240 x 180 px" in note


def test_llff(tmp_path, corner):
    """Poses by sorted order, calibrated at twice the size of the only images; points without images.bin."""
    corner.write_images(tmp_path / "images_2")
    write_poses_bounds(tmp_path, corner, factor=2)
    write_colmap(tmp_path, corner.cameras, corner.points)
    for stem in ("cameras", "images", "frames", "rigs"):
        (tmp_path / "sparse" / "0" / f"{stem}.bin").unlink()
    check(load_scene(tmp_path), corner, "llff")


def test_llff_takes_the_lens_of_the_one_camera(tmp_path, corner):
    corner.write_images(tmp_path / "images_2")
    write_poses_bounds(tmp_path, corner, factor=2)
    write_colmap(tmp_path, corner.cameras, corner.points)
    sparse = tmp_path / "sparse" / "0"
    for stem in ("cameras", "images", "frames", "rigs"):
        (sparse / f"{stem}.bin").unlink()
    (sparse / "cameras.txt").write_text(f"1 SIMPLE_RADIAL {2 * WIDTH} {2 * HEIGHT} 444 240 180 0.07\n")
    camera = load_scene(tmp_path).views[0].camera
    assert (camera.width, camera.fx, camera.fy) == (WIDTH, 222, 222)
    assert camera.distortion.coefficients == (0.07, 0, 0, 0)


@pytest.mark.parametrize("cameras", ["cameras.json", "transforms.json"])
def test_splat_with_cameras(tmp_path, corner, cameras):
    corner.write_images(tmp_path / "images")
    splat = tmp_path / "scene.ply"
    write_splat(splat, corner.points.positions)
    write_cameras_json(tmp_path / cameras, corner) if cameras == "cameras.json" else write_transforms(
        tmp_path, corner
    )
    for path in (tmp_path, splat):
        scene = load_scene(path)
        check(scene, corner, "splat")
        assert scene.splat == splat
        assert (scene.points.colors == 191).all()


def test_splat_of_a_3dgs_run(tmp_path, corner):
    corner.write_images(tmp_path / "images", suffix=".png")
    write_cameras_json(tmp_path / "cameras.json", corner)
    for iteration in (7000, 30000):
        write_splat(
            tmp_path / f"point_cloud/iteration_{iteration}/point_cloud.ply",
            corner.points.positions[: iteration // 1000],
        )
    latest = tmp_path / "point_cloud/iteration_30000/point_cloud.ply"
    assert load_scene(tmp_path).splat == latest
    assert len(load_scene(latest).points) == 30


@pytest.mark.parametrize(
    ("scale", "folder", "size"),
    [
        (1.0, "images", (240, 180)),
        (0.5, "images_2", (120, 90)),
        (0.3, "images_2", (72, 54)),
        (0.25, "images_4", (60, 45)),
    ],
)
def test_the_nearest_large_enough_folder_is_read(colmap_scene, corner, scale, folder, size):
    """Each folder's images have their own brightness, which tells where pixels come from."""
    for factor, level in ((2, 80), (4, 160)):
        (colmap_scene / f"images_{factor}").mkdir()
        for name in corner.images:
            image = np.full((HEIGHT // factor, WIDTH // factor, 3), level, np.uint8)
            cv2.imwrite(str(colmap_scene / f"images_{factor}" / f"{name}.png"), image)
    view = load_scene(colmap_scene, image_scale=scale).views[0]
    assert (view.camera.width, view.camera.height) == view.pixels.shape[1::-1] == size
    assert view.camera.fx == pytest.approx(200 * scale, rel=1e-12)
    if folder == "images":
        assert view.pixels.std() > 20
    else:
        assert (view.pixels == {"images_2": 80, "images_4": 160}[folder]).all()


def test_scale_one_means_the_largest_images_present(colmap_scene, corner):
    shutil.rmtree(colmap_scene / "images")
    corner.write_images(colmap_scene / "images_2", scale=0.5)
    assert load_scene(colmap_scene).views[0].pixels.shape == (90, 120, 3)
    assert load_scene(colmap_scene, image_scale=0.5).views[0].pixels.shape == (45, 60, 3)


@pytest.mark.parametrize(("hold_out", "held"), [(8, [0]), (2, [0, 2, 4]), (0, [])])
def test_hold_out(colmap_scene, hold_out, held):
    scene = load_scene(colmap_scene, hold_out=hold_out)
    assert [v.name for v in scene.test_views] == [f"view_{i:02d}" for i in held]
    assert len(scene.views) == 6 - len(held)


def test_three_views_are_all_for_training(tmp_path, corner):
    corner.write_images(tmp_path / "images")
    names = list(corner.cameras)[:3]
    write_colmap(tmp_path, {name: corner.cameras[name] for name in names}, corner.points)
    scene = load_scene(tmp_path)
    assert [v.name for v in scene.views] == names and not scene.test_views
    assert "3 images have no pose" in scene.notes[0] and "view_05" in scene.notes[0]


def test_images_in_subfolders_get_unique_names(tmp_path, corner):
    cameras = {}
    for (name, image), folder in zip(corner.images.items(), "aabbcc", strict=True):
        key = f"{folder}/{int(name[-1]) % 2}"
        (tmp_path / "images" / folder).mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(tmp_path / "images" / f"{key}.png"), image)
        cameras[key] = corner.cameras[name]
    write_colmap(tmp_path, cameras, corner.points)
    assert [v.name for v in load_scene(tmp_path, hold_out=0).views] == [
        "a_0",
        "a_1",
        "b_0",
        "b_1",
        "c_0",
        "c_1",
    ]


def test_spin_nerf_protocol(tmp_path, corner):
    """Views with a label train; the rest test, with masks in sorted order, stored 0/1 and too tall."""
    corner.write_images(tmp_path / "images_4")
    write_poses_bounds(tmp_path, corner, factor=4)
    write_colmap(tmp_path, corner.cameras, corner.points)
    for stem in ("cameras", "images", "frames", "rigs"):
        (tmp_path / "sparse" / "0" / f"{stem}.bin").unlink()
    corner.write_masks(tmp_path / "images_4/label", [f"view_{i:02d}" for i in (2, 3, 4, 5)])
    corner.write_masks(tmp_path / "images_4/test_label", ["000", "001"], value=1, size=(WIDTH, HEIGHT + 3))
    scene = load_scene(tmp_path)
    assert scene.ground_truth
    assert [v.name for v in scene.test_views] == ["view_00", "view_01"]
    assert [v.name for v in scene.views] == ["view_02", "view_03", "view_04", "view_05"]
    for view in [*scene.views, *scene.test_views]:
        assert view.mask.shape == (HEIGHT, WIDTH)
        assert view.mask[HEIGHT // 4 + 1, WIDTH // 4] and not view.mask[0].any()
        assert view.mask.mean() == pytest.approx(1 / 16, rel=0.05)
    assert load_scene(tmp_path, image_scale=0.5).ground_truth


def test_labels_of_all_views_hold_out_as_usual(tmp_path, corner):
    corner.write_images(tmp_path / "images_4")
    write_colmap(tmp_path, corner.cameras, corner.points)
    corner.write_masks(tmp_path / "images_4/label")
    scene = load_scene(tmp_path)
    assert not scene.ground_truth and len(scene.test_views) == 1
    assert scene.notes == ()


@pytest.mark.parametrize("scale", [0.0, -1.0, 1.5, float("nan")])
def test_image_scale_outside_its_range(colmap_scene, scale):
    with pytest.raises(InputError, match="outside"):
        load_scene(colmap_scene, image_scale=scale)


def test_nerf_synthetic(tmp_path, corner):
    """RGBA images named without an ending, no size, and frames for training and for testing apart."""
    write_transforms(tmp_path, corner)
    contents = json.loads((tmp_path / "transforms.json").read_text())
    (tmp_path / "transforms.json").unlink()
    angle = 2 * np.arctan(0.5 * WIDTH / 200.0)
    for split, frames in (("train", contents["frames"][:4]), ("test", contents["frames"][4:])):
        (tmp_path / split).mkdir()
        for number, frame in enumerate(frames):
            image = corner.images[Path(frame["file_path"]).stem]
            alpha = np.full(image.shape[:2], 255, np.uint8)
            alpha[: HEIGHT // 2] = 0
            assert cv2.imwrite(
                str(tmp_path / split / f"r_{number}.png"), np.dstack([image[..., ::-1], alpha])
            )
            assert cv2.imwrite(str(tmp_path / split / f"r_{number}_depth_0001.png"), alpha)
            frame["file_path"] = f"./{split}/r_{number}"
        written = {"camera_angle_x": angle, "frames": frames}
        (tmp_path / f"transforms_{split}.json").write_text(json.dumps(written))
    scene = load_scene(tmp_path, image_scale=0.5)
    assert scene.kind == "nerfstudio" and len(scene.points) > 10
    assert [view.name for view in scene.views] == ["train_r_0", "train_r_1", "r_2", "r_3"]
    assert [view.name for view in scene.test_views] == ["test_r_0", "test_r_1"]
    same_camera(scene.test_views[1].camera, corner.cameras["view_05"].resized(WIDTH // 2, HEIGHT // 2))
    for view in [*scene.views, *scene.test_views]:
        assert view.alpha is not None and (view.alpha[: HEIGHT // 4] == 0).all()
        assert (view.alpha[HEIGHT // 4 :] == 255).all() and view.pixels[HEIGHT // 4 :].std() > 20
    assert "6 images have no pose" in scene.notes[0]


def test_without_a_size_and_without_the_image_a_frame_is_refused(tmp_path, corner):
    write_transforms(tmp_path, corner)
    contents = json.loads((tmp_path / "transforms.json").read_text())
    del contents["w"]
    (tmp_path / "transforms_train.json").write_text(json.dumps(contents))
    (tmp_path / "transforms.json").unlink()
    with pytest.raises(
        InputError, match=r"transforms_train\.json: frame 0: w and h are missing, and so is the image"
    ):
        load_scene(tmp_path)


def test_llff_with_alpha(tmp_path, corner):
    (tmp_path / "images").mkdir()
    alpha = np.where(np.arange(WIDTH) < 100, 255, 0)[None].repeat(HEIGHT, axis=0)
    for name, image in corner.images.items():
        planes = np.dstack([image[..., ::-1], alpha]).astype(np.uint8)
        assert cv2.imwrite(str(tmp_path / "images" / f"{name}.png"), planes)
    write_poses_bounds(tmp_path, corner)
    for view in load_scene(tmp_path).views:
        np.testing.assert_array_equal(view.alpha, alpha)
        np.testing.assert_array_equal(view.pixels[:, :100], corner.images[view.name][:, :100])
        assert (view.pixels[:, 100:] == 255).all()
