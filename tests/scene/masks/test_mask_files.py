"""Masks: found, matched, repaired, or refused by name."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from corner import HEIGHT, WIDTH

from diga3d_warp.errors import InputError
from diga3d_warp.pipelines.stages import masked_views
from diga3d_warp.scene.load import load_scene
from diga3d_warp.scene.masks.find import match_masks
from diga3d_warp.scene.masks.labels import read_labels
from diga3d_warp.scene.masks.objects import object_masks


@pytest.fixture
def box() -> np.ndarray:
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[40:100, 60:150] = 255
    return mask


def read(path) -> np.ndarray:
    """One mask alone, at the size of the corner's photographs."""
    masks, _ = object_masks({"m": read_labels(path, WIDTH, HEIGHT)})
    return masks["m"]


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
    np.testing.assert_array_equal(read(tmp_path / "m.png"), expected)


def test_jpeg_noise_is_no_mask(tmp_path, box):
    cv2.imwrite(str(tmp_path / "m.jpg"), box, [cv2.IMWRITE_JPEG_QUALITY, 30])
    assert (cv2.imread(str(tmp_path / "m.jpg"), 0) > 0).sum() > (box > 0).sum() + 100
    assert (read(tmp_path / "m.jpg") != (box > 0)).mean() < 0.002


def test_rows_too_many_are_stretched(tmp_path, box):
    """SPIn-NeRF's masks have 576 rows for 567, and its loader resizes them to the image."""
    high = cv2.resize(box, (WIDTH, HEIGHT + 3), interpolation=cv2.INTER_NEAREST_EXACT)
    cv2.imwrite(str(tmp_path / "m.png"), high)
    mask = read(tmp_path / "m.png")
    assert mask.shape == box.shape and (mask != (box > 0)).sum() <= 2 * 90, "a row above and below at most"
    last = np.zeros((HEIGHT + 3, WIDTH), np.uint8)
    last[-1] = 255
    cv2.imwrite(str(tmp_path / "m.png"), last)
    assert read(tmp_path / "m.png")[-1].all(), "the last row of the mask is the last of the image"


@pytest.mark.parametrize("factor", [2, 0.5])
def test_another_size_of_the_same_aspect_ratio(tmp_path, box, factor):
    size = (int(WIDTH * factor), int(HEIGHT * factor))
    cv2.imwrite(str(tmp_path / "m.png"), cv2.resize(box, size, interpolation=cv2.INTER_NEAREST_EXACT))
    np.testing.assert_array_equal(read(tmp_path / "m.png"), box > 0)


@pytest.mark.parametrize("shape", [(HEIGHT + 10, WIDTH), (HEIGHT, WIDTH + 20), (WIDTH, HEIGHT)])
def test_another_aspect_ratio_is_refused(tmp_path, shape):
    cv2.imwrite(str(tmp_path / "m.png"), np.ones(shape, np.uint8))
    with pytest.raises(
        InputError, match=rf"m\.png: the mask is {shape[1]} x {shape[0]} px for an image of 240"
    ):
        read(tmp_path / "m.png")


def test_a_damaged_mask(tmp_path):
    (tmp_path / "m.png").write_bytes(b"")
    with pytest.raises(InputError, match=r"m\.png: not readable"):
        read(tmp_path / "m.png")


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
    """Some are noted; all of them are refused by an edit, and by nothing else."""
    corner.write_masks(colmap_scene / "masks")
    for i, path in enumerate(sorted((colmap_scene / "masks").iterdir())[1:], start=1):
        cv2.imwrite(str(path), np.full((HEIGHT, WIDTH), level, np.uint8))
        if i == 2:
            (note,) = load_scene(colmap_scene).notes
            assert note.startswith("2 views have ") and note.endswith("view_01, view_02")
    scene = load_scene(colmap_scene)
    assert scene.mask_problem is not None and match in scene.mask_problem
    assert all(view.mask is None for view in scene.views)
    assert scene.notes == (f"masks are not used: {scene.mask_problem}",)
    with pytest.raises(InputError, match=match) as caught:
        masked_views(scene)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda folder: [file.unlink() for file in folder.iterdir()], "there are no mask images"),
        (
            lambda folder: [f.rename(f.with_name(f"x{f.name}")) for f in folder.iterdir()],
            "no mask has the name",
        ),
        (lambda folder: (folder / "view_02.png").write_text("hello"), "not readable as an image"),
        (lambda folder: cv2.imwrite(str(folder / "view_02.png"), np.ones((50, 50))), "50 x 50 px"),
    ],
)
def test_masks_of_no_use_are_left_out(colmap_scene, corner, spoil, said):
    corner.write_masks(colmap_scene / "masks")
    spoil(colmap_scene / "masks")
    scene = load_scene(colmap_scene)
    assert said in scene.mask_problem and len(scene.notes) == 1
    assert all(view.mask is None for view in [*scene.views, *scene.test_views])


@pytest.mark.parametrize(
    "form", ["{}_mask", "mask-{}", "{}.jpg.mask", "{}_Segmentation", "{}.JPG", "{}_MASK"]
)
def test_masks_with_an_addition_to_their_names(colmap_scene, corner, form):
    corner.write_masks(colmap_scene / "masks", [form.format(name) for name in corner.images])
    scene = load_scene(colmap_scene)
    assert all(view.mask is not None for view in scene.views)
    plain = form == "{}.JPG"
    assert len(scene.notes) == (0 if plain else 1)
    assert plain or "matched by a part of their names" in scene.notes[0]


def matched(folder, names, keys):
    for name in names:
        path = folder / f"{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), np.zeros((4, 4), np.uint8))
    found = match_masks(folder, keys)
    return {key: path.relative_to(folder).with_suffix("").as_posix() for key, path in found.files.items()}


@pytest.mark.parametrize(
    ("names", "keys", "expected"),
    [
        (["a/1", "b/1"], ["a/1", "b/1"], {"a/1": "a/1", "b/1": "b/1"}),
        (["a_1", "b_1"], ["a/1", "b/1"], {"a/1": "a_1", "b/1": "b_1"}),
        (["1"], ["a/1", "b/2"], {"a/1": "1"}),
        (["x/1", "x/2"], ["1", "2"], {"1": "x/1", "2": "x/2"}),
        (["x/1", "y/1", "2"], ["1", "2"], {"2": "2"}),
        (["A1"], ["a1"], {"a1": "A1"}),
        (["1_mask", "1_alpha", "2"], ["1", "2"], {"2": "2"}),
        (["1", "1_mask"], ["1"], {"1": "1"}),
    ],
)
def test_whose_mask_it_is(tmp_path, names, keys, expected):
    assert matched(tmp_path / "masks", names, keys) == expected


def test_a_folder_of_masks_for_each_object(tmp_path):
    with pytest.raises(InputError, match=r"of one image \(chair/1 and lamp/1\); name one of their folders"):
        matched(tmp_path / "masks", ["chair/1", "lamp/1", "chair/2", "lamp/2"], ["1", "2"])


def test_a_choice_of_objects_without_masks(colmap_scene):
    with pytest.raises(InputError, match="there are no masks to choose objects from"):
        load_scene(colmap_scene, mask_ids=(3,))
    (colmap_scene / "masks").mkdir()
    with pytest.raises(InputError, match="there are no mask images in this folder"):
        load_scene(colmap_scene, mask_ids=(3,))


def test_a_mask_of_two_images(tmp_path):
    with pytest.raises(InputError, match=r"1\.png: the images a/1 and b/1 both have the name of this mask"):
        matched(tmp_path / "masks", ["1", "2"], ["a/1", "a/2", "b/1"])
