"""The command line: quick to answer, one line for bad input, nothing half-written."""

import subprocess
import sys
import time

import pytest

from diga3d_warp import cli
from diga3d_warp.cli import edits
from diga3d_warp.config import ACCURACIES
from diga3d_warp.errors import InputError

COMMANDS = [
    *("fit", "remove", "retexture", "replace", "render", "eval", "export", "study"),
    *("doctor", "synthetic", "demo", "bench"),
]
HEAVY = ["torch", "warp", "cv2", "numpy", "scipy", "pycolmap", "kornia", "trimesh"]


def diga3d(*words: str) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, "-m", "diga3d_warp.cli", *words], capture_output=True, text=True, timeout=120
    )


def test_help_names_every_command_within_a_second():
    seconds = []
    for _ in range(3):
        start = time.perf_counter()
        result = diga3d("--help")
        seconds.append(time.perf_counter() - start)
    assert result.returncode == 0
    assert "examples:" in result.stdout
    assert all(f"\n    {command} " in result.stdout for command in COMMANDS)
    assert min(seconds) < 1.0


@pytest.mark.parametrize("command", COMMANDS)
def test_each_command_has_help_with_an_example(command, capsys):
    with pytest.raises(SystemExit) as end:
        cli.main([command, "--help"])
    assert end.value.code == 0
    assert f"example:\n  diga3d {command}" in capsys.readouterr().out


def test_help_loads_nothing_heavy():
    code = (
        "import sys, diga3d_warp\n"
        "from diga3d_warp import cli\n"
        "try: cli.main(['remove', '--help'])\n"
        "except SystemExit: pass\n"
        f"print('loaded:', [name for name in {HEAVY!r} if name in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert result.stdout.splitlines()[-1] == "loaded: []"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "COMMAND"),
        (["remove", "scene"], "--out"),
        (
            ["remove", "scene", "--out", "run", "--image-scale", "2"],
            "'2' is not a number above 0",
        ),
        (["remove", "scene", "--out", "run", "--image-scale", "nan"], "'nan' is not a number"),
        (["remove", "scene", "--out", "run", "--references", "0"], "'0' is not a whole number above 0"),
        (["fit", "scene", "--out", "run", "--iterations", "many"], "'many' is not a whole number above 0"),
        (["fit", "scene", "--out", "run", "--hold-out", "-1"], "--hold-out"),
        (["remove", "scene", "--out", "run", "--propagation", "magic"], "'magic'"),
        (["render", "run", "--size", "640"], "640x480"),
        (["render", "run", "--size", "99999x9"], "larger than 16383x16383"),
        (["render", "run", "--frames", "1" * 5000], "is above 1000000000"),
        (["fit", "", "--out", "run"], "'' is not a path"),
        (["fit", "scene", "--out", " "], "' ' is not a path"),
        (["remove", "scene", "--out", "run", "--masks", ""], "'' is not a path"),
        (["retexture", "scene", "--out", "run", "--exemplar", ""], "'' is not a path"),
        (["replace", "scene", "--out", "run", "--asset", ""], "'' is not a path"),
        (["eval", ""], "'' is not a path"),
        (["render", "run", "--out", ""], "'' is not a path"),
        (["synthetic", ""], "'' is not a path"),
        (["demo", "--out", ""], "'' is not a path"),
        (["fit", "scene", "--out", "run", "--accuracy", "best"], "'draft', 'standard', 'exact'"),
    ],
)
def test_bad_arguments_are_one_line(words, said, capsys):
    with pytest.raises(SystemExit) as end:
        cli.main(words)
    written = capsys.readouterr()
    assert end.value.code == 2
    assert written.out == ""
    assert written.err.startswith("diga3d: error: ")
    assert written.err.count("\n") == 1
    assert said in written.err


@pytest.mark.parametrize("command", ["render", "eval"])
def test_folder_without_a_run_is_one_line(command, tmp_path, capsys):
    for folder in (tmp_path, tmp_path / "absent"):
        assert cli.main([command, str(folder)]) == 2
        written = capsys.readouterr()
        assert written.err.startswith(f"diga3d: error: {folder} ")
        assert "give the --out folder of a finished run" in written.err
        assert written.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def stand_in(monkeypatch, effect):
    """Let `diga3d fit` run `effect` instead of a fit; returns the keyword arguments it was given."""
    given = {}

    def fit(**options):
        given.update(options)
        return effect()

    monkeypatch.setattr(edits, "_fit", fit)
    return given


def test_defaults_are_handed_over(monkeypatch):
    given = stand_in(monkeypatch, lambda: 0)
    assert cli.main(["fit", "scene", "--out", "run"]) == 0
    assert {name: str(given.pop(name)) for name in ("scene", "out")} == {"scene": "scene", "out": "run"}
    assert given == {
        "masks": None,
        "mask_ids": (),
        "image_scale": 1.0,
        "iterations": None,
        "accuracy": "standard",
        "hold_out": 8,
        "seed": 0,
        "resume": False,
        "effects": {},
        "representation": "gaussians",
    }


def test_every_accuracy_that_can_be_named_is_there():
    for name in ACCURACIES:
        assert cli.parser().parse_args(["render", "run", "--accuracy", name]).accuracy == name


def test_error_over_several_lines_becomes_one(monkeypatch, capsys):
    def fail():
        raise InputError("image.png is truncated:\n  copy it again")

    stand_in(monkeypatch, fail)
    assert cli.main(["fit", "scene", "--out", "run"]) == 2
    assert capsys.readouterr().err == "diga3d: error: image.png is truncated: copy it again\n"


def test_interrupt_says_how_to_go_on(monkeypatch, capsys):
    def interrupt():
        raise KeyboardInterrupt

    stand_in(monkeypatch, interrupt)
    assert cli.main(["fit", "my scene", "--out", "run"]) == 130
    assert "diga3d fit 'my scene' --out run --resume\n" in capsys.readouterr().err


@pytest.mark.parametrize(
    "option", [["--hold-out", "1"], ["--seed", "-1"], ["--seed", "4294967296"], ["--seed", "9" * 5000]]
)
def test_numbers_that_no_run_could_use_are_refused(option, tmp_path, capsys):
    with pytest.raises(SystemExit) as stop:
        cli.main(["remove", str(tmp_path), "--out", str(tmp_path / "run"), *option])
    assert stop.value.code == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert not (tmp_path / "run").exists()


def test_the_pipelines_accuracy_takes_no_scene(capsys):
    assert cli.main(["bench", "accuracy", "--pipeline", "--scene", "captures/garden"]) == 2
    assert "leave --scene out" in capsys.readouterr().err
