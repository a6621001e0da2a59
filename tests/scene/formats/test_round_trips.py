"""Each format that is written: read back within its quantisation, and by others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from diga3d_warp.errors import InputError
from diga3d_warp.scene.formats.read import read_splat
from diga3d_warp.scene.formats.rows import SplatRows
from diga3d_warp.scene.formats.write import ENDINGS, write_splat
from diga3d_warp.scene.morton import morton_order
from scenes import random_gaussians

gsply = pytest.importorskip("gsply")
pytest.importorskip("gaussforge")

COUNT = 700
"""More than two chunks of 256, the last one not full."""


def rows_of(degree: int = 3, scale: float = 1.0) -> SplatRows:
    """Gaussians within what every format holds: harmonics small, opacities and colours not at their ends."""
    gaussians = random_gaussians(COUNT, seed=5, degree=degree)
    gaussians.sh[:, 1:] = gaussians.sh[:, 1:].clamp(-0.9, 0.9)
    gaussians.sh[:, 0] = gaussians.sh[:, 0].clamp(-1.5, 1.5)
    gaussians.opacity_logits = gaussians.opacity_logits.clamp(-4, 4)
    gaussians.log_scales = gaussians.log_scales.clamp(-6, 2) + float(np.log(scale))
    gaussians.means = gaussians.means * scale
    gaussians.quaternions = torch.nn.functional.normalize(gaussians.quaternions)
    return gaussians.rows()


def paired(written: SplatRows, rows: SplatRows) -> SplatRows:
    """The written rows in the order of `rows`."""
    _, nearest = cKDTree(written.means).query(rows.means)
    assert len(np.unique(nearest)) == len(rows) == len(written)
    return written.select(nearest)


def check(rows: SplatRows, read: SplatRows, form: str) -> None:
    """Compare within the steps of a format."""
    box = np.ptp(rows.means, axis=0).max()
    place = {"ply": 0.0, "compressed-ply": box / 2**11, "spz": 2.0**-20, "splat": 0.0, "sog": box / 2**14}
    thickness = {"ply": 0.0, "compressed-ply": 8 / 2**11, "spz": 1 / 32, "splat": 1e-6, "sog": 0.05}
    harmonics = {"ply": 0.0, "compressed-ply": 1 / 64, "spz": 1 / 14, "sog": 0.05}
    read = paired(read, rows)
    assert np.abs(read.means - rows.means).max() <= place[form] * 1.01 + 1e-6 * (form != "ply")
    assert np.abs(read.log_scales - rows.log_scales).max() <= thickness[form] * 1.01
    opacity = [1 / (1 + np.exp(-logits)) for logits in (read.opacity_logits, rows.opacity_logits)]
    assert np.abs(opacity[0] - opacity[1]).max() <= (0 if form == "ply" else 1.01 / 255)  # some round down
    assert np.abs(read.sh[:, 0] - rows.sh[:, 0]).max() <= (0 if form == "ply" else 0.6 / 255 / 0.15)
    norms = np.linalg.norm(read.quaternions, axis=1)
    cosines = (read.quaternions * rows.quaternions).sum(axis=1) / norms
    assert (2 * np.arccos(np.abs(cosines).clip(0, 1))).max() <= 0.03  # 2 degrees: a byte for each component
    if form == "splat":
        assert read.sh.shape[1] == 1
    else:
        assert read.sh[:, : rows.sh.shape[1]].shape == rows.sh.shape
        assert np.abs(read.sh[:, 1 : rows.sh.shape[1]] - rows.sh[:, 1:]).max(initial=0) <= harmonics[form]


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("form", ENDINGS)
def test_round_trip(tmp_path, form, degree):
    rows = rows_of(degree)
    path = tmp_path / f"splat{ENDINGS[form]}"
    notes = write_splat(path, rows, form)
    lost = ["splat.splat: the format holds no harmonics: colours no longer change with direction"]
    assert notes == (lost if form == "splat" and degree > 0 else [])
    content = read_splat(path)
    assert content.notes == [] and not content.antialiased
    check(rows, content.rows, form)
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name], "no temporary file stays"


@pytest.mark.parametrize("form", ENDINGS)
def test_antialiasing_is_kept_where_the_format_can_say_it(tmp_path, form):
    path = tmp_path / f"splat{ENDINGS[form]}"
    notes = write_splat(path, rows_of(0), form, antialiased=True)
    assert read_splat(path).antialiased is (form != "splat")
    assert notes == (
        ["splat.splat: the format cannot say that the splat is anti-aliased"] if form == "splat" else []
    )


def test_gsply_reads_the_same_values(tmp_path):
    """Two readers that share no code. For .spz and .sog, writer and reader share none."""
    path = tmp_path / "splat.compressed.ply"
    write_splat(path, rows_of(), "compressed-ply")
    ours, theirs = read_splat(path).rows, gsply.plyread(path)
    for mine, name in (
        (ours.means, "means"), (ours.log_scales, "scales"), (ours.quaternions, "quats"),
        (ours.opacity_logits, "opacities"), (ours.sh[:, 0], "sh0"), (ours.sh[:, 1:], "shN"),
    ):  # fmt: skip
        np.testing.assert_allclose(mine, getattr(theirs, name), atol=1e-5, err_msg=name)


@pytest.mark.parametrize("scale", [1e-3, 1e4])
def test_spz_takes_the_fraction_that_a_scene_needs(tmp_path, scale):
    """Niantic's own 12 bits would round a small scene to nothing, and a large one would overflow."""
    rows = rows_of(0, scale)
    rows = replace(rows, log_scales=rows.log_scales.clip(-9.9, 5.9))
    write_splat(tmp_path / "splat.spz", rows, "spz")
    read = read_splat(tmp_path / "splat.spz").rows
    distances, _ = cKDTree(read.means).query(rows.means)
    assert distances.max() < max(np.abs(rows.means).max() / 2**21, 2.0**-24)


