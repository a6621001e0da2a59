"""The synthetic capture: its files agree with each other and with its cameras."""

import json
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
import trimesh

from diga3d_warp.errors import InputError
from diga3d_warp.scene.synthetic import room
from diga3d_warp.scene.synthetic.arc import arc_cameras
from diga3d_warp.scene.synthetic.generate import SyntheticScene, generate
from diga3d_warp.scene.synthetic.materials import MATERIALS
from diga3d_warp.scene.synthetic.room import golden_ball, vase
from diga3d_warp.scene.synthetic.solids import box, revolved

SMALL = {"width": 96, "height": 72, "views": 3}


@pytest.fixture(scope="module")
def capture(tmp_path_factory) -> Path:
    return generate(SyntheticScene(**SMALL), tmp_path_factory.mktemp("synthetic") / "room")


@pytest.fixture(scope="module")
def shadowless(tmp_path_factory) -> Path:
    return generate(SyntheticScene(**SMALL, shadows=False), tmp_path_factory.mktemp("synthetic") / "room")


def pictures(folder: Path) -> np.ndarray:
    """All PNG of a folder in order of their names, shape (views, H, W, 3) or (views, H, W), float or bool."""
    files = [cv2.imread(str(file), cv2.IMREAD_UNCHANGED) for file in sorted(folder.glob("*.png"))]
    return np.stack([file[..., ::-1].astype(float) if file.ndim == 3 else file == 255 for file in files])


def depths(folder: Path) -> np.ndarray:
    return np.stack([np.load(file) for file in sorted(folder.glob("*.npy"))])


def trimesh_of(surface) -> trimesh.Trimesh:
    return trimesh.Trimesh(surface.vertices, surface.faces, process=False)


def test_layout(capture):
    for part in ("images", "masks", *(f"ground_truth/{k}" for k in ("without_object", "other_object"))):
        assert [p.name for p in sorted((capture / part).iterdir())] == [f"view_00{k}.png" for k in range(3)]
    assert json.loads((capture / "scene.json").read_text())["width"] == 96
    assert list(capture.parent.iterdir()) == [capture]


def test_pictures_show_something(capture):
    for part in (
        "images",
        "ground_truth/without_object",
        "ground_truth/other_object",
        "ground_truth/other_material",
    ):
        images = pictures(capture / part)
        assert images.shape == (3, 72, 96, 3)
        assert images.std((1, 2)).min() > 25
        assert 60 < images.mean() < 160
        assert (images == 0).all(-1).mean() < 0.01  # the open sides of the room are out of view
        assert (images >= 254).any(-1).mean() < 0.05
        detail = np.abs(np.diff(images, axis=2)).mean()
        assert detail > 4


def test_the_object_covers_a_fair_part_of_every_view(capture):
    cover = pictures(capture / "masks").mean((1, 2))
    assert cover.min() > 0.05
    assert cover.max() < 0.13


def test_colmap_cameras_and_depth_agree_with_the_walls(capture):
    """z depth against rays of COLMAP's own cameras and the planes of the room, in float64."""
    reconstruction = pycolmap.Reconstruction(capture / "sparse" / "0")
    images = sorted(reconstruction.images.values(), key=lambda image: image.name)
    assert [image.name for image in images] == [f"view_00{k}.png" for k in range(3)]
    rows, columns = np.mgrid[:72, :96].reshape(2, -1)
    maps = depths(capture / "ground_truth" / "depth_without_object")
    for image, depth in zip(images, maps.reshape(3, -1), strict=True):
        pose = image.cam_from_world().matrix()
        plane = image.camera.cam_from_img(np.stack([columns + 0.5, rows + 0.5], -1))
        directions = np.column_stack([plane, np.ones(len(plane))]) @ pose[:, :3]  # one unit of z long
        origin = -pose[:, :3].T @ pose[:, 3]
        walls = [(0, room.LEFT), (0, room.RIGHT), (1, room.BACK), (2, 0.0)]
        reach = np.stack([(place - origin[axis]) / directions[:, axis] for axis, place in walls])
        wall_depth = np.where(reach > 0, reach, np.inf).min(0)
        assert (depth <= wall_depth * (1 + 1e-5)).all()
        assert (np.abs(depth - wall_depth) < 1e-4).mean() > 0.3


