"""Mesh files in the ways that exporters write them: every colour arrives, and what does not is said."""

import io
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial, SimpleMaterial

from diga3d_warp.errors import InputError
from diga3d_warp.objects.asset import MeshAsset, read_asset
from written_files import announced, gltf

RED, GREEN, BLUE = np.eye(3)


def colors_of(asset: MeshAsset) -> np.ndarray:
    """Colour of each face in its middle, shape (F, 3)."""
    face = np.arange(len(asset.faces))
    weights = np.full((len(face), 3), 1 / 3)
    points = asset.vertices[asset.faces].mean(axis=1)
    return asset.painter(face, weights, points, asset.normals.mean(axis=1))


def places_of(asset: MeshAsset) -> np.ndarray:
    """Middle of each face, shape (F, 3)."""
    return asset.vertices[asset.faces].mean(axis=1)


def outward(asset: MeshAsset) -> float:
    """Volume, positive where faces look outwards."""
    a, b, c = (asset.vertices[asset.faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->i", a - [0, 0, 0.5], np.cross(b - a, c - a)).sum() / 6)


def picture(color, size=8, mode="RGB") -> Image.Image:
    return Image.new(mode, (size, size), tuple(int(255 * value) for value in color))


def box(at=(0, 0, 0), visual=None) -> trimesh.Trimesh:
    mesh = trimesh.creation.box((1, 1, 1))
    mesh.apply_translation(at)
    if visual is not None:
        mesh.visual = visual
    return mesh


def texture(color, mesh=None, mode="RGB", **material) -> TextureVisuals:
    """A texture of one colour over a mesh."""
    uv = np.random.default_rng(0).random((len((mesh or box()).vertices), 2))
    return TextureVisuals(uv=uv, material=PBRMaterial(baseColorTexture=picture(color, mode=mode), **material))


def check_boxes(asset: MeshAsset, expected, tolerance=0.02) -> None:
    """Boxes beside each other along x have these colours."""
    x, colors = places_of(asset)[:, 0], colors_of(asset)
    edges = np.linspace(asset.vertices[:, 0].min(), asset.vertices[:, 0].max(), 2 * len(expected))
    for k, color in enumerate(expected):
        inside = (x > edges[2 * k] - 1e-6) & (x < edges[2 * k + 1] + 1e-6)
        assert inside.sum() == 12 and np.allclose(colors[inside], color, atol=tolerance), (k, colors[inside])


def test_each_mesh_of_a_file_keeps_its_own_colours(tmp_path):
    """Corners, faces, a material's colour, a texture, and none: one beside the other."""
    corners, faces = box((0, 0, 0)), box((2, 0, 0))
    corners.visual.vertex_colors = [255, 0, 0, 255]
    faces.visual.face_colors = [0, 255, 0, 255]
    plain = box((4, 0, 0), TextureVisuals(material=PBRMaterial(baseColorFactor=[0, 0, 255, 255])))
    textured, bare = box((6, 0, 0), texture((1, 1, 0))), box((8, 0, 0))
    scene = trimesh.Scene([corners, faces, plain, textured, bare])
    scene.export(tmp_path / "mixed.glb")
    asset = read_asset(tmp_path / "mixed.glb")
    check_boxes(asset, [RED, GREEN, BLUE, (1, 1, 0), (0.7, 0.7, 0.7)], 0.04)
    assert asset.notes == ("mixed.glb: some of its parts have no colours; shown in grey",)


def test_a_texture_is_multiplied_by_its_material_and_its_corners(tmp_path):
    """All three are factors of linear light in glTF."""
    tinted = box(visual=texture((1, 1, 1), baseColorFactor=[255, 51, 0, 255]))
    tinted.export(tmp_path / "tinted.glb")
    expected = np.array([1.0, 0.2, 0.0]) ** (1 / 2.2)
    assert np.allclose(colors_of(read_asset(tmp_path / "tinted.glb")), expected, atol=0.01)
    both = box((0, 0, 0), texture((1, 1, 0)))
    both.visual.vertex_attributes["color"] = np.tile(np.array([[255, 0, 255, 255]], np.uint8), (8, 1))
    scene = trimesh.Scene([both])
    scene.export(tmp_path / "both.glb")
    assert np.allclose(colors_of(read_asset(tmp_path / "both.glb")), RED, atol=0.01)


def test_instances_stand_where_their_nodes_put_them(tmp_path):
    """One mesh placed three times: moved, made larger, mirrored; faces look outwards everywhere."""
    scene = trimesh.Scene()
    scene.add_geometry(box(visual=texture((0, 1, 0))), geom_name="box", node_name="a")
    for name, x, scale in (("b", 2.0, (1, 1, 1)), ("c", 4.0, (-1, 1, 1))):
        matrix = np.diag([*scale, 1.0])
        matrix[0, 3] = x
        scene.graph.update(frame_from="world", frame_to=name, geometry="box", matrix=matrix)
    scene.export(tmp_path / "instances.glb")
    asset = read_asset(tmp_path / "instances.glb")
    assert len(asset.faces) == 36 and np.allclose(asset.extent, np.array([5, 1, 1]) / 5)
    check_boxes(asset, [GREEN, GREEN, GREEN])
    assert outward(asset) == pytest.approx(3 / 125)
    flat = np.cross(*(asset.vertices[asset.faces[:, k]] - asset.vertices[asset.faces[:, 0]] for k in (1, 2)))
    assert ((asset.normals * flat[:, None]).sum(axis=2) > 0).all()


@pytest.mark.parametrize("ending", ["stl", "ply", "glb"])
def test_a_body_turned_inside_out_is_turned_back(tmp_path, ending):
    ball = trimesh.creation.icosphere(subdivisions=2)
    ball.invert()
    ball.export(tmp_path / f"ball.{ending}")
    asset = read_asset(tmp_path / f"ball.{ending}")
    assert outward(asset) > 0.4
    towards = asset.vertices[asset.faces] - [0, 0, 0.5]
    assert ((asset.normals * towards).sum(axis=2) > 0.45).all(), "smooth, and outwards"


def with_nan(path: Path) -> None:
    mesh = trimesh.creation.icosphere(subdivisions=1)
    mesh.vertices[0] = np.nan
    mesh.export(path)


@pytest.mark.parametrize("ending", ["ply", "glb", "off"])
def test_faces_that_are_not_finite_are_left_out_and_noted(tmp_path, ending):
    with_nan(tmp_path / f"ball.{ending}")
    asset = read_asset(tmp_path / f"ball.{ending}")
    assert 70 <= len(asset.faces) < 80 and np.isfinite(asset.vertices).all()
    assert any("of 80 faces have corners that are not finite" in note for note in asset.notes)


def test_faces_without_area_and_empty_meshes_do_not_matter(tmp_path):
    mesh = box()
    mesh.faces = np.concatenate([mesh.faces, [[0, 0, 1], [2, 2, 2]]])
    scene = trimesh.Scene([mesh, trimesh.Trimesh(np.zeros((3, 3)), np.zeros((0, 3), int), process=False)])
    scene.export(tmp_path / "box.glb")
    asset = read_asset(tmp_path / "box.glb")
    assert len(asset.faces) == 12 and np.allclose(np.linalg.norm(asset.normals, axis=2), 1.0)


def test_points_and_lines_are_left_out_and_noted(tmp_path):
    cloud = trimesh.PointCloud(np.random.default_rng(0).random((20, 3)) * 100)
    trimesh.Scene([box(), cloud]).export(tmp_path / "box.glb")
    asset = read_asset(tmp_path / "box.glb")
    assert len(asset.faces) == 12 and np.allclose(asset.extent, 1.0)
    assert "box.glb: its points and lines are left out; only triangles are drawn" in asset.notes


def test_too_many_faces_are_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr("diga3d_warp.objects.mesh_file.FACES_MOST", 11)
    box().export(tmp_path / "box.glb")
    with pytest.raises(InputError, match="has 12 faces; simplify it to at most 11"):
        read_asset(tmp_path / "box.glb")


def test_a_texture_repeats_beyond_its_border_and_keeps_its_mean(tmp_path):
    mesh = box(visual=texture((0.2, 0.6, 0.4)))
    mesh.visual.uv = np.random.default_rng(0).uniform(-7, 9, (8, 2))
    mesh.export(tmp_path / "box.glb")
    assert np.allclose(colors_of(read_asset(tmp_path / "box.glb")), (0.2, 0.6, 0.4), atol=0.01)


@pytest.mark.parametrize(("mode", "noted"), [(None, False), ("BLEND", True), ("MASK", True)])
def test_transparency_is_noted_where_it_is_meant(tmp_path, mode, noted):
    box(visual=texture((1, 0, 0, 0.3), mode="RGBA", alphaMode=mode)).export(tmp_path / "glass.glb")
    asset = read_asset(tmp_path / "glass.glb")
    assert np.allclose(colors_of(asset), RED, atol=0.01)
    assert any("transparent" in note for note in asset.notes) == noted


@pytest.mark.parametrize(
    ("image", "expected"),
    [
        (Image.fromarray(np.full((8, 8), 32896, np.uint16)), 0.5),
        (picture((0.25,), mode="L"), 0.25),
        (picture((0.5, 0.5, 0.5)).quantize(4), 0.5),
        (picture((0.5, 1.0), mode="LA"), 0.5),
        (picture((0.5, 0.5, 0.5), size=1), 0.5),
    ],
    ids=["16 bit", "grey", "palette", "grey with alpha", "one texel"],
)
def test_textures_of_every_depth(tmp_path, image, expected):
    mesh = box()
    material = PBRMaterial(baseColorTexture=image)
    mesh.visual = TextureVisuals(uv=np.zeros((8, 2)), material=material)
    mesh.export(tmp_path / "box.glb")
    assert np.allclose(colors_of(read_asset(tmp_path / "box.glb")), expected, atol=0.01)


# --- glTF, written by hand -------------------------------------------------------------------------------


def halves() -> bytes:
    """A picture that is red to the left and green to the right."""
    pixels = np.zeros((16, 16, 3), np.uint8)
    pixels[:, :8, 0] = pixels[:, 8:, 1] = 255
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "PNG")
    return file.getvalue()


def textured(**reference) -> dict:
    return {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0, **reference}}}