def test_a_scene_too_small_for_a_format_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"the format spz holds scales from 4\.5e-05 to") as caught:
        write_splat(tmp_path / "splat.spz", rows_of(0, 1e-5), "spz")
    assert "\n" not in str(caught.value) and not list(tmp_path.iterdir())


def test_far_coordinates_are_refused_where_they_would_be_lost(tmp_path):
    rows = rows_of(0, 1e-2)
    far = replace(rows, means=rows.means + np.array([5e5, 4.6e6, 0.0]))
    write_splat(tmp_path / "splat.ply", far, "ply")
    np.testing.assert_array_equal(read_splat(tmp_path / "splat.ply").rows.means, far.means)
    with pytest.raises(InputError, match="too coarse for this scene"):
        write_splat(tmp_path / "splat.compressed.ply", far, "compressed-ply")
    assert [entry.name for entry in tmp_path.iterdir()] == ["splat.ply"]


def test_clipped_harmonics_are_counted(tmp_path):
    rows = rows_of(1)
    rows.sh[:9, 2] = 1.3
    notes = write_splat(tmp_path / "splat.spz", rows, "spz")
    assert notes == ["splat.spz: harmonics of 9 gaussians are clipped"]


def test_morton_order_keeps_neighbours_together():
    generator = np.random.default_rng(0)
    points = generator.random((4000, 3))
    order = morton_order(points)
    np.testing.assert_array_equal(np.sort(order), np.arange(4000))
    chunks = points[order][:3840].reshape(15, 256, 3)
    volumes = np.prod(np.ptp(chunks, axis=1), axis=1)
    assert np.median(volumes) < 0.2, "a chunk of 256 of 4000 points spans a small part of the unit box"
    assert morton_order(np.zeros((5, 3))).tolist() == [0, 1, 2, 3, 4]


def test_formats_need_their_packages(tmp_path, monkeypatch):
    monkeypatch.setattr("diga3d_warp.scene.formats.conversion.find_spec", lambda name: None)
    for form in ("compressed-ply", "spz", "sog", "splat"):
        with pytest.raises(InputError, match=r"need the package \w+: pip install 'diga3d-warp\[formats\]'"):
            write_splat(Path(tmp_path / f"splat{ENDINGS[form]}"), rows_of(0), form)
    assert not list(tmp_path.iterdir())
