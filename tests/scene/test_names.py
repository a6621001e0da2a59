"""Names: which file a calibration means, what a view is called, and what stays inside the scene."""

from __future__ import annotations

from pathlib import Path

import pytest

from diga3d_warp.errors import InputError
from diga3d_warp.scene.names import find_images, image_key, inside, listed, view_names


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


def test_notes_are_short_however_many_images():
    names = [f"photograph_{number:05d}" for number in range(1200)]
    assert listed(names).endswith("photograph_00007 and 1192 more")
    _, notes = found([f"{name}.jpg" for name in names], [f"{name}.png" for name in names])
    assert sum(map(len, notes)) < 200


def test_listed_names_can_be_printed():
    text = listed(["a\nb", "B\udcfcro", "\udc81\x1b[31m"])
    assert text.isprintable() and "Büro" in text
    text.encode()


@pytest.mark.parametrize(
    ("keys", "names"),
    [
        (["a", "b"], ["a", "b"]),
        (["front/1", "back/1", "2"], ["front_1", "back_1", "2"]),
        (["a/b_c", "a_b/c", "x/b_c", "y/c"], ["a_b_c", "a_b_c_2", "x_b_c", "y_c"]),
        (["IMG", "img"], ["IMG", "img_2"]),
        ([".hidden", ".."], ["hidden", "_"]),
        (["a\nb", "tab\t"], ["a_b", "tab_"]),
    ],
)
def test_view_names_are_file_names(keys, names):
    assert [*view_names(keys).values()] == names


def test_long_names_leave_room_for_endings():
    first, second = view_names(["é" * 120, "/".join(["x" * 90] * 4)]).values()
    assert len(first.encode()) <= 200 and len(second.encode()) <= 200


@pytest.mark.parametrize(
    "name",
    [
        "../a.jpg",
        "..\\a.jpg",
        "/etc/a.jpg",
        "C:\\a.jpg",
        "x/../../a.jpg",
        "//host/a.jpg",
    ],
)
def test_paths_that_leave_the_scene(tmp_path, name):
    with pytest.raises(InputError, match="leaves the scene folder"):
        inside(tmp_path, name, tmp_path / "transforms.json")


@pytest.mark.parametrize("name", ["", " ", "a\0b", "x" * 300, "/" + "é" * 200 + "/a.jpg"])
def test_names_that_no_file_has(tmp_path, name):
    with pytest.raises(InputError, match="is no name of a file"):
        inside(tmp_path, name, tmp_path / "transforms.json")


def test_paths_of_another_machine_end_in_the_scene(tmp_path):
    (tmp_path / "images" / "x").mkdir(parents=True)
    (tmp_path / "images" / "x" / "a.jpg").touch()
    source = tmp_path / "transforms.json"
    for name in ("/data/room/images/x/a.jpg", "D:\\room\\images\\x\\a.jpg", "../room/images/x/a.jpg"):
        assert inside(tmp_path, name, source) == "images/x/a.jpg"
    assert inside(tmp_path, "/data/x/a", source, [tmp_path / "images"]) == "x/a"
    assert inside(tmp_path, "./images//x/./b.jpg", source) == "images/x/b.jpg"


def test_keys_lose_known_endings_only():
    assert image_key("a/IMG.2.JPG") == "a/IMG.2"
    assert image_key("a/IMG.2") == "a/IMG.2"
    assert image_key("a.HEIC") == "a"
    assert image_key("cafe\u0301.png") == "caf\u00e9"
