"""The .ply of a splat: exact, readable by others, and refused in one line where it is not usable."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import gsply
import numpy as np
import pytest
import torch
from plyfile import PlyData, PlyElement

from diga3d_warp.errors import InputError
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.scene.formats.read import read_splat
from diga3d_warp.scene.formats.standard_ply import write_ply
from scenes import random_gaussians

STANDARD = [
    *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"),
    *(f"f_rest_{k}" for k in range(45)),
    *("opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
]
"""The properties that the original viewer expects, in its order."""


def same(a: Gaussians, b: Gaussians) -> None:
    for (name, mine), (_, theirs) in zip(a.named(), b.named(), strict=True):
        assert mine.dtype == theirs.dtype == torch.float32
        torch.testing.assert_close(mine, theirs, rtol=0, atol=0, msg=name)


def vertices(path: Path) -> np.ndarray:
    return np.array(PlyData.read(path)["vertex"].data)


def rewrite(path: Path, rows: np.ndarray, name: str = "vertex", **form) -> None:
    PlyData([PlyElement.describe(rows, name)], **form).write(path)


@pytest.fixture
def splat() -> Gaussians:
    return random_gaussians(50, seed=3)


@pytest.fixture
def file(tmp_path, splat) -> Path:
    splat.save_ply(tmp_path / "splat.ply")
    return tmp_path / "splat.ply"


def test_round_trip_is_exact(file, splat):
    content = read_splat(file)
    same(Gaussians.from_rows(content.rows), splat)
    assert content.notes == [] and not content.antialiased
    assert [entry.name for entry in file.parent.iterdir()] == ["splat.ply"], "no temporary file stays"


def test_the_header_is_that_of_3dgs(file):
    header = file.read_bytes().split(b"end_header\n")[0].decode("ascii").splitlines()
    assert header[:3] == ["ply", "format binary_little_endian 1.0", "element vertex 50"]
    assert header[3:] == [f"property float {name}" for name in STANDARD]
    assert file.stat().st_size == len("\n".join(header)) + len("\nend_header\n") + 50 * 4 * len(STANDARD)


def test_plyfile_reads_the_same_values(file, splat):
    rows = vertices(file)
    assert list(rows.dtype.names) == STANDARD
    columns = {
        "means": rows[["x", "y", "z"]],
        "log_scales": rows[["scale_0", "scale_1", "scale_2"]],
        "quaternions": rows[["rot_0", "rot_1", "rot_2", "rot_3"]],
    }
    for name, values in columns.items():
        np.testing.assert_array_equal(np.array(values.tolist(), np.float32), getattr(splat, name))
    np.testing.assert_array_equal(rows["opacity"], splat.opacity_logits)
    for channel in range(3):
        np.testing.assert_array_equal(rows[f"f_dc_{channel}"], splat.sh[:, 0, channel])
        for k in range(15):
            np.testing.assert_array_equal(rows[f"f_rest_{15 * channel + k}"], splat.sh[:, 1 + k, channel])
    assert not any(rows[name].any() for name in ("nx", "ny", "nz"))


def test_gsply_reads_the_same_values(file, splat):
    data = gsply.plyread(file)
    np.testing.assert_array_equal(data.means, splat.means)
    np.testing.assert_array_equal(data.scales, splat.log_scales)
    np.testing.assert_array_equal(data.quats, splat.quaternions)
    np.testing.assert_array_equal(data.opacities, splat.opacity_logits)
    np.testing.assert_array_equal(data.sh0, splat.sh[:, 0])
    np.testing.assert_array_equal(data.shN, splat.sh[:, 1:])


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_lower_degrees_are_filled_up_with_zeros(tmp_path, degree):
    splat = random_gaussians(20, degree=degree)
    splat.save_ply(tmp_path / "splat.ply")
    rows = vertices(tmp_path / "splat.ply")
    assert list(rows.dtype.names) == STANDARD
    read = Gaussians.load_ply(tmp_path / "splat.ply")
    coefficients = (degree + 1) ** 2
    torch.testing.assert_close(read.sh[:, :coefficients], splat.sh, rtol=0, atol=0)
    assert read.sh.shape == (20, 16, 3)
    assert not read.sh[:, coefficients:].any()


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_files_of_lower_degree_are_read(file, splat, degree):
    rows, per_channel = vertices(file), (degree + 1) ** 2 - 1
    kept = [15 * channel + k for channel in range(3) for k in range(per_channel)]
    others = [name for name in rows.dtype.names if not name.startswith("f_rest_")]
    layout = [(name, "f4") for name in [*others, *(f"f_rest_{k}" for k in range(3 * per_channel))]]
    short = np.zeros(len(rows), layout)
    for name in others:
        short[name] = rows[name]
    for place, k in enumerate(kept):
        short[f"f_rest_{place}"] = rows[f"f_rest_{k}"]
    rewrite(file, short)
    read = Gaussians.load_ply(file)
    torch.testing.assert_close(read.sh, splat.sh[:, : per_channel + 1], rtol=0, atol=0)
    torch.testing.assert_close(read.quaternions, splat.quaternions, rtol=0, atol=0)


@pytest.mark.parametrize(
    "form", [{"text": True}, {"byte_order": ">"}, {"byte_order": "<"}], ids=["ascii", "big", "little"]
)
def test_other_orders_of_properties_and_bytes_are_read(file, splat, form):
    rows = vertices(file)
    names = [name for name in reversed(rows.dtype.names) if not name.startswith("n")]
    shuffled = np.empty(len(rows), [(name, "f8" if name == "opacity" else "f4") for name in names])
    for name in names:
        shuffled[name] = rows[name]
    rewrite(file, shuffled, **form)
    same(Gaussians.load_ply(file), splat)


def header_of(path: Path) -> list[str]:
    return path.read_bytes().split(b"end_header")[0].decode("ascii").splitlines()


def with_header(path: Path, change) -> None:
    """Rewrite the lines of a header, the data left as they are."""
    header, data = path.read_bytes().split(b"end_header\n", 1)
    path.write_bytes(change(header) + b"end_header\n" + data)


def test_far_positions_are_kept_as_doubles(tmp_path, splat):
    far = replace(splat.rows(), means=splat.rows().means + np.array([5e5, 4.6e6, 100.0]))
    write_ply(tmp_path / "far.ply", far, positions="double")
    assert header_of(tmp_path / "far.ply")[3:7] == [
        *(f"property double {axis}" for axis in "xyz"),
        "property float nx",
    ]
    read = read_splat(tmp_path / "far.ply").rows
    for name in ("means", "log_scales", "quaternions", "opacity_logits", "sh"):
        np.testing.assert_array_equal(getattr(read, name), getattr(far, name))


@pytest.mark.parametrize("value", [True, False])
def test_antialiasing_is_written_as_brush_does(tmp_path, splat, value):
    splat.save_ply(tmp_path / "splat.ply", antialiased=value)
    assert ("comment SplatRenderMode: mip" in header_of(tmp_path / "splat.ply")) is value
    assert read_splat(tmp_path / "splat.ply").antialiased is value


@pytest.mark.parametrize(
    ("comments", "expected"),
    [
        (["SplatRenderMode: mip"], True),
        (["  SPLATRENDERMODE:  Mip "], True),
        (["SplatRenderMode:mip"], True),
        (["SplatRenderMode: default"], False),
        (["antialiased 1"], True),
        (["antialiased 0"], False),
        (["antialiased 1", "SplatRenderMode: default"], False),
        (["SplatRenderMode: default", "antialiased 1"], True),
        (["Exported from Brush", "SH degree: 3", ""], False),
    ],
)
def test_antialiasing_is_read_from_comments(file, comments, expected):
    lines = "".join(f"comment {comment}\n" for comment in comments).encode()
    with_header(file, lambda header: header.replace(b"element", lines + b"element", 1))
    assert read_splat(file).antialiased is expected


@pytest.mark.parametrize(
    ("comment", "rows"),
    [("SurroundRows: 12", 12), ("SurroundRows: 50", 0), ("SurroundRows: -3", 0), ("SurroundRows: many", 0)],
)
def test_a_surround_is_read_from_a_comment(file, comment, rows):
    """One that covers all rows or is no number is none."""
    rewrite(file, vertices(file), comments=[comment])
    content = read_splat(file)
    assert content.surround == rows and len(content.scene) == 50 - rows and len(content.shell) == rows


def test_a_surround_is_written_as_a_comment(tmp_path, splat):
    splat.save_ply(tmp_path / "splat.ply", surround=20)
    content = read_splat(tmp_path / "splat.ply")
    np.testing.assert_array_equal(content.shell.means, content.rows.means[30:])
    np.testing.assert_array_equal(content.scene.means, content.rows.means[:30])


def test_unusable_rows_are_left_out_with_a_note(file, splat):
    rows = vertices(file).copy()
    rows["x"][3] = np.nan
    rows["f_rest_44"][7] = np.inf
    rows["scale_1"][9] = np.inf
    rows["opacity"][8] = -np.inf
    for k in range(4):
        rows[f"rot_{k}"][[11, 12]] = 0.0
    rewrite(file, rows)
    content = read_splat(file)
    assert content.notes == [
        "splat.ply: left out 3 gaussians with NaN or infinite values",
        "splat.ply: left out 1 gaussians that are fully transparent",
        "splat.ply: left out 2 gaussians whose quaternion is zero",
    ]
    keep = torch.ones(50, dtype=torch.bool)
    keep[[3, 7, 8, 9, 11, 12]] = False
    same(Gaussians.from_rows(content.rows), splat.select(keep))
    with pytest.warns(UserWarning, match="left out 2 gaussians whose quaternion is zero"):
        same(Gaussians.load_ply(file), splat.select(keep))


def test_every_row_comes_back_where_arrays_go_by_row(tmp_path, splat):
    splat.means[3, 0] = np.nan
    splat.opacity_logits[8] = -np.inf
    splat.quaternions[11] = 0.0
    splat.save_ply(tmp_path / "stage.ply")
    read = Gaussians.load_ply(tmp_path / "stage.ply", every_row=True)
    for (_, mine), (_, theirs) in zip(read.named(), splat.named(), strict=True):
        torch.testing.assert_close(mine, theirs, rtol=0, atol=0, equal_nan=True)


def test_opaque_and_flat_gaussians_are_kept(file, splat):
    """SuperSplat and others write an opaque gaussian as +infinity, a flat one as a scale of -infinity."""
    rows = vertices(file).copy()
    rows["opacity"][:10] = np.inf
    rows["scale_2"][5:12] = -np.inf
    rows["scale_1"][12] = -60.0  # e^-60, beyond what the kernels take
    for k in range(3):
        rows[f"scale_{k}"][13] = -np.inf
    rewrite(file, rows)
    content = read_splat(file)
    assert content.notes == [
        "splat.ply: 10 gaussians of infinite opacity logit are opaque",
        "splat.ply: 9 gaussians of zero scale are flat",
    ]
    read = Gaussians.from_rows(content.rows)
    assert len(read) == 50
    assert (read.opacities[:10] == 1.0).all()
    ratio = read.scales.amin(dim=1) / read.scales.amax(dim=1)
    torch.testing.assert_close(ratio[5:13], torch.full((8,), 1e-4), rtol=1e-4, atol=0)
    assert read.scales[13].max() < 1e-3 * read.scales[14:].max()
    untouched = [*range(14, 50)]
    same(read.select(torch.tensor(untouched)), splat.select(torch.tensor(untouched)))


def test_round_gaussians_need_no_rotation(file, splat):
    rows = vertices(file).copy()
    for k in range(3):
        rows[f"scale_{k}"][:4] = -3.0
    for k in range(4):
        rows[f"rot_{k}"][:5] = 0.0
    rewrite(file, rows)
    content = read_splat(file)
    assert content.notes == ["splat.ply: left out 1 gaussians whose quaternion is zero"]
    assert (content.rows.quaternions[:4] == (1, 0, 0, 0)).all() and len(content.rows) == 49


def test_degree_4_is_read_without_its_last_coefficients(file, splat):
    rows = vertices(file)
    others = [name for name in rows.dtype.names if not name.startswith("f_rest_")]
    wide = np.full(len(rows), 9.0, [(name, "f4") for name in [*others, *(f"f_rest_{k}" for k in range(72))]])
    for name in others:
        wide[name] = rows[name]
    for channel in range(3):
        for k in range(15):
            wide[f"f_rest_{24 * channel + k}"] = rows[f"f_rest_{15 * channel + k}"]
    rewrite(file, wide)
    content = read_splat(file)
    assert content.notes == ["splat.ply: harmonics of degree 4 are left out, degree 3 is kept"]
    same(Gaussians.from_rows(content.rows), splat)


def test_surfels_of_2dgs_are_flat_gaussians(file, splat):
    without("scale_2")(file)
    content = read_splat(file)
    assert content.notes == [
        "splat.ply: a splat of 2DGS, drawn as flat gaussians",
        "splat.ply: 50 gaussians of zero scale are flat",
    ]
    np.testing.assert_array_equal(content.rows.log_scales[:, :2], splat.log_scales[:, :2])
    assert (content.rows.log_scales[:, 2] < content.rows.log_scales[:, :2].max(axis=1) - 9).all()


@pytest.mark.parametrize("text", [True, False], ids=["ascii", "binary"])
def test_other_elements_stand_before_the_vertices(file, splat, text):
    before = np.array([(1, 2.0), (3, 4.0)], [("id", "i4"), ("size", "f4")])
    faces = np.array([([0, 1, 2],), ([0, 1, 2, 3],)], [("vertex_indices", object)])
    described = [
        PlyElement.describe(before, "camera"),
        PlyElement.describe(faces, "face", val_types={"vertex_indices": "i4"}),
        PlyElement.describe(vertices(file), "vertex"),
    ]
    PlyData(described, text=text).write(file)
    same(Gaussians.load_ply(file), splat)


@pytest.mark.parametrize("blank", [b"\n", b"\r\n", b"  \n\n"])
def test_blank_lines_in_a_text_file_are_skipped(file, splat, blank):
    rewrite(file, vertices(file), text=True)
    header, data = file.read_bytes().split(b"end_header\n")
    lines = data.splitlines(keepends=True)
    file.write_bytes(header + b"end_header\n" + blank + b"".join(lines[:7]) + blank + b"".join(lines[7:]))
    same(Gaussians.load_ply(file), splat)


@pytest.mark.parametrize("end", [b"\r\n", b"\r"])
@pytest.mark.parametrize("text", [True, False], ids=["ascii", "binary"])
def test_headers_have_line_ends_of_any_system(file, splat, end, text):
    rewrite(file, vertices(file), text=text)
    header, data = file.read_bytes().split(b"end_header\n")
    file.write_bytes(header.replace(b"\n", end) + b"end_header" + end + data)
    same(Gaussians.load_ply(file), splat)


def test_a_byte_order_mark_is_skipped(file, splat):
    rewrite(file, vertices(file), text=True)
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())
    same(Gaussians.load_ply(file), splat)


def test_a_comment_may_be_long_and_name_the_end_of_the_header(file, splat):
    comment = b"comment no end_header here " + b"x" * 200_000 + b"\n"
    with_header(file, lambda header: header.replace(b"element", comment + b"element", 1))
    same(Gaussians.load_ply(file), splat)


def only_nan(path: Path) -> None:
    rows = vertices(path).copy()
    rows["y"] = np.nan
    rewrite(path, rows)


def without(*gone: str):
    def change(path: Path) -> None:
        rows = vertices(path)
        names = [name for name in rows.dtype.names if name not in gone]
        kept = np.empty(len(rows), [(name, "f4") for name in names])
        for name in names:
            kept[name] = rows[name]
        rewrite(path, kept)

    return change


def renamed(path: Path) -> None:
    path.write_bytes(path.read_bytes().replace(b"f_rest_44\n", b"f_rest_45\n"))


def twice(path: Path) -> None:
    path.write_bytes(path.read_bytes().replace(b"property float ny\n", b"property float nx\n"))


def announcing(count: str, text: bool = False):
    def change(path: Path) -> None:
        if text:
            rewrite(path, vertices(path), text=True)
        with_header(path, lambda header: header.replace(b"vertex 50", b"vertex " + count.encode()))

    return change


def short_rows(path: Path) -> None:
    rewrite(path, vertices(path), text=True)
    path.write_bytes(path.read_bytes().replace(b" 0.", b" ", 1)[:-30])


def cloud(path: Path) -> None:
    rewrite(path, np.zeros(4, [("x", "f4"), ("y", "f4"), ("z", "f4"), ("red", "u1")]))


BAD_FILES = {
    "missing": (lambda path: path.unlink(), "no such file; give the path of a splat"),
    "folder": (lambda path: (path.unlink(), path.mkdir()), "no such file"),
    "empty": (lambda path: path.write_bytes(b""), "export it again"),
    "text": (lambda path: path.write_text("hello"), "not a .ply file"),
    "half a header": (lambda path: path.write_bytes(path.read_bytes()[:100]), "header is missing"),
    "truncated": (lambda path: path.write_bytes(path.read_bytes()[:-1]), "cut short or damaged"),
    "no rows": (lambda path: random_gaussians(0).save_ply(path), "holds no gaussians, it has 0 rows"),
    "only NaN": (only_nan, "none of its 50 gaussians is usable"),
    "point cloud": (cloud, "holds no gaussians; give a splat"),
    "faces only": (lambda path: rewrite(path, np.zeros(3, [("x", "f4")]), "face"), "holds no gaussians"),
    "no rot_3": (without("rot_3"), "property rot_3 is missing"),
    "no z": (without("z"), "holds no gaussians"),
    "no header end": (lambda path: with_header(path, lambda h: h[:40] + b"not_"), "header is missing"),
    "1e12 rows": (announcing("1000000000000"), "cannot read its 1000000000000 rows of vertex"),
    "1e12 rows of text": (announcing("1000000000000", text=True), "cannot read its 1000000000000 rows"),
    "rows before": (
        lambda path: with_header(
            path, lambda h: h.replace(b"element", b"element a 1000000000000\nproperty int b\nelement", 1)
        ),
        "cannot read its 1000000000000 rows of a",
    ),
    "negative rows": (announcing("-5"), "the .ply header has a line 'element vertex -5'"),
    "lists": (
        lambda path: with_header(
            path, lambda h: h.replace(b"property float nx", b"property list uchar int nx")
        ),
        "vertex holds lists",
    ),
    "short rows of text": (short_rows, "cut short or damaged"),
    "no f_dc_2": (without("f_dc_2"), "property f_dc_2 is missing"),
    "odd harmonics": (without("f_rest_44"), "44 properties f_rest_* fit no degree"),
    "gap in harmonics": (renamed, "property f_rest_44 is missing"),
    "property twice": (twice, "export it again"),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_unusable_files_are_one_line(file, case):
    damage, said = BAD_FILES[case]
    damage(file)
    with pytest.raises(InputError) as caught:
        read_splat(file)
    line = str(caught.value)
    assert line.startswith(f"{file}: ") and said in line and "\n" not in line


def test_a_place_that_cannot_be_written_is_one_line(tmp_path, splat):
    (tmp_path / "file").write_text("kept")
    with pytest.raises(InputError, match="cannot be written") as caught:
        splat.save_ply(tmp_path / "file" / "splat.ply")
    assert "\n" not in str(caught.value)
    assert (tmp_path / "file").read_text() == "kept"


def test_a_failed_write_keeps_the_old_file(file, splat, monkeypatch):
    before = file.read_bytes()
    full = OSError(28, "No space left on device")

    def no_space(self, target):
        raise full

    monkeypatch.setattr(Path, "replace", no_space)
    with pytest.raises(InputError, match="the disk is full"):
        splat.select(torch.arange(5)).save_ply(file)
    assert file.read_bytes() == before
    assert [entry.name for entry in file.parent.iterdir()] == ["splat.ply"]