def test_unprojected_mask_is_the_object(capture):
    mask = pictures(capture / "masks")
    maps = depths(capture / "ground_truth" / "depth")
    nearer = maps < depths(capture / "ground_truth" / "depth_without_object")
    low, high = vase().vertices.min(0), vase().vertices.max(0)
    for camera, depth, view in zip(arc_cameras(96, 72, 3, 0).values(), maps, mask & nearer, strict=True):
        row, column = np.nonzero(view)
        local = np.stack(
            [(column + 0.5 - camera.cx) / camera.fx, (row + 0.5 - camera.cy) / camera.fy, np.ones(len(row))],
            -1,
        )
        world = (local * depth[view][:, None] - camera.pose[:3, 3]) @ camera.pose[:3, :3]
        assert (world > low - 1e-4).all()
        assert (world < high + 1e-4).all()
        assert np.ptp(world[:, 2]) > 0.9 * (high - low)[2]


def test_mask_is_where_the_object_changes_the_depth(capture):
    mask = pictures(capture / "masks")
    changed = depths(capture / "ground_truth" / "depth") < depths(
        capture / "ground_truth" / "depth_without_object"
    )
    assert not (changed & ~mask).any()
    for view, view_changed in zip(mask, changed, strict=True):
        grown = cv2.dilate(view_changed.astype(np.uint8), np.ones((3, 3))) > 0
        assert not (view & ~grown).any()  # partly covered pixels lie along the silhouette
    assert changed.sum() > 0.9 * mask.sum()


def test_without_shadows_only_masked_pixels_differ(shadowless):
    mask = pictures(shadowless / "masks")
    images = pictures(shadowless / "images")
    without = pictures(shadowless / "ground_truth" / "without_object")
    differs = (images != without).any(-1)
    assert not (differs & ~mask).any()
    assert differs[mask].mean() > 0.9


def test_shadow_darkens_the_rug(capture):
    mask = pictures(capture / "masks")
    change = (pictures(capture / "images") - pictures(capture / "ground_truth" / "without_object")).mean(-1)
    assert (change[~mask] < -15).mean() > 0.01
    assert np.abs(change[~mask]).mean() < 10


def test_other_material_changes_the_object_alone(capture):
    mask = pictures(capture / "masks")
    differs = (pictures(capture / "images") != pictures(capture / "ground_truth" / "other_material")).any(-1)
    assert not (differs & ~mask).any()
    assert differs[mask].mean() > 0.9


def test_other_object_shows_its_own_colour_where_it_stands(shadowless):
    other = pictures(shadowless / "ground_truth" / "other_object")
    without = pictures(shadowless / "ground_truth" / "without_object")
    differs = (other != without).any(-1)
    assert 0.03 < differs.mean() < 0.12
    red, green, blue = other[differs].mean(0)
    assert red > green > blue + 40
    for camera, view in zip(arc_cameras(96, 72, 3, 0).values(), differs, strict=True):
        corners = golden_ball().vertices @ camera.pose[:3, :3].T + camera.pose[:3, 3]
        x = corners[:, 0] / corners[:, 2] * camera.fx + camera.cx
        columns = np.flatnonzero(view.any(0))
        assert abs(columns[0] - x.min()) < 2
        assert abs(columns[-1] + 1 - x.max()) < 2


