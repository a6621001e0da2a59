"""diga3d bench effects: what is off is not in the kernels, and the page says so."""

import pytest

from diga3d_warp.bench import effects as bench
from diga3d_warp.bench.effects import ALL, LEAN, kernels_of, source_of, source_table
from diga3d_warp.bench.garden import Garden
from diga3d_warp.bench.still_life import still_life_camera
from diga3d_warp.config import Effects
from diga3d_warp.effects.prices import toggled
from diga3d_warp.scene.photographs.images import read_image

OWN = {
    "sh_degree": {"shade"},
    "lens": {"project"},
    "antialias": {"project"},
    "depth": {"blend", "blend, adjoint"},
    "median_depth": {"blend", "blend, adjoint"},
    "normals": {"blend", "blend, adjoint", "orient"},
    "exposure": set(),
    "background": set(),
    "pixel_order": {"project", "blend", "blend, adjoint"},
}
"""Kernels in which each effect is, and so those in which it is not."""


@pytest.fixture(scope="module")
def lean():
    return {name: source_of(kernel) for name, kernel in kernels_of(LEAN, "brown").items()}


@pytest.mark.parametrize("effect", ALL)
def test_an_effect_is_in_its_own_kernels_alone(effect, lean):
    found = {name: source_of(kernel) for name, kernel in kernels_of(toggled(LEAN, effect), "brown").items()}
    changed = {name for name in found if name not in lean or found[name].digest != lean[name].digest}
    assert changed == OWN[effect]
    if effect != "pixel_order":  # its blending is another kernel, without lanes and so shorter
        assert all(name not in lean or found[name].statements > lean[name].statements for name in changed)


def test_one_effect_is_in_its_own_kernels_also_among_others():
    full = Effects(sh_degree=3, antialias=True, normals=True, median_depth=True)
    every = kernels_of(full, "brown")
    for effect in ("sh_degree", "lens", "antialias", "depth", "median_depth"):
        without = kernels_of(toggled(full, effect), "brown")
        assert {name for name in every if without[name] is not every[name]} == OWN[effect]


def test_the_table_names_every_effect_and_kernel():
    table = source_table()
    assert [row[0] for row in table.rows[1:]] == [
        "harmonics of degree 3", "lens", "antialias", "depth", "median depth", "normals", "exposure",
        "background", "pixel order",
    ]  # fmt: skip
    assert [cell for row in table.rows if row[0] == "exposure" for cell in row[1:5]] == ["same"] * 4


def test_the_page_with_its_plots(tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    small = still_life_camera(64, 48)
    monkeypatch.setattr(bench, "still_life_camera", lambda: small)
    tables = bench.bench_effects(tmp_path, 1, Garden(count=300, width=64, height=48))
    assert len(tables[0].rows) == 1 + len(ALL)
    page = (tmp_path / "effects.md").read_text()
    assert "diga3d bench effects" in page and "effects-pictures.png" in page
    for name in ("effects.png", "effects-pictures.png"):
        assert read_image(tmp_path / name).std() > 20, "not blank"