LEFT, RIGHT = np.full((4, 2), 0.25, "<f4"), np.full((4, 2), 0.75, "<f4")


@pytest.mark.parametrize("ending", ["glb", "gltf"])
def test_the_set_of_texture_coordinates_is_the_materials(tmp_path, ending):
    path = tmp_path / f"square.{ending}"
    sets = {"TEXCOORD_0": LEFT, "TEXCOORD_1": RIGHT}
    for chosen, color in ((0, RED), (1, GREEN)):
        gltf(path, sets, textured(texCoord=chosen), halves())
        assert np.allclose(colors_of(read_asset(path)), color, atol=0.01)


def test_texture_coordinates_of_16_bits_and_their_transform(tmp_path):
    short = {"TEXCOORD_0": np.full((4, 2), 0.75 * 65535).astype("<u2")}
    path = gltf(tmp_path / "short.glb", short, textured(), halves())
    assert np.allclose(colors_of(read_asset(path)), GREEN, atol=0.01)
    moved = textured(extensions={"KHR_texture_transform": {"offset": [0.5, 0.0]}})
    path = gltf(tmp_path / "moved.glb", {"TEXCOORD_0": LEFT}, moved, halves())
    assert np.allclose(colors_of(read_asset(path)), GREEN, atol=0.01)


