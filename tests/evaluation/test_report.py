"""The report: one file that opens offline, shows the run's pictures and figures, and trusts no text."""

import base64
import json
import re
from html.parser import HTMLParser

import cv2
import numpy as np
import pytest

from diga3d_warp.effects.plan import Choice, EffectsPlan
from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.charts import curve, duration, memory, nice_ticks, timeline
from diga3d_warp.evaluation.protocols import evaluate
from diga3d_warp.evaluation.record import MANIFEST, add_metrics, read_manifest
from diga3d_warp.evaluation.report import MOST_VIEWS, write_report
from diga3d_warp.files import write_image
from diga3d_warp.pipelines.run import Run

VOID = {"meta", "img", "input"}


class Balance(HTMLParser):
    """Fails where a tag is closed that was not open."""

    def __init__(self, text):
        super().__init__()
        self.open = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        pass

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def assert_offline(text):
    assert Balance(text).open == []
    for reference in re.findall(r'(?:src|href|data-before)="?([^">]*)', text):
        assert reference.startswith("data:image/jpeg;base64,"), reference
    assert "http" not in text
    assert "url(" not in text
    assert "nan" not in re.sub(r"base64,[^\"]*", "", text).lower().split()


def pictures(text):
    """Embedded pictures by kind of attribute, decoded, RGB."""
    found = {}
    for attribute, data in re.findall(
        r'(class="\w+" src|data-before|<img src)="data:image/jpeg;base64,([^"]*)', text
    ):
        pixels = cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_COLOR)
        found.setdefault(attribute, []).append(pixels[..., ::-1])
    return found


def add_views(folder, count=3, size=(40, 60)):
    red, blue = np.zeros((*size, 3)), np.zeros((*size, 3))
    red[..., 0] = blue[..., 2] = 1
    mask = np.zeros(size, bool)
    mask[10:30, 20:40] = True
    for index in range(count):
        write_image(folder / "views" / "before" / f"shot {index:02d}.png", red)
        write_image(folder / "views" / "after" / f"shot {index:02d}.png", blue)
        write_image(folder / "masks" / f"shot {index:02d}.png", mask)


def test_report_of_a_run(toy_run):
    add_views(toy_run.folder)
    evaluate(toy_run.folder, scene=toy_run.scene)
    points = [{"iteration": i, "loss": 1 / (i + 1), "psnr": None if i == 0 else 10 + i} for i in range(20)]
    add_metrics(toy_run.folder, "fit", {"curve": points, "gaussians": 300})
    table = {"title": "Fills", "columns": ["fill", "PSNR"], "rows": [["ours", "23.10"], ["Telea", "18.20"]]}
    add_metrics(toy_run.folder, "tables", [table])
    text = write_report(toy_run.folder).read_text()
    assert_offline(text)
    shown = pictures(text)
    assert len(shown["data-before"]) == 3
    np.testing.assert_allclose(shown['class="before" src'][0].mean((0, 1)), [254, 0, 0], atol=3)
    np.testing.assert_allclose(shown['class="after" src'][0].mean((0, 1)), [0, 0, 254], atol=3)
    outlined = shown["<img src"][-1].astype(int)
    assert outlined[9, 30, 1] > 30 or outlined[10, 30, 1] > 30, "the mask's outline"
    assert outlined[20, 30, 1] < 20, "but not its inside"
    for expected in (
        "source against photographs",
        "Telea",
        "23.10",
        "fit: loss",
        "fit: psnr",
        "fit: gaussians",
    ):
        assert expected in text
    assert text.count("<polyline") == 2
    assert "16.7 %" in text


def test_many_views_are_thinned_and_counted(toy_run):
    add_views(toy_run.folder, MOST_VIEWS + 5)
    text = write_report(toy_run.folder).read_text()
    assert text.count("<button") == MOST_VIEWS
    assert "shot 00" in text
    assert f"shot {MOST_VIEWS + 4:02d}" in text
    assert "5 more views" in text


def test_large_pictures_are_embedded_small(toy_run):
    add_views(toy_run.folder, 1, (1200, 1800))
    assert pictures(write_report(toy_run.folder).read_text())['class="after" src'][0].shape == (600, 900, 3)


def test_bare_run_still_has_a_report(tmp_path):
    Run(tmp_path, "fit", {"scene": tmp_path / "garden"})
    text = write_report(tmp_path).read_text()
    assert_offline(text)
    assert "A splat of garden" in text
    assert "compare" not in text.split("</style>")[1].split("<script>")[0]


