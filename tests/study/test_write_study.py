"""A study's page: what is in it, what it hides, and runs that do not compare."""

from __future__ import annotations

import json
import re
import shutil

import cv2
import numpy as np
import pytest

from diga3d_warp import cli
from diga3d_warp.errors import InputError
from diga3d_warp.files import write_image
from diga3d_warp.study import questions
from diga3d_warp.study.seal import unseal
from diga3d_warp.study.write import write_study


def data_of(page) -> dict:
    return json.loads(page.read_text(encoding="utf-8").split('id="study">')[1].split("</script>")[0])


def test_the_page_names_no_run_and_loads_nothing(make_run, tmp_path):
    runs = [make_run("secret_one", 200), make_run("secret_two", 120), make_run("secret_three", 90)]
    study = write_study([runs], tmp_path / "out" / "study.html")
    text = study.page.read_text(encoding="utf-8")
    assert study.folder is None and "secret" not in text and str(tmp_path) not in text
    assert not re.search(r"https?://|src=\"[^\"]|@import", text)
    data = data_of(study.page)
    (question,) = data["questions"]
    assert "white marble" in question["instruction"]
    codes = [candidate["code"] for candidate in question["candidates"]]
    assert codes == sorted(codes) and len(set(codes)) == 3
    assert unseal(data["sealed"])["methods"] == ["secret_one", "secret_two", "secret_three"]


def test_codes_lead_to_the_pictures_of_their_method(make_run, tmp_path):
    shades = [200, 120, 90, 60]
    runs = [make_run(f"run_{shade}", shade) for shade in shades]
    study = write_study([runs], tmp_path / "study.html", inline_most=0)
    assert study.folder == tmp_path / "study_files"
    data = data_of(study.page)
    methods = unseal(data["sealed"])["questions"][0]["candidates"]
    for candidate in data["questions"][0]["candidates"]:
        pictures = [cv2.imread(str(tmp_path / address)) for address in candidate["media"]]
        assert [round(float(picture.mean()), -1) for picture in pictures] == [
            shades[methods[candidate["code"]]] - step for step in (0, 10, 20)
        ]
    names = [file.name for file in study.folder.iterdir()]
    assert all(re.fullmatch(r"[0-9a-f]{20}\.jpg", name) for name in names)
    marked = cv2.imread(str(tmp_path / data["questions"][0]["object"])).astype(int)
    assert marked.std() > 5, "the object is outlined"


def test_same_runs_same_bytes_and_no_other_study_is_overwritten(make_run, tmp_path):
    runs = [make_run("a", 200), make_run("b", 120)]
    page = write_study([runs], tmp_path / "study.html").page
    first = page.read_bytes()
    assert write_study([runs], page).page.read_bytes() == first
    with pytest.raises(InputError, match="another study"):
        write_study([[runs[0], make_run("c", 90)]], page)
    assert page.read_bytes() == first
    report = tmp_path / "report.html"
    report.write_text("<html>")
    with pytest.raises(InputError, match="is no study"):
        write_study([runs], report)


def test_sizes_are_made_equal_and_other_shapes_refused(make_run, tmp_path):
    large, small = make_run("large", 200, size=(80, 60)), make_run("small", 120)
    page = write_study([[large, small]], tmp_path / "study.html", inline_most=0).page
    data = data_of(page)
    addresses = [a for c in data["questions"][0]["candidates"] for a in c["media"]]
    assert {cv2.imread(str(tmp_path / address)).shape for address in addresses} == {(30, 40, 3)}
    with pytest.raises(InputError, match="one shape"):
        write_study([[large, make_run("wide", 90, size=(80, 30))]], tmp_path / "other.html")


def test_another_methods_pictures_and_views_that_not_all_have(make_run, tmp_path, capfd):
    run, other = make_run("ours", 200), tmp_path / "in2n"
    for view in ("view_000", "view_002"):
        write_image(other / f"{view}.png", np.full((30, 40, 3), 99, np.uint8))
    assert cli.main(["study", str(run), str(other), "--out", str(tmp_path / "study.html")]) == 0
    said = capfd.readouterr().err
    assert "in2n is no run: its pictures are shown" in said and "1 views that not all runs have" in said
    assert [len(c["media"]) for c in data_of(tmp_path / "study.html")["questions"][0]["candidates"]] == [2, 2]


def test_methods_of_several_questions(make_run, tmp_path):
    first = [make_run("ours/bear", 200), make_run("lama/bear", 120)]
    second = [make_run("ours/can", 190, scene="can"), make_run("lama/can", 110, scene="can")]
    with pytest.raises(InputError, match="--names"):
        write_study([first, second], tmp_path / "study.html")
    page = write_study([first, second], tmp_path / "study.html", names=["ours", "lama"]).page
    data = data_of(page)
    assert unseal(data["sealed"])["methods"] == ["ours", "lama"] and len(data["questions"]) == 2
    for names in (["ours"], ["ours", "ours"], ["ours", " "]):
        with pytest.raises(InputError, match="--names"):
            write_study([first, second], page, names=names)
    with pytest.raises(InputError, match="same order"):
        write_study([first, [*second, make_run("x/can", 80, scene="can")]], page, names=["ours", "lama"])
    with pytest.raises(InputError, match="two questions"):
        write_study([first, first], page, names=["ours", "lama"])