@pytest.mark.parametrize("dtype", ["<f4", "<u2", "|u1"])
@pytest.mark.parametrize("material", [None, {"pbrMetallicRoughness": {"baseColorFactor": [1, 1, 0.2, 1]}}])
def test_colours_of_corners_in_every_number_format(tmp_path, dtype, material):
    top = 1.0 if dtype == "<f4" else np.iinfo(dtype).max
    colors = (np.tile([0.5, 0.1, 1.0, 1.0], (4, 1)) * top).astype(dtype)
    asset = read_asset(gltf(tmp_path / "square.glb", {"COLOR_0": colors}, material))
    expected = np.array([0.5, 0.1, 0.2 if material else 1.0]) ** (1 / 2.2)
    assert np.allclose(colors_of(asset), expected, atol=0.01) and not asset.notes


def test_a_texture_file_that_is_missing_is_noted(tmp_path):
    factor = {"pbrMetallicRoughness": {**textured()["pbrMetallicRoughness"], "baseColorFactor": [1, 0, 0, 1]}}
    path = gltf(tmp_path / "square.gltf", {"TEXCOORD_0": LEFT}, factor, {"uri": "wood.png"})
    asset = read_asset(path)
    assert np.allclose(colors_of(asset), RED, atol=0.01), "the material's colour is left"
    assert asset.notes == ("square.gltf: texture wood.png is missing; its surfaces have no texture",)
    (tmp_path / "wood.png").write_bytes(halves())
    asset = read_asset(path)
    assert np.allclose(colors_of(asset), RED, atol=0.01) and not asset.notes