def test_sparse_points_lie_on_the_pixels_that_gave_their_colour(capture):
    reconstruction = pycolmap.Reconstruction(capture / "sparse" / "0")
    points = list(reconstruction.points3D.values())
    assert len(points) == 3 * 250
    positions = np.array([point.xyz for point in points])
    colors = np.array([point.color for point in points], float)
    found = np.zeros(len(points), bool)
    images = pictures(capture / "images")
    maps = depths(capture / "ground_truth" / "depth")
    for number, camera in enumerate(arc_cameras(96, 72, 3, 0).values()):
        local = positions @ camera.pose[:3, :3].T + camera.pose[:3, 3]
        column = np.floor(local[:, 0] / local[:, 2] * camera.fx + camera.cx).astype(int)
        row = np.floor(local[:, 1] / local[:, 2] * camera.fy + camera.cy).astype(int)
        inside = (local[:, 2] > 0) & (column >= 0) & (column < 96) & (row >= 0) & (row < 72)
        at = number, row[inside], column[inside]
        found[inside] |= (np.abs(maps[at] - local[inside, 2]) < 0.01) & (images[at] == colors[inside]).all(-1)
    assert found.mean() > 0.95  # noise moves a few to the next pixel
    assert colors.std() > 25


def test_same_seed_same_bytes(capture, tmp_path):
    again = generate(SyntheticScene(**SMALL), tmp_path / "again")
    files = sorted(file.relative_to(capture) for file in capture.rglob("*") if file.is_file())
    assert len(files) > 21
    for file in files:
        assert (capture / file).read_bytes() == (again / file).read_bytes(), file


def test_another_seed_is_another_room():
    first, second = (room.furnished_room(seed) for seed in (0, 1))
    assert len(first.tints) != len(second.tints) or (first.tints != second.tints).any()
    assert (MATERIALS["planks"].texture(0) != MATERIALS["planks"].texture(1)).mean() > 0.9
    poses = [np.stack([c.pose for c in arc_cameras(96, 72, 3, seed).values()]) for seed in (0, 1)]
    assert 0 < np.abs(poses[0] - poses[1]).max() < 0.3


def test_solids_are_closed_and_face_outwards():
    for surface, volume in (
        (box((0, 0, 0), (1, 2, 3), "oak", cell=0.5), 6.0),
        (golden_ball(), 4 / 3 * np.pi * 0.3**3),
        (revolved([(0, 0), (1, 0), (1, 0), (1, 2), (1, 2), (0, 2)], "oak", segments=200), 2 * np.pi),
    ):
        mesh = trimesh_of(surface)
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        assert mesh.volume == pytest.approx(volume, rel=0.02)
        corner_normals = surface.normals[surface.faces].mean(1)
        flat = np.cross(
            *(surface.vertices[surface.faces[:, k]] - surface.vertices[surface.faces[:, 0]] for k in (1, 2))
        )
        solid = np.linalg.norm(flat, axis=1) > 1e-9  # a cell at a pole has one empty triangle
        assert ((corner_normals * flat).sum(1)[solid] > 0).all()
        np.testing.assert_allclose(np.linalg.norm(surface.normals, axis=1), 1)


@pytest.mark.parametrize("name", MATERIALS)
def test_materials_are_seamless_and_detailed(name):
    image = MATERIALS[name].texture(0)
    side = MATERIALS[name].side
    assert image.shape == (side, side, 3)
    assert image.std() > 0.01
    if name in ("rug", "picture", "porcelain", "beach ball"):
        return  # shown once along an axis
    inner = np.abs(np.diff(image, axis=0)).mean((1, 2))
    seam = np.abs(image[0] - image[-1]).mean()
    assert seam <= 1.5 * inner.max()


@pytest.mark.parametrize(
    "wrong", [{"width": 8}, {"height": 0}, {"views": 1}, {"supersampling": 0}, {"seed": -1}]
)
def test_settings_that_make_no_capture_are_refused(wrong):
    with pytest.raises(InputError, match="use"):
        SyntheticScene(**wrong)


def test_a_folder_in_use_is_left_alone(tmp_path):
    (tmp_path / "note.txt").write_text("mine")
    with pytest.raises(InputError, match="exists already"):
        generate(SyntheticScene(**SMALL), tmp_path)
    assert (tmp_path / "note.txt").read_text() == "mine"


def test_an_unwritable_place_is_one_line(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written") as caught:
        generate(SyntheticScene(**SMALL), tmp_path / "file" / "room")
    assert "\n" not in str(caught.value)