def test_a_removals_prompt_is_not_the_instruction(make_run, tmp_path):
    runs = [make_run("a", 200, "remove", "a wall"), make_run("b", 120, "remove", None)]
    (question,) = data_of(write_study([runs], tmp_path / "study.html").page)["questions"]
    assert question["instruction"] == "Remove the object." and "never been there" in question["ask"]


@pytest.mark.parametrize(
    "prompt", ["</script><b>gold</b>", "caf\u00e9 \u2028 \U0001f431", "byte \udcff", "a\nb"]
)
def test_any_prompt_stays_text(make_run, tmp_path, prompt):
    runs = [make_run("a", 200, prompt=prompt), make_run("b", 120, prompt=prompt)]
    page = write_study([runs], tmp_path / "study.html").page
    assert page.read_text(encoding="utf-8").count("</script") == 2
    (question,) = data_of(page)["questions"]
    assert prompt in question["instruction"]


def _refusals(make_run, tmp_path):
    a, b = make_run("a", 200), make_run("b", 120)
    empty, unfinished, damaged = tmp_path / "empty", make_run("unfinished", 90), make_run("damaged", 80)
    empty.mkdir()
    for view in list((unfinished / "views" / "after").iterdir()):
        view.unlink()
    (damaged / "views" / "after" / "view_000.png").write_bytes(b"no picture")
    copy = make_run("copy", 200)
    fit = make_run("fit", 70, "fit", None)
    asset = make_run("nothing_asked", 70, "replace", None)
    return {
        "one run": ([a], "2 to 4 runs, not 1"),
        "five runs": ([a, b, a, b, a], "2 to 4 runs, not 5"),
        "the same run twice": ([a, tmp_path / "empty" / ".." / "a"], "given twice"),
        "a copy": ([a, copy], "same pictures"),
        "another scene": ([a, make_run("other", 60, scene="can")], "another scene"),
        "another prompt": ([a, make_run("gold", 60, prompt="gold")], "another prompt ('gold')"),
        "another edit": ([a, make_run("replaced", 60, "replace")], "one edit"),
        "no views": ([a, unfinished], "has no views"),
        "no run": ([a, empty], "holds no run"),
        "absent": ([a, tmp_path / "absent"], "is not a folder"),
        "a fit": ([a, fit], "edits nothing"),
        "nothing asked": ([asset, asset.parent / "b"], "names no prompt"),
        "no common view": ([a, make_run("elsewhere", 50, views=("x", "y"))], "no view in common"),
        "a damaged view": ([a, damaged], "view_000.png"),
        "not rendered": ([a, b, "--video"], "no splats"),
        "nothing": ([], "no run is given"),
    }  # fmt: skip


def test_runs_that_do_not_compare(make_run, tmp_path, capfd):
    for what, (words, said) in _refusals(make_run, tmp_path).items():
        assert cli.main(["study", *map(str, words), "--out", str(tmp_path / "study.html")]) == 2, what
        written = capfd.readouterr()
        assert written.err.count("\n") == 1 and said in written.err, (what, written.err)
        assert written.out == "" and not list(tmp_path.glob("study*")), what


@pytest.mark.parametrize(("name", "said"), [("study.txt", ".html"), ("folder.html", "is a folder")])
def test_places_that_are_no_page(make_run, tmp_path, name, said):
    (tmp_path / "folder.html").mkdir()
    with pytest.raises(InputError, match=said):
        write_study([[make_run("a", 200), make_run("b", 120)]], tmp_path / name)


def test_a_video_flies_through_the_splats(toy_run, tmp_path, monkeypatch):
    monkeypatch.setattr(questions, "FRAMES", 3)
    for side in ("before", "after"):
        write_image(toy_run.folder / "views" / side / "view_1.png", np.zeros((36, 48, 3), np.uint8))
    other = shutil.copytree(toy_run.folder, tmp_path / "unedited")
    shutil.copyfile(other / "source.ply", other / "point_cloud.ply")
    study = write_study([[toy_run.folder, other]], tmp_path / "study.html", video=True, inline_most=0)
    (question,) = data_of(study.page)["questions"]
    methods = unseal(data_of(study.page)["sealed"])["questions"][0]["candidates"]
    source = frames_of(tmp_path / question["source"][0])
    films = {methods[c["code"]]: frames_of(tmp_path / c["media"][0]) for c in question["candidates"]}
    assert source.shape[0] == 3 and source.std() > 10
    np.testing.assert_array_equal(films[1], source)
    assert np.abs(films[0].astype(float) - source).max() > 40, "the edit shows"


def frames_of(path) -> np.ndarray:
    video = cv2.VideoCapture(str(path))
    frames = []
    while (read := video.read())[0]:
        frames.append(read[1])
    return np.stack(frames)
