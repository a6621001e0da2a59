"""Assets: solids named by a prompt, meshes and splats from files, and one line for those that are neither."""

from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from diga3d_warp.errors import InputError
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.objects.asset import MeshAsset, SplatAsset, read_asset
from diga3d_warp.objects.solids import ALSO, SOLIDS, solid_of


def colors_at(asset: MeshAsset, corners=(1 / 3, 1 / 3, 1 / 3)) -> np.ndarray:
    """Colour of each face at one place in it, shape (F, 3)."""
    face = np.arange(len(asset.faces))
    weights = np.broadcast_to(corners, (len(face), 3))
    points = (asset.vertices[asset.faces] * weights[..., None]).sum(axis=1)
    normals = (asset.normals * weights[..., None]).sum(axis=1)
    return asset.painter(face, weights, points, normals / np.linalg.norm(normals, axis=1, keepdims=True))


@pytest.mark.parametrize("name", SOLIDS)
def test_a_solid_stands_on_its_base_and_faces_outwards(name):
    asset = solid_of(f"a golden {name}", seed=0)
    assert asset.vertices[:, 2].min() == pytest.approx(0.0)
    assert asset.extent.max() == pytest.approx(1.0)
    assert np.abs(asset.vertices[:, :2].max(0) + asset.vertices[:, :2].min(0)).max() < 1e-6
    a, b, c = (asset.vertices[asset.faces[:, k]] for k in range(3))
    flux = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
    assert flux > 0.02, "its volume, positive where faces look outwards"
    facing = np.einsum("ijk,ik->ij", asset.normals, np.cross(b - a, c - a))
    assert (facing > -1e-12).all()
    colors = colors_at(asset)
    assert colors[:, 0].mean() > 1.5 * colors[:, 2].mean(), "gold is yellow"


def test_other_words_name_solids():
    assert set(ALSO.values()) <= set(SOLIDS) and not set(ALSO) & set(SOLIDS)
    assert len(solid_of("a marble ball", 0).faces) == len(solid_of("a marble sphere", 0).faces)


@pytest.mark.parametrize(
    ("prompt", "said"),
    [
        ("", "the prompt is empty"),
        ("wood " * 2000, "10000 characters"),
        ("a wooden unicorn", "'a wooden unicorn' names no built-in solid: use one of cube, sphere"),
        ("an adamantine cube", "names no built-in material: use one of wood"),
    ],
)
def test_prompts_that_name_no_solid(prompt, said):
    with pytest.raises(InputError) as caught:
        solid_of(prompt, 0)
    assert said in str(caught.value) and "\n" not in str(caught.value)


def test_a_mesh_keeps_its_colours_and_is_turned_upright(tmp_path):
    """A box of y-up glTF, 2 high and 1 wide, red above and blue below."""
    box = trimesh.creation.box((1, 2, 1)).subdivide().subdivide()
    box.visual.vertex_colors = np.where(box.vertices[:, 1:2] > 0, [[255, 0, 0, 255]], [[0, 0, 255, 255]])
    box.export(tmp_path / "box.glb")
    asset = read_asset(tmp_path / "box.glb")
    assert isinstance(asset, MeshAsset)
    assert np.allclose(asset.extent, [0.5, 0.5, 1.0])
    height = asset.vertices[asset.faces].mean(axis=1)[:, 2]
    colors = colors_at(asset)
    red = colors @ [1, 0, -1]
    assert (red[height > 0.8] > 0.9).all() and (red[height < 0.2] < -0.9).all()


def test_a_mesh_keeps_its_texture(tmp_path):
    from PIL import Image

    quad = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 0.2, 1], [0, 0.2, 1]], [[0, 1, 2], [0, 2, 3]])
    picture = np.zeros((64, 64, 3), np.uint8)
    picture[:32, :, 1], picture[32:, :, 2] = 255, 255  # green above blue
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float64)
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.fromarray(picture))
    quad.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    turned = quad.copy()
    turned.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]))  # to y up
    turned.export(tmp_path / "quad.glb")
    asset = read_asset(tmp_path / "quad.glb")
    centers = asset.vertices[asset.faces].mean(axis=1)
    for corners in np.eye(3) * 0.8 + 0.2 / 3:
        points = (asset.vertices[asset.faces] * corners[:, None]).sum(axis=1)
        for color, height in zip(colors_at(asset, corners), points[:, 2], strict=True):
            if abs(height - 0.5) > 0.1:
                assert color[1 if height > 0.5 else 2] > 0.9
    assert np.ptp(centers[:, 2]) > 0.1


def test_a_splat_is_an_asset(tmp_path):
    rng = np.random.default_rng(0)
    means = rng.uniform([3, 3, 3], [4, 5, 7], (400, 3))
    quaternions = torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(400, 1)
    sh = torch.rand(400, 4, 3, generator=torch.Generator().manual_seed(0))
    means = torch.from_numpy(means.astype(np.float32))
    splat = Gaussians(means, torch.full((400, 3), -3.0), quaternions, torch.full((400,), 3.0), sh)
    splat.save_ply(tmp_path / "thing.ply")
    asset = read_asset(tmp_path / "thing.ply")
    assert isinstance(asset, SplatAsset)
    assert np.allclose(asset.extent, [0.25, 0.5, 1.0], atol=0.04)
    assert asset.gaussians.means[:, 2].min() > -0.02
    assert np.allclose(asset.gaussians.log_scales, -3.0 - np.log(4.0), atol=0.05)
    vertices, faces = asset.hull
    assert faces.min() >= 0 and faces.max() < len(vertices)


def nothing(path: Path) -> None:
    """No file."""


def text(path: Path) -> None:
    path.write_text("this is no mesh")


def half(path: Path) -> None:
    trimesh.creation.icosphere().export(path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 3])


def points_only(path: Path) -> None:
    trimesh.PointCloud(np.random.default_rng(0).random((20, 3))).export(path)


@pytest.mark.parametrize(
    ("name", "spoil"),
    [
        ("absent.glb", nothing),
        ("text.glb", text),
        ("text.obj", text),
        ("text.ply", text),
        ("half.glb", half),
        ("half.ply", half),
        ("points.ply", points_only),
        ("picture.xyz123", text),
    ],
)
def test_files_that_are_no_asset_are_one_line(tmp_path, name, spoil):
    spoil(tmp_path / name)
    with pytest.raises(InputError) as caught:
        read_asset(tmp_path / name)
    assert name in str(caught.value) and "\n" not in str(caught.value)
