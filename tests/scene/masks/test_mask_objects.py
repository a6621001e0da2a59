"""Masks in every form that people store: which of their pixels are the object, or why they are no masks."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from diga3d_warp.errors import InputError
from diga3d_warp.scene.masks.labels import Labels, read_labels
from diga3d_warp.scene.masks.objects import object_masks

WIDTH, HEIGHT = 96, 72


def disc(x: int, y: int, radius: int) -> np.ndarray:
    plane = np.zeros((HEIGHT, WIDTH), np.uint8)
    cv2.circle(plane, (x, y), radius, 1, -1)
    return plane > 0


ONE, TWO, THREE = disc(20, 30, 14), disc(60, 20, 10), disc(70, 55, 12)
NUMBERS = (ONE * 1 + TWO * 2 + THREE * 3).astype(np.uint8)
VOC = (0, 0, 0, 128, 0, 0, 0, 128, 0, 128, 128, 0)


def write(
    folder: Path, planes: Mapping[str, np.ndarray | Image.Image], suffix: str = ".png"
) -> dict[str, Labels]:
    found = {}
    for name, plane in planes.items():
        image = plane if isinstance(plane, Image.Image) else Image.fromarray(plane)
        buffer = io.BytesIO()
        image.save(buffer, format={".png": "PNG", ".jpg": "JPEG", ".tif": "TIFF"}[suffix])
        (folder / (name + suffix)).write_bytes(buffer.getvalue())
        found[name] = read_labels(folder / (name + suffix), WIDTH, HEIGHT)
    return found


def soft(mask: np.ndarray, level: int = 255, blur: float = 2.0) -> np.ndarray:
    return (cv2.GaussianBlur(mask.astype(np.float32), (0, 0), blur) * level).astype(np.uint8)


def palette(plane: np.ndarray, transparent: int | None = None) -> Image.Image:
    image = Image.fromarray(plane).convert("L")
    placed = Image.new("P", image.size)
    placed.putpalette([*VOC, *(0, 0, 0) * 251, 224, 224, 192])
    placed.putdata(image.tobytes())
    if transparent is not None:
        placed.info["transparency"] = transparent
    return placed


def colors(plane: np.ndarray) -> np.ndarray:
    return np.array([[0, 0, 0], [200, 10, 10], [10, 10, 200], [10, 200, 10]], np.uint8)[plane]


FORMS = {
    "numbers": NUMBERS,
    "16-bit numbers": NUMBERS.astype(np.uint16) * 300,
    "palette": palette(NUMBERS),
    "palette, black transparent": palette(NUMBERS, 0),
    "colours": colors(NUMBERS),
    "spread numbers": np.array([0, 85, 170, 255], np.uint8)[NUMBERS],
}


@pytest.mark.parametrize("form", FORMS)
def test_several_objects_are_said_and_can_be_chosen(tmp_path, form):
    labels = write(tmp_path, {"a": FORMS[form], "b": FORMS[form]})
    masks, (note,) = object_masks(labels)
    np.testing.assert_array_equal(masks["a"], NUMBERS > 0)
    assert "choose with --mask-ids" in note and note.count("% in 2 views") == 3
    names = {"16-bit numbers": (300, 600, 900), "spread numbers": (85, 170, 255)}.get(form, (1, 2, 3))
    assert all(f"{name} (" in note for name in names)
    # Colours count in the order of their values: green, blue, red in RGB is 0x0a0ac8, 0x0ac80a, 0xc80a0a.
    wanted = {1: 2, 2: 3, 3: 1} if form == "colours" else {1: 1, 2: 2, 3: 3}
    for place, name in enumerate(names, start=1):
        chosen, notes = object_masks(labels, [name])
        np.testing.assert_array_equal(chosen["b"], wanted[place] == NUMBERS)
        assert notes == []
    both, _ = object_masks(labels, names[:2])
    assert both["a"].sum() == sum((wanted[place] == NUMBERS).sum() for place in (1, 2))


def test_an_object_that_no_mask_holds(tmp_path):
    with pytest.raises(InputError, match=r"no mask holds object 7: the masks hold 1 \(.* in 1 views\), 2 \("):
        object_masks(write(tmp_path, {"a": NUMBERS}), [7])
    with pytest.raises(InputError, match=r"no mask holds object 3: the masks hold 255 \("):
        object_masks(write(tmp_path, {"b": ONE.astype(np.uint8) * 255}), [3])


def test_255_beside_numbers_is_ignored(tmp_path):
    rim = cv2.dilate(NUMBERS, np.ones((5, 5), np.uint8)) != NUMBERS
    plane = np.where(rim, 255, NUMBERS).astype(np.uint8)
    labels = write(tmp_path, {"a": plane})
    masks, notes = object_masks(labels)
    np.testing.assert_array_equal(masks["a"], (plane > 0) & (plane < 255))
    assert "label 255 is taken for pixels to ignore" in notes[1] and "255 (" not in notes[0]
    chosen, _ = object_masks(labels, [255])
    np.testing.assert_array_equal(chosen["a"], plane == 255)


def test_255_beside_one_number_is_ignored(tmp_path):
    plane = np.where(ONE, 1, np.where(THREE, 255, 0)).astype(np.uint8)
    masks, notes = object_masks(write(tmp_path, {"a": plane}))
    np.testing.assert_array_equal(masks["a"], ONE)
    assert notes[0].endswith("all are taken") and "ignore" in notes[1]


@pytest.mark.parametrize(
    ("first", "second", "said"), [(1, 255, 0), (1, 1, 0), (38, 38, 0), (1, 2, 1), (128, 255, 1)]
)
def test_files_with_one_label_each(tmp_path, first, second, said):
    """SPIn-NeRF stores 1 in some folders and 255 in others: one object. Other numbers may be two."""
    labels = write(
        tmp_path, {"a": ONE * np.uint8(first), "b": TWO * np.uint8(second), "c": NUMBERS * np.uint8(0)}
    )
    masks, notes = object_masks(labels)
    np.testing.assert_array_equal(masks["a"], ONE)
    np.testing.assert_array_equal(masks["b"], TWO)
    assert not masks["c"].any() and len(notes) == said


@pytest.mark.parametrize("level", [255, 110, 60])
@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_soft_edges_are_cut_in_their_middle(tmp_path, suffix, level):
    planes = {"a": soft(ONE | THREE, level), "b": soft(TWO, level), "empty": soft(ONE & TWO)}
    masks, notes = object_masks(write(tmp_path, planes, suffix))
    assert notes == [] and not masks["empty"].any(), "noise of JPEG is no object"
    assert (masks["a"] != (ONE | THREE)).mean() < 0.02 and (masks["b"] != TWO).mean() < 0.01


def test_antialiased_edges(tmp_path):
    big = cv2.resize((ONE | THREE).astype(np.uint8) * 255, None, fx=4, fy=4, interpolation=cv2.INTER_CUBIC)
    plane = cv2.resize(big, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    assert len(np.unique(plane)) > 4
    masks, notes = object_masks(write(tmp_path, {"a": plane}))
    assert notes == [] and (masks["a"] != (ONE | THREE)).mean() < 0.01


def test_16_bit_soft_edges(tmp_path):
    plane = cv2.GaussianBlur(ONE.astype(np.float32), (0, 0), 2.0) * 65535
    masks, _ = object_masks(write(tmp_path, {"a": plane.astype(np.uint16)}))
    assert (masks["a"] != ONE).mean() < 0.01


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_soft_edges_in_one_colour(tmp_path, suffix):
    plane = np.dstack([soft(ONE), *[np.zeros((HEIGHT, WIDTH), np.uint8)] * 2])
    masks, _ = object_masks(write(tmp_path, {"a": plane}, suffix))
    assert (masks["a"] != ONE).mean() < 0.02


def photograph() -> np.ndarray:
    noise = np.random.default_rng(3).integers(0, 256, (9, 12, 3), dtype=np.uint8)
    return cv2.resize(noise, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)


PICTURES = {
    "photograph": photograph(),
    "grey photograph": np.asarray(Image.fromarray(photograph()).convert("L")),
    "painted red": np.where(ONE[..., None], np.array([255, 0, 0], np.uint8), photograph()),
    "tinted": np.where(ONE[..., None], photograph() // 2 + np.array([127, 0, 0], np.uint8), photograph()),
    "palette of a photograph": Image.fromarray(photograph()).quantize(200),
    "cut out on black": np.where(disc(48, 36, 30)[..., None], photograph(), 0).astype(np.uint8),
    "depth": np.linspace(30, 220, HEIGHT * WIDTH).reshape(HEIGHT, WIDTH).astype(np.uint8),
}


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
@pytest.mark.parametrize("kind", PICTURES)
def test_pictures_are_no_masks(tmp_path, kind, suffix):
    picture = PICTURES[kind]
    if suffix == ".jpg" and isinstance(picture, Image.Image):
        picture = picture.convert("RGB")
    labels = write(tmp_path, {"a": picture}, suffix)
    with pytest.raises(InputError, match=r"a\.(png|jpg): not a mask but a picture") as caught:
        object_masks(labels)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("dark", [1, 100])
def test_what_lies_along_the_borders_is_no_object(tmp_path, dark):
    plane = np.where(ONE, 200, dark).astype(np.uint8)
    masks, _ = object_masks(write(tmp_path, {"a": plane}))
    np.testing.assert_array_equal(masks["a"], ONE)


def test_two_colours(tmp_path):
    """As matplotlib writes a mask in its colours: violet and yellow."""
    plane = np.where(ONE[..., None], np.array([253, 231, 36], np.uint8), np.array([68, 1, 84], np.uint8))
    masks, notes = object_masks(write(tmp_path, {"a": plane}))
    np.testing.assert_array_equal(masks["a"], ONE)
    assert notes == []


def test_shades_hold_no_numbers(tmp_path):
    with pytest.raises(InputError, match="the masks hold shades, and no numbers of objects"):
        object_masks(write(tmp_path, {"a": soft(ONE)}, ".jpg"), [1])


@pytest.mark.parametrize(
    ("plane", "expected"),
    [
        (ONE.astype(np.float32), ONE),
        (NUMBERS.astype(np.int32), NUMBERS > 0),
        (NUMBERS.astype(np.float32) * 400, NUMBERS > 0),
    ],
)
def test_tiff_of_other_numbers(tmp_path, plane, expected):
    (tmp_path / "a.tif").write_bytes(cv2.imencode(".tif", plane)[1].tobytes())
    masks, _ = object_masks({"a": read_labels(tmp_path / "a.tif", WIDTH, HEIGHT)})
    np.testing.assert_array_equal(masks["a"], expected)


def test_many_numbers_are_listed_in_one_short_line(tmp_path):
    plane = np.kron(np.arange(1, 101, dtype=np.uint8).reshape(10, 10), np.ones((6, 8), np.uint8))
    plane = cv2.copyMakeBorder(plane, 6, 6, 8, 8, cv2.BORDER_CONSTANT)
    masks, (note,) = object_masks(write(tmp_path, {"a": plane}))
    assert "and 88 more" in note and len(note) < 600
    np.testing.assert_array_equal(masks["a"], plane > 0)
