"""The page in a headless Chromium: voted through twice, by keyboard and by hand, and tallied."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from diga3d_warp.study.seal import unseal
from diga3d_warp.study.tally import tally
from diga3d_warp.study.write import write_study

playwright = pytest.importorskip("playwright.sync_api")

CHROMIUM = next(
    (found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))),
    None,
)
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")

METHODS = {"ours": 220, "lama": 160, "warp": 110, "none": 70}
SHADE = """place => {
  const canvas = document.querySelectorAll('#grid canvas')[place];
  const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext('2d');
  copy.drawImage(canvas, 0, 0);
  return copy.getImageData(5, 5, 1, 1).data[0];
}"""
"""Red of a pixel of a picture on the page: the source is the first."""


@pytest.fixture(scope="module")
def browser() -> Iterator:
    with playwright.sync_playwright() as running:
        opened = running.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield opened
        opened.close()


@pytest.fixture
def study(make_run, tmp_path) -> Path:
    questions = [
        [
            make_run(f"{name}/{scene}", shade - 5 * (scene == "can"), scene=scene)
            for name, shade in METHODS.items()
        ]
        for scene in ("bear", "can")
    ]
    return write_study(questions, tmp_path / "study.html", names=list(METHODS)).page


@pytest.fixture
def page(browser, study) -> Iterator:
    context = browser.new_context(reduced_motion="reduce")  # which stands still at the first view
    opened = context.new_page()
    opened.faults = []
    opened.on("pageerror", lambda error: opened.faults.append(str(error)))
    opened.on("console", lambda line: opened.faults.append(line.text))
    opened.on(
        "request", lambda request: opened.faults.append(request.url) if "http" in request.url[:5] else None
    )
    opened.goto(study.as_uri())
    yield opened
    assert opened.faults == []
    context.close()


def place_of(page, shade: int) -> int:
    """Number, as on the page, of the result with a shade."""
    page.wait_for_function(f"() => ({SHADE})(0) > 0 && ({SHADE})(4) > 0")
    assert abs(page.evaluate(SHADE, 0) - 20) < 6, "the source comes first"
    shades = [page.evaluate(SHADE, place) for place in range(1, 5)]
    return 1 + min(range(4), key=lambda place: abs(shades[place] - shade))


def saved(page, to: Path) -> Path:
    with page.expect_download() as download:
        page.click("#save")
    download.value.save_as(to)
    return to


def test_two_participants_vote_and_are_tallied(page, tmp_path):
    votes = tmp_path / "votes"
    for scene in (0, 5):  # by keyboard
        page.keyboard.press(str(place_of(page, METHODS["ours"] - scene)))
        page.keyboard.press("ArrowRight")
    assert page.inner_text("#answered") == "You answered all questions."
    first = saved(page, votes / "first.json")
    page.on("dialog", lambda dialog: dialog.accept())
    page.click("#another")
    assert page.inner_text("#progress") == "Question 1 of 2" and page.is_disabled("#next")
    page.click(f"#choices button:nth-child({place_of(page, METHODS['ours'])})")
    page.click("#next")
    page.click(f"#grid figure:nth-child({1 + place_of(page, METHODS['warp'] - 5)}) button")
    page.click("#next")
    second = saved(page, votes / "second.json")
    result = tally([first, second])
    assert {name: share.votes for name, share in result.methods.items()} == {
        "ours": 3, "lama": 0, "warp": 1, "none": 0
    }  # fmt: skip
    assert result.participants == 2 and not result.notes


def test_answers_and_places_survive_a_reload(page, study):
    page.keyboard.press("3")
    order = [page.evaluate(SHADE, place_of(page, shade)) for shade in METHODS.values()]
    page.keyboard.press("ArrowRight")
    page.reload()
    assert page.inner_text("#progress") == "Question 2 of 2"
    page.keyboard.press("ArrowLeft")
    assert [page.evaluate(SHADE, place_of(page, shade)) for shade in METHODS.values()] == order
    assert page.get_attribute("#choices button:nth-child(3)", "aria-pressed") == "true"
    page.evaluate("() => localStorage.setItem(KEPT, '{\"participant\": 3}')")
    page.reload()
    assert page.inner_text("#progress") == "Question 1 of 2", "what is kept and damaged is not read"


def test_places_are_shuffled_for_each_participant(page):
    orders = page.evaluate("""() => Array.from({length: 240}, () => {
      state = fresh();
      return study.questions.map(question => shuffled(question).map(candidate => candidate.code));
    })""")
    for question in (0, 1):
        for place in range(4):
            found = [order[question][place] for order in orders]
            assert all(30 < found.count(code) < 95 for code in set(found)) and len(set(found)) == 4
    assert sum(order[0][0] == order[1][0] for order in orders) < 240


def test_keys_step_and_do_not_go_on_without_an_answer(page):
    place_of(page, 220)
    before = page.evaluate(SHADE, 0)
    page.keyboard.press("ArrowDown")
    page.wait_for_function(f"() => ({SHADE})(0) !== {before}")
    assert page.input_value("#slider") == "1"
    page.keyboard.press("ArrowRight")
    page.keyboard.press("9")
    assert page.inner_text("#progress") == "Question 1 of 2"
    page.keyboard.press("ArrowUp")
    page.keyboard.press("ArrowUp")
    assert page.input_value("#slider") == "2", "views go round"
    page.focus("#slider")
    page.keyboard.press("ArrowLeft")
    assert page.input_value("#slider") == "1", "the slider keeps its own keys"


def test_views_run_in_step(page):
    place_of(page, 220)
    page.keyboard.press("Space")
    page.wait_for_function("() => element('slider').value === '2'")
    page.keyboard.press("Space")
    step = 10 * int(page.input_value("#slider"))
    assert abs(page.evaluate(SHADE, 0) - 20 - step) < 6
    assert {round(page.evaluate(SHADE, place) + step, -1) for place in range(1, 5)} == set(METHODS.values())


@pytest.mark.parametrize("width", [340, 800, 1400])
def test_nothing_runs_over_the_side(page, width):
    page.set_viewport_size({"width": width, "height": 700})
    place_of(page, 220)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    for number in range(1, 5):
        box = page.locator(f"#choices button:nth-child({number})").bounding_box()
        assert box["height"] >= 44 and box["x"] >= 0 and box["x"] + box["width"] <= width


def test_the_votes_are_those_of_the_page(page, study, tmp_path):
    page.keyboard.press("2")
    page.evaluate("() => go(2)")
    assert "1 of 2 questions is not answered" in page.inner_text("#answered")
    file = saved(page, tmp_path / "votes.json")
    votes = json.loads(file.read_text())
    assert unseal(votes["sealed"])["methods"] == list(METHODS)
    assert len(votes["answers"]) == 1 and votes["answers"][0]["choice"] == votes["answers"][0]["order"][1]
    assert tally([file]).places["2"].votes == 1


def test_pictures_that_were_not_sent_along_are_missed(make_run, tmp_path, browser):
    runs = [make_run("a", 200), make_run("b", 100)]
    study = write_study([runs], tmp_path / "study.html", inline_most=0)
    with browser.new_context() as context:
        page = context.new_page()
        page.goto(study.page.as_uri())
        page.wait_for_function("() => document.querySelector('#grid canvas').width === 40")
        assert page.is_hidden("#missing")
        shutil.rmtree(study.folder)
        page.reload()
        page.wait_for_selector("#missing", state="visible")
