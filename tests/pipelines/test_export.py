"""diga3d export: the result of a run, or a splat file, in other formats."""

from __future__ import annotations

import json
from importlib.util import find_spec

import numpy as np
import pytest

from diga3d_warp import cli
from diga3d_warp.pipelines.export import export_splat
from diga3d_warp.scene.formats.read import read_splat
from diga3d_warp.scene.formats.write import ENDINGS
from scenes import random_gaussians

needs_libraries = pytest.mark.skipif(
    find_spec("gaussforge") is None or find_spec("gsply") is None,
    reason="the extra [formats] is not installed",
)


@needs_libraries
@pytest.mark.parametrize("form", [form for form in ENDINGS if form != "ply"])
def test_a_run_is_exported_beside_its_result(toy_run, tmp_path, capsys, form):
    run = toy_run.folder
    assert cli.main(["export", str(run), "--format", form]) == 0
    target = run / f"point_cloud{ENDINGS[form]}"
    assert capsys.readouterr().out == f"{target}\n"
    assert len(read_splat(target).rows) == len(read_splat(run / "point_cloud.ply").rows)


@needs_libraries
def test_any_format_becomes_any_other(tmp_path, capsys):
    random_gaussians(60, degree=1).save_ply(tmp_path / "a.ply", antialiased=True)
    chain = [("spz", "b.spz"), ("compressed-ply", "c.ply"), ("sog", "d.sog"), ("ply", "e.ply")]
    source = tmp_path / "a.ply"
    for form, name in chain:
        assert cli.main(["export", str(source), "--format", form, "--out", str(tmp_path / name)]) == 0
        source = tmp_path / name
    content = read_splat(source)
    assert content.antialiased and len(content.rows) == 60
    first = read_splat(tmp_path / "a.ply").rows
    for axis in range(3):
        assert np.abs(np.sort(content.rows.means[:, axis]) - np.sort(first.means[:, axis])).max() < 0.02


def test_notes_are_printed(tmp_path, capsys):
    gaussians = random_gaussians(20)
    gaussians.means[3] = float("nan")
    gaussians.save_ply(tmp_path / "a.ply")
    words = ["--format", "ply", "--out", str(tmp_path / "b.ply")]
    assert cli.main(["export", str(tmp_path / "a.ply"), *words]) == 0
    written = capsys.readouterr()
    assert written.err == "diga3d: note: a.ply: left out 1 gaussians with NaN or infinite values\n"
    assert len(read_splat(tmp_path / "b.ply").rows) == 19


def test_a_run_fitted_with_antialiasing_says_so(toy_run, tmp_path):
    """Also one whose .ply was written before such files said it."""
    run = toy_run.folder
    manifest = json.loads((run / "manifest.json").read_text(encoding="utf-8"))
    choice = {"effect": "antialias", "value": True, "evidence": "", "by": "user"}
    manifest.setdefault("effects", {})["choices"] = [choice]
    (run / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    exported = export_splat(run, "ply", tmp_path / "a.ply")
    assert read_splat(exported.path).antialiased


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["absent", "--format", "ply"], "absent: no such file or folder"),
        (["named.splat", "--format", "ply"], "named.splat: begins as a .ply file does; give it that ending"),
        (["empty", "--format", "ply"], "holds no run (manifest.json is missing)"),
        (["a.ply", "--format", "ply"], "is in that format already; give another name with --out"),
        (["a.ply", "--format", "spz", "--out", "a.ply"], "a file of the format spz ends in .spz"),
        (["a.ply", "--format", "compressed-ply", "--out", "a.ply"], "would be replaced; give another name"),
        (["a.ply", "--format", "ply", "--out", "folder.ply"], "is a folder"),
        (["mesh.ply", "--format", "ply", "--out", "b.ply"], "holds no gaussians"),
        (["text.ply", "--format", "ply", "--out", "b.ply"], "not a .ply file"),
    ],
)
def test_what_cannot_be_exported_is_one_line(tmp_path, monkeypatch, capsys, words, said):
    monkeypatch.chdir(tmp_path)
    random_gaussians(20).save_ply("a.ply")
    (tmp_path / "named.splat").write_bytes((tmp_path / "a.ply").read_bytes())
    (tmp_path / "empty").mkdir()
    (tmp_path / "folder.ply").mkdir()
    (tmp_path / "text.ply").write_text("hello")
    (tmp_path / "mesh.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n0\n"
    )
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert cli.main(["export", *words]) == 2
    written = capsys.readouterr()
    assert written.err.startswith("diga3d: error: ") and said in written.err and written.err.count("\n") == 1
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
