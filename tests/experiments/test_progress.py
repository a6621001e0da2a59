"""The view of all jobs: one bar on a terminal, lines elsewhere."""

from __future__ import annotations

import io
import json
import sys

import pytest
from quick_work import quick_job

from diga3d_warp.experiments.job import JobFolder
from diga3d_warp.experiments.progress import SHOWN, View


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def folders(tmp_path) -> list[JobFolder]:
    """Six jobs, five of which are in the stage of a fit."""
    made = [JobFolder(tmp_path, quick_job(f"scene{number}")) for number in range(6)]
    for number, folder in enumerate(made[:5]):
        (folder.run / "stages" / ".fit.partial").mkdir(parents=True)
        (folder.path / "worker.json").write_text(json.dumps({"process": 100 + number, "host": "here"}))
    return made


def test_one_bar_on_a_terminal(folders, monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    with View(folders, 8) as view:
        view.show()
        view.ended(folders[0], "no view has a mask")
        view.show()
    bar = terminal.getvalue().split("\r")[-1]
    assert "3/8" in bar and "1 failed; " in bar and "scene1-remove" in bar and "fit" in bar
    assert "scene0-remove" not in bar, "it has ended"
    assert f"{folders[0].path.name}: no view has a mask (3 of 8)\n" in terminal.getvalue()
    assert f"and {5 - SHOWN} more" in terminal.getvalue()
    assert "started" not in terminal.getvalue()


def test_lines_elsewhere(folders, capsys):
    with View(folders, 6) as view:
        view.show()
        view.show()
        (folders[1].path / "worker.json").write_text(json.dumps({"process": 999, "host": "there"}))
        (folders[2].path / "worker.json").write_text("{")
        view.show()
        view.ended(folders[1], None)
    said = capsys.readouterr().err.splitlines()
    names = [folder.path.name for folder in folders]
    assert said == [
        "diga3d: 6 jobs",
        *(f"diga3d: {names[k]}: started, process {100 + k} on here" for k in range(5)),
        f"diga3d: {names[1]}: started again, process 999 on there",
        f"diga3d: {names[1]}: done (1 of 6)",
    ]