KTX = b"\xabKTX 20\xbb\r\n\x1a\n" + b"\0" * 60
DRACO = {
    "extensionsRequired": ["KHR_draco_mesh_compression"],
    "extensionsUsed": ["KHR_draco_mesh_compression"],
}
BAD_GLTF = {
    "ktx": ({"image": KTX}, "its textures are KTX2"),
    "basisu": (
        {"image": KTX, "textures": [{"extensions": {"KHR_texture_basisu": {"source": 0}}}]},
        "its textures are KTX2",
    ),
    "meshopt": ({"extensionsRequired": ["EXT_meshopt_compression"]}, "compressed with meshopt"),
    "other": ({"extensionsRequired": ["EXT_unheard_of"]}, "needs EXT_unheard_of, which is not read"),
    "bomb": ({"image": announced(30000, 30000)}, "too many pixels for a texture"),
    "no picture": ({"image": b"hello"}, "not readable as an image"),
    "half a picture": ({"image": announced(64, 64)}, "not readable as an image"),
}


@pytest.mark.parametrize("name", BAD_GLTF)
@pytest.mark.parametrize("ending", ["glb", "gltf"])
def test_gltf_that_cannot_be_read_rightly_is_one_line(tmp_path, name, ending):
    options, said = BAD_GLTF[name]
    path = gltf(tmp_path / f"square.{ending}", {"TEXCOORD_0": LEFT}, textured(), **options)
    with pytest.raises(InputError, match=said) as caught:
        read_asset(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_draco_is_one_line_where_it_cannot_be_unpacked(tmp_path, monkeypatch):
    monkeypatch.setattr("diga3d_warp.objects.gltf.find_spec", lambda name: None)
    path = gltf(tmp_path / "square.glb", **DRACO)
    with pytest.raises(InputError, match="compressed with Draco, which is not read"):
        read_asset(path)


def test_an_extension_that_is_passed_over_is_noted(tmp_path):
    asset = read_asset(gltf(tmp_path / "square.glb", extensionsUsed=["EXT_mesh_gpu_instancing"]))
    assert "square.glb: EXT_mesh_gpu_instancing of glTF is not read" in asset.notes


@pytest.mark.parametrize(
    "text", ["[1]", "{", '{"meshes": 3}', "[" * 100_000, '{"accessors": [{}], "meshes": {}}']
)
def test_damaged_gltf_is_one_line(tmp_path, text):
    (tmp_path / "bad.gltf").write_text(text)
    with pytest.raises(InputError) as caught:
        read_asset(tmp_path / "bad.gltf")
    assert "bad.gltf" in str(caught.value) and "\n" not in str(caught.value)


def test_a_format_that_needs_another_library_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "collada", None)
    (tmp_path / "thing.dae").write_text("<COLLADA></COLLADA>")
    with pytest.raises(InputError, match=r"thing.dae: .*collada.*export it as .glb") as caught:
        read_asset(tmp_path / "thing.dae")
    assert "\n" not in str(caught.value)


# --- .obj and .ply ---------------------------------------------------------------------------------------

QUAD = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0.25 0.5\nvt 0.25 0.5\nvt 0.25 0.5\nvt 0.25 0.5\n"
FACE = "f 1/1 2/2 3/3 4/4\n"


def obj(folder: Path, mtl: str | None = "newmtl a\nmap_Kd wood.png\n", text: str | None = None) -> Path:
    (folder / "quad.obj").write_text(text or f"mtllib quad.mtl\n{QUAD}usemtl a\n{FACE}")
    if mtl is not None:
        (folder / "quad.mtl").write_text(mtl)
    return folder / "quad.obj"


@pytest.mark.parametrize(
    "called",
    [
        "wood.png",
        "textures\\wood.png",
        "C:\\Users\\me\\Wood.PNG",
        "-s 1 1 1 wood.png",
        "./wood.png",
        "../x/wood.png",
    ],
)
def test_a_texture_is_found_under_the_name_that_another_machine_gave_it(tmp_path, called):
    (tmp_path / "wood.png").write_bytes(halves())
    asset = read_asset(obj(tmp_path, f"newmtl a\nmap_Kd {called}\n"))
    assert np.allclose(colors_of(asset), RED, atol=0.01) and not asset.notes


