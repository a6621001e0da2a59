"""Find images: which file a calibration means, and what is said where that was guessed."""

from __future__ import annotations

from pathlib import Path

import pytest

from diga3d_warp.scene.photographs.find_images import find_images


def found(names: list[str], files: list[str]) -> tuple[dict[str, str], list[str]]:
    folder = Path("images")
    match = find_images(names, folder, [folder / file for file in files])
    return {name: path.relative_to(folder).as_posix() for name, path in match.files.items()}, [*match.notes]


@pytest.mark.parametrize("beside", ["a.png", "a.jpeg", "A.jpg", "b/a.jpg", "a.jpg.png"])
def test_the_named_file_is_read_whatever_lies_beside_it(beside):
    assert found(["a.jpg"], [beside, "a.jpg"]) == ({"a.jpg": "a.jpg"}, [])


@pytest.mark.parametrize(
    ("name", "file"),
    [
        ("a.jpg", "A.JPG"),
        ("a", "a.JPG"),
        ("IMG.2", "IMG.2.png"),
        ("caf\u00e9.jpg", "cafe\u0301.jpg"),
        ("front/a.jpg", "Front/A.jpg"),
    ],
)
def test_spellings_that_are_one_name(name, file):
    assert found([name], [file, "other.jpg"]) == ({name: file}, [])


@pytest.mark.parametrize(
    ("name", "file", "note"),
    [
        ("a.jpg", "a.png", "1 images have another ending than the calibration says: a.jpg -> a.png"),
        ("a.HEIC", "a.jpg", "1 images have another ending"),
        ("a.jpg", "left/a.jpg", "1 images are found by a part of their names only: a.jpg -> left/a.jpg"),
        ("IMG", "IMG.2.MP4_00.jpg", "found by a part of their names only"),
    ],
)
def test_guesses_are_noted(name, file, note):
    files, notes = found([name], [file, "other.jpg"])
    assert files == {name: file}
    assert len(notes) == 1 and note in notes[0]


def test_nothing_is_guessed_where_two_files_fit():
    assert found(["a.jpg"], ["left/a.jpg", "right/a.jpg"]) == ({}, [])
    assert found(["x/a.jpg"], ["X/a.jpg", "x/A.jpg"])[0] == {}


def test_a_photograph_is_likelier_than_a_mask_of_its_name():
    files, (note,) = found(["a"], ["a.png", "a.jpg"])
    assert files == {"a": "a.jpg"}
    assert note.endswith("several files fit: of a.jpg, a.png the first is read")


def test_no_file_is_read_for_two_names():
    assert found(["a.jpg", "a.png"], ["a.png"])[0] == {"a.png": "a.png"}
    assert found(["left/a.jpg", "right/a.jpg"], ["a.jpg"]) == ({}, [])


@pytest.mark.parametrize(("page", "word"), [("cp1252", "Büro"), ("cp932", "部屋"), ("cp1251", "дом")])
@pytest.mark.parametrize("side", ["calibration", "disk"])
def test_code_pages(page, word, side):
    names = [f"{word}{number}.jpg" for number in range(3)]
    odd = [name.encode(page).decode("utf-8", "surrogateescape") for name in names]
    files, (note,) = found(odd, names) if side == "calibration" else found(names, odd)
    assert len(files) == 3 and all(key[-5] == file[-5] for key, file in files.items())
    assert note == f"images: image names that are not UTF-8 are read as {page}"


@pytest.mark.parametrize("beside", ["b.png", "masks/b.jpg", "depth/B.jpg"])
def test_what_has_the_name_of_a_missing_image_is_not_read_for_it(beside):
    """Its mask or its depth: other images of that ending are there, so none was converted."""
    assert found(["a.jpg", "b.jpg"], ["a.jpg", beside]) == ({"a.jpg": "a.jpg"}, [])


def test_notes_are_short_however_many_images():
    names = [f"photograph_{number:05d}" for number in range(1200)]
    files, notes = found([f"{name}.jpg" for name in names], [f"{name}.png" for name in names])
    assert len(files) == 1200 and sum(map(len, notes)) < 200
