"""`diga3d experiment` and `sweep` from the command line, on real scenes, whole and broken."""

from __future__ import annotations

import csv
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from diga3d_warp import cli
from diga3d_warp.cli import experiments as commands
from diga3d_warp.experiments.job import JOBS
from diga3d_warp.experiments.run import Ended
from diga3d_warp.experiments.work import attempt
from diga3d_warp.gaussians.fit import FitSettings
from diga3d_warp.pipelines import remove as removal
from diga3d_warp.pipelines.method import WARPED
from diga3d_warp.pipelines.remove import REFIT, RemoveSettings
from diga3d_warp.scene.synthetic.generate import SyntheticScene
from diga3d_warp.scene.synthetic.spin_nerf import generate_spin_nerf

TINY = RemoveSettings(
    fit=FitSettings(iterations=20, budget=1500),
    refit=replace(REFIT, iterations=3),
    method=replace(WARPED, references=1, surfaces=False),
)


@pytest.fixture
def in_process(monkeypatch, threads) -> None:
    """Jobs run in this process, as removals of little work."""

    def crew(folders, work, tick):
        for folder in folders:
            attempt(str(folder.path), work, 1)
            tick()
            yield Ended(folder)

    monkeypatch.setattr(commands, "_crew", lambda *_: crew)
    monkeypatch.setattr(removal, "remove_settings", lambda *_: TINY)


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Path:
    settings = SyntheticScene(48, 36, views=5, shadows=False, supersampling=1, situation="rug")
    return generate_spin_nerf(settings, tmp_path_factory.mktemp("scene") / "whole")


def test_half_of_the_scenes_are_broken(in_process, scene, tmp_path, capsys):
    """The others are measured, and each broken one stands in the table with its line."""
    data, out = tmp_path / "data", tmp_path / "out"
    for name in ("1", "cut", "unmasked", "unlit"):
        shutil.copytree(scene, data / name)
    (data / "empty").mkdir()
    (data / "notes").mkdir()
    (data / "notes" / "readme.txt").write_text("nothing to see")
    (data / "book.zip").touch()
    cameras = data / "cut" / "sparse" / "0" / "images.bin"
    cameras.write_bytes(cameras.read_bytes()[:100])
    for folder in ("label", "test_label"):
        shutil.rmtree(data / "unmasked" / "images_4" / folder)
    for image in (data / "unlit" / "images_4").glob("*.png"):
        image.write_bytes(b"")
    words = ["experiment", "table1", "--data", str(data), "--out", str(out)]
    assert cli.main(words) == 1
    said = capsys.readouterr()
    assert "Traceback" not in said.err + said.out
    assert "5 of 6 jobs failed, the tables say why" in said.err
    assert "archives, which are not read: unpack book.zip" in said.err
    with (out / "table1.csv").open() as file:
        ours = {row["scene"]: row for row in csv.DictReader(file) if row["source"] == "measured"}
    assert ours["mean"]["outcome"] == "1 of 6" and ours["1"]["outcome"] == "done"
    assert 8 < float(ours["1"]["PSNR ↑"]) < 60 and ours["mean"]["PSNR ↑"] == ours["1"]["PSNR ↑"]
    assert 5 < float(ours["1"]["masked PSNR ↑"]) < 60 and 5 < float(ours["1"]["box PSNR ↑"]) < 60
    lines = {"empty": "empty", "notes": "notes", "cut": "images.bin", "unmasked": "no view has a mask"}
    for name, line in {**lines, "unlit": "image"}.items():
        assert line in ours[name]["outcome"] and "fault of this program" not in ours[name]["outcome"]
        assert ours[name]["PSNR ↑"] == "failed"
    page = (out / "pictures.html").read_text()
    captions = re.findall("<figcaption>(.*?)</figcaption>", page)
    assert captions == ["before", "diga3d-warp, exemplar", "ground truth"]
    (report,) = re.findall('href="(jobs/.*?)"', page)
    assert (out / report).is_file()

    # The same command tries the broken ones again, and leaves alone what is done.
    finished = next((out / JOBS).glob("1-*/outcome.json"))
    before = finished.stat().st_mtime_ns
    assert cli.main(words) == 1
    assert "6 jobs, 1 of them done earlier" in capsys.readouterr().err
    assert finished.stat().st_mtime_ns == before


def test_a_sweep_of_fits(in_process, scene, tmp_path, capsys):
    (tmp_path / "small.yaml").write_text(
        f"command: fit\nscenes: [{scene}]\noptions: {{iterations: 3}}\nseeds: [0, 1]"
    )
    assert cli.main(["sweep", str(tmp_path / "small.yaml"), "--out", str(tmp_path / "out")]) == 0
    assert "2 of 2" in capsys.readouterr().out
    assert (tmp_path / "out" / "small.tex").is_file() and len(list((tmp_path / "out" / JOBS).iterdir())) == 2


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("experiment table9 --data . --out out", "invalid choice: 'table9'"),
        ("experiment table1 --data none --out out", "none is not a folder"),
        ("experiment table1 --data data --out data/out", "lies in the data folder"),
        ("experiment table1 --data data --scenes 7 --out out", "has no scene '7'"),
        ("experiment table2 --data data --out out", "table2 needs"),
        ("experiment table3 --data data --prior classical --out out", "prior classical estimates no noise"),
        ("experiment table1 --data data --prior nothing --out out", "there is no prior or folder nothing"),
        ("experiment table1 --data data --out out --address 127.0.0.1", "is not HOST:PORT"),
        (
            "experiment table1 --data data --out out --address 127.0.0.1:1",
            "no cluster answers at 127.0.0.1:1",
        ),
        ("experiment table1 --data data --out out --address 127.0.0.1:1 --no-ray", "leave --no-ray out"),
        (
            "experiment table1 --data data --out out --address auto --workers 2",
            "--workers is of this machine",
        ),
        ("experiment table1 --data data --out out --no-ray --gpus 0.5", "without Ray each job sees one GPU"),
        ("experiment table2 --data data --out out --edits none.yaml", "table2 needs none.yaml"),
        ("experiment table1 --data data --out out --votes a.json", "only table2 reads --votes"),
        ("experiment table1 --data data --out out --edits a.yaml", "only table2 and table5 read --edits"),
        ("experiment table1 --data data --prior models/none --out out", "no prior or folder"),
        ("sweep none.yaml --out out", "none.yaml cannot be read"),
    ],
)
def test_bad_options_take_one_line_and_leave_nothing(tmp_path, monkeypatch, capsys, words, line):
    pytest.importorskip("ray")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "data" / "1").mkdir(parents=True)
    try:
        code = cli.main(words.split())
    except SystemExit as error:  # of the parser
        code = error.code
    said = capsys.readouterr().err
    lines = [each for each in said.splitlines() if "error" in each]
    assert code == 2 and len(lines) == 1 and line in lines[0], said
    assert "Traceback" not in said
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["1", "data"]