@pytest.mark.parametrize(
    ("kd", "expected"), [("", RED), ("Kd 0.5 1 1\n", 0.5 * RED), ("Kd 0 0 0\n", RED), ("d 1\n", RED)]
)
def test_a_texture_of_an_obj_is_multiplied_by_kd(tmp_path, kd, expected):
    (tmp_path / "wood.png").write_bytes(halves())
    asset = read_asset(obj(tmp_path, f"newmtl a\n{kd}map_Kd wood.png\n"))
    assert np.allclose(colors_of(asset), expected, atol=0.01) and not asset.notes


def test_what_is_missing_beside_an_obj_is_noted(tmp_path):
    asset = read_asset(obj(tmp_path, "newmtl a\nKd 0 1 0\nmap_Kd wood.png\n"))
    assert np.allclose(colors_of(asset), GREEN, atol=0.01)
    assert any("'wood.png' is missing" in note for note in asset.notes)
    asset = read_asset(obj(tmp_path, "newmtl other\nKd 1 0 0\n"))
    assert any("material a not in quad.mtl" in note for note in asset.notes)
    (tmp_path / "quad.mtl").unlink()
    asset = read_asset(obj(tmp_path, None))
    assert any("'quad.mtl' is missing" in note for note in asset.notes)
    assert any("no colours; shown in grey" in note for note in asset.notes)


def test_several_material_files_and_colours_in_one_obj(tmp_path):
    (tmp_path / "one.mtl").write_text("newmtl a\nKd 1 0 0\n")
    (tmp_path / "two.mtl").write_text("newmtl b\nKd 0 1 0\n")
    faces = "usemtl a\nf 1 2 3\nusemtl b\nf 1 3 4\n"
    for header in ("mtllib one.mtl\nmtllib two.mtl\n", "mtllib one.mtl two.mtl\n"):
        asset = read_asset(obj(tmp_path, None, f"{header}{QUAD}{faces}"))
        assert sorted(colors_of(asset).round(2).tolist()) == [[0, 1, 0], [1, 0, 0]] and not asset.notes


def test_colours_of_corners_are_not_hidden_by_a_plain_material(tmp_path):
    corners = "".join(f"v {x} {y} 0 1 0 0\n" for x, y in ((0, 0), (1, 0), (1, 1), (0, 1)))
    text = f"mtllib quad.mtl\n{corners}usemtl a\nf 1 2 3 4\n"
    asset = read_asset(obj(tmp_path, "newmtl a\nKd 0.8 0.8 0.8\n", text))
    assert np.allclose(colors_of(asset), RED, atol=0.01) and not asset.notes


def test_a_bomb_beside_an_obj_is_one_line(tmp_path):
    (tmp_path / "wood.png").write_bytes(announced(30000, 30000))
    with pytest.raises(InputError, match=r"wood.png: too many pixels for a texture"):
        read_asset(obj(tmp_path))


@pytest.mark.parametrize(("kind", "top"), [("uchar", 255), ("ushort", 65535), ("float", 1.0), ("int", 255)])
@pytest.mark.parametrize("element", ["vertex", "face"])
def test_colours_of_a_ply_in_every_number_format(tmp_path, kind, top, element):
    colors = f"{0.5 * top if kind == 'float' else int(0.5 * top)} 0 {top}"
    channels = "".join(f"property {kind} {name}\n" for name in ("red", "green", "blue"))
    own = [channels if element == name else "" for name in ("vertex", "face")]
    header = "ply\nformat ascii 1.0\nelement vertex 3\n"
    header += "".join(f"property float {axis}\n" for axis in "xyz") + own[0]
    header += f"element face 1\nproperty list uchar int vertex_indices\n{own[1]}end_header\n"
    rows = [f"{x} {y} 0" + (f" {colors}" if element == "vertex" else "") for x, y in ((0, 0), (1, 0), (0, 1))]
    rows.append("3 0 1 2" + (f" {colors}" if element == "face" else ""))
    (tmp_path / "one.ply").write_text(header + "\n".join(rows) + "\n")
    asset = read_asset(tmp_path / "one.ply")
    assert np.allclose(colors_of(asset), (0.5, 0.0, 1.0), atol=0.01) and not asset.notes


def test_simple_materials_are_display_values(tmp_path):
    mesh = box(visual=TextureVisuals(material=SimpleMaterial(diffuse=[128, 0, 0, 255])))
    mesh.export(tmp_path / "box.obj")
    assert np.allclose(colors_of(read_asset(tmp_path / "box.obj")), (0.5, 0, 0), atol=0.01)