def test_text_is_escaped(tmp_path):
    run = Run(tmp_path, "fit", {"scene": tmp_path / "<b>garden"})
    run.note("<script>alert(1)</script> is missing")
    text = write_report(tmp_path).read_text()
    assert "<script>alert" not in text
    assert "<b>garden" not in text
    assert "&lt;script&gt;alert" in text


def test_names_of_views_are_escaped(toy_run):
    """Views are named after the user's files, and a file may be called anything."""
    name = "<b onclick='a'>\"&"
    for folder in ("views/before", "views/after", "masks"):
        write_image(toy_run.folder / folder / f"{name}.png", np.full((40, 60, 3), 0.5))
    text = write_report(toy_run.folder).read_text()
    assert_offline(text)
    assert "<b onclick" not in text and text.count("&lt;b onclick=") >= 2


def test_broken_picture_is_named(toy_run):
    add_views(toy_run.folder, 1)
    path = toy_run.folder / "views" / "after" / "shot 00.png"
    path.write_bytes(path.read_bytes()[:20])
    with pytest.raises(InputError, match=r"shot 00\.png is damaged"):
        write_report(toy_run.folder)
    assert not (toy_run.folder / "report.html").exists()


def test_stages_fill_the_timeline():
    stages = [
        {"name": "fit", "seconds": 30.0, "peak_mib": 800, "resumed": False},
        {"name": "remove", "seconds": 90.0, "peak_mib": 2048, "resumed": True},
    ]
    bars = re.findall(r"left:([\d.]+)%;width:([\d.]+)%", timeline(stages))
    assert bars == [("0.00", "25.00"), ("25.00", "75.00")]
    assert "remove (resumed)" in timeline(stages)
    assert "1 min 30 s" in timeline(stages)
    assert timeline([{"name": "fit", "seconds": 0.0, "peak_mib": 1, "resumed": False}])


def test_long_curve_keeps_its_ends():
    drawing = curve("loss", [(i, i) for i in range(10_000)])
    points = [tuple(map(float, p.split(","))) for p in re.search(r'points="([^"]*)"', drawing)[1].split()]
    assert 200 < len(points) <= 402
    assert points == sorted(points)
    assert points[0][1] > points[-1][1], "y grows upwards"
    assert "<b>9,999</b>" in drawing


@pytest.mark.parametrize("points", [[(0, 1.0), (10, 1.0)], [(5, 0.0), (5, 0.0)], [(0, 1e-9), (1, 2e-9)]])
def test_flat_curves_are_drawn(points):
    numbers = re.search(r'points="([^"]*)"', curve("loss", points))[1].replace(",", " ").split()
    assert all(-1 < float(number) < 500 for number in numbers)


@pytest.mark.parametrize(
    ("low", "high"), [(0, 1), (0.031, 0.42), (-3, 14), (1e-7, 3e-7), (5, 5), (0, 30_000)]
)
def test_ticks_are_few_round_and_enclose(low, high):
    ticks = nice_ticks(low, high)
    assert 2 <= len(ticks) <= 8
    assert ticks[0] <= low
    assert ticks[-1] >= high
    assert all(len(f"{tick:g}") <= 7 for tick in ticks)


def test_figures_as_a_person_says_them():
    assert [duration(s) for s in (4.24, 59.94, 187, 7500)] == ["4.2 s", "59.9 s", "3 min 07 s", "2 h 05 min"]
    assert [memory(m) for m in (812, 1434)] == ["812 MiB", "1.4 GiB"]


def test_old_manifest_without_scene(toy_run):
    manifest = json.loads((toy_run.folder / MANIFEST).read_text())
    manifest["settings"] = {}
    (toy_run.folder / MANIFEST).write_text(json.dumps(manifest))
    assert "run without the object" in write_report(toy_run.folder).read_text()


def test_the_plan_of_effects_is_shown_with_its_evidence(toy_run):
    assert "<h2>Effects</h2>" not in write_report(toy_run.folder).read_text()
    choice = Choice("lens", True, "the lens moves a corner by 7.27 px <b>", "user", 1.5, 0.1)
    run = Run(toy_run.folder, "remove", read_manifest(toy_run.folder)["settings"], resume=True)
    run.record("effects", EffectsPlan((choice,), ("Only 3 points.",)).as_json())
    text = write_report(toy_run.folder).read_text()
    assert_offline(text)
    assert "<h2>Effects</h2>" in text and "Only 3 points." in text
    assert "moves a corner by 7.27 px &lt;b&gt;" in text and "1.5 ms (10 %)" in text
