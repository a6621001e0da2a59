"""The README's Python snippet runs as it is printed."""

import re
from dataclasses import replace
from pathlib import Path

import pytest
from tiny_removal import SETTINGS, Removed

import diga3d_warp as d3
from diga3d_warp.pipelines import remove as removal
from diga3d_warp.pipelines.method import WARPED

README = Path(__file__).parents[2] / "README.md"

TINY = replace(
    SETTINGS,
    fit=replace(SETTINGS.fit, iterations=40),
    refit=replace(SETTINGS.refit, iterations=5),
    method=WARPED,
)


def test_snippet(removed: Removed, tmp_path, monkeypatch):
    (snippet,) = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), flags=re.DOTALL)
    demo = tmp_path / "run" / "demo"
    demo.mkdir(parents=True)
    (demo / "scene").symlink_to(removed.scene.path)
    (demo / "removed").symlink_to(removed.folder)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(removal, "remove_settings", lambda *_: TINY)
    names: dict = {}
    exec(snippet, names)
    assert names["shown"].color.std() > 0.01 and names["warped"].image.std() > 0.01
    assert len(d3.Gaussians.load_ply("room.ply")) == len(names["result"].gaussians) > 0
    assert Path("run/room/report.html").is_file()


def test_options_of_reading_are_refused_beside_a_scene(removed: Removed, tmp_path):
    with pytest.raises(d3.InputError, match="give them to load_scene"):
        d3.remove(removed.scene, out=tmp_path / "run", image_scale=0.5)
    with pytest.raises(d3.InputError, match="remove with prior exemplar does not take prompt"):
        d3.remove(removed.scene, out=tmp_path / "run", prompt="gold")
    with pytest.raises(TypeError, match="sharpness"):
        d3.remove(removed.scene, out=tmp_path / "run", sharpness=2)
    assert not (tmp_path / "run").exists()
