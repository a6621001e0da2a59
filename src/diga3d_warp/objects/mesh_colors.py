"""The colours of a mesh: of its corners, faces or textures, each times the colour of its material."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from diga3d_warp.materials.painting import GAMMA
from diga3d_warp.objects.wrapping import sampled

if TYPE_CHECKING:
    from PIL.Image import Image
    from trimesh import Trimesh

GREY = 0.7
"""Display value of a mesh without any colour."""

UNSET = 0.4
"""What trimesh takes for a material's colour where a file names none."""

TEXTURE_MOST = 2048
"""Longest side of a texture [texels]: an object in a photograph has about 1000 px, and finer detail would
flicker from view to view."""

CLEAR = 0.98
"""Opacity under which a surface counts as transparent [1]: mattes waver by some levels of 255."""

FaceColors = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Face (P,) and weights of its corners (P, 3) to display RGB (P, 3)."""


@dataclass(frozen=True, eq=False)
class MeshColors:
    """Colours of a mesh.

    Attributes:
        at: Its colours.
        colored: Whether it has any; grey if not.
        transparent: Whether some of it lets light through, which is not simulated.
    """

    at: FaceColors
    colored: bool = True
    transparent: bool = False


def mesh_colors(mesh: Trimesh, *, linear: bool) -> MeshColors:
    """The colours that a mesh brings along.

    Args:
        mesh: With a material or several, and vertex or face colours, or none of these.
        linear: Whether colours of materials and corners are linear light, as in glTF; else display values.
            Textures hold display values always.
    """
    visual: Any = mesh.visual
    faces = np.asarray(mesh.faces)
    materials = getattr(getattr(visual, "material", None), "materials", None)
    chosen = getattr(visual, "face_materials", None)
    if materials and chosen is not None and len(chosen) == len(faces):
        return _several(mesh, [_material(mesh, each, linear) for each in materials], np.asarray(chosen))
    if getattr(visual, "kind", None) == "texture":
        return _material(mesh, visual.material, linear)
    corners = _raw_colors(mesh)
    if corners is None and getattr(visual, "kind", None) == "vertex":
        corners = np.asarray(visual.vertex_colors, np.float64)[faces] / 255.0
    if corners is None and getattr(visual, "kind", None) == "face":
        corners = np.asarray(visual.face_colors, np.float64)[:, None].repeat(3, axis=1) / 255.0
    if corners is None:
        return MeshColors(_interpolated(np.full((*faces.shape, 3), GREY)), colored=False)
    return _plain(corners, linear)


def _several(mesh: Trimesh, parts: list[MeshColors], chosen: np.ndarray) -> MeshColors:
    """Colours of a mesh each of whose faces has one of several materials."""

    def at(face: np.ndarray, weights: np.ndarray) -> np.ndarray:
        colors = np.full((len(face), 3), GREY)
        for index, part in enumerate(parts):
            rows = chosen[face] == index
            if rows.any():
                colors[rows] = part.at(face[rows], weights[rows])
        return colors

    used = [part for index, part in enumerate(parts) if (chosen == index).any()]
    return MeshColors(at, any(part.colored for part in used), any(part.transparent for part in used))


def _material(mesh: Trimesh, material: Any, linear: bool) -> MeshColors:
    """A material's colour times its texture times the colours of the corners."""
    faces = np.asarray(mesh.faces)
    factor = _factor(material, linear)
    image = _texture_of(material)
    visual: Any = mesh.visual
    uv, corners = visual.uv, visual.vertex_attributes.get("color")
    if corners is not None and len(corners) == len(mesh.vertices):
        corners = _units(np.asarray(corners))[faces]
    else:
        corners = None
    if image is None or uv is None or len(uv) != len(mesh.vertices):
        if factor is None and corners is None:
            return MeshColors(_interpolated(np.full((*faces.shape, 3), GREY)), colored=False)
        flat = np.ones((*faces.shape, 4)) if corners is None else _with_alpha(corners)
        return _plain(flat * (1.0 if factor is None else factor), linear, _heeds_alpha(material))
    texture, transparent = _texels(image)
    places = np.nan_to_num(np.asarray(uv, np.float64)[faces])
    power = 1.0 if linear else GAMMA
    scale = np.ones(3) if factor is None else factor[:3] ** power

    def at(face: np.ndarray, weights: np.ndarray) -> np.ndarray:
        place = (places[face] * weights[..., None]).sum(axis=1)
        light = (sampled(texture, place[:, 0], 1.0 - place[:, 1]) / 255.0) ** GAMMA * scale
        if corners is not None:
            light = light * (corners[face] * weights[..., None]).sum(axis=1)[:, :3] ** power
        return np.clip(light, 0.0, 1.0) ** (1.0 / GAMMA)

    faint = factor is not None and factor[3] < CLEAR
    return MeshColors(at, transparent=(transparent or faint) and _heeds_alpha(material))


def _plain(corners: np.ndarray, linear: bool, heeds_alpha: bool = True) -> MeshColors:
    """Colours between those of the corners, shape (F, 3, 3 or 4), in [0, 1]."""
    colors = np.clip(corners[..., :3], 0.0, 1.0)
    transparent = corners.shape[2] == 4 and bool((corners[..., 3] < CLEAR).any())
    at = _interpolated(colors, 1.0 / GAMMA if linear else 1.0)
    return MeshColors(at, transparent=transparent and heeds_alpha)


def _interpolated(colors: np.ndarray, power: float = 1.0) -> FaceColors:
    """Colours between those at the corners of each face, shape (F, 3, 3), to a power."""

    def at(face: np.ndarray, weights: np.ndarray) -> np.ndarray:
        return (colors[face] * weights[..., None]).sum(axis=1) ** power

    return at


def _factor(material: Any, linear: bool) -> np.ndarray | None:
    """The colour of a material itself, RGBA in [0, 1], shape (4,); None if it names none.

    Many exporters write a black Kd beside a texture and mean the texture.
    """
    if linear or hasattr(material, "baseColorFactor"):
        found = getattr(material, "baseColorFactor", None)
        return None if found is None else _with_alpha(_units(np.asarray(found)))
    given = getattr(material, "kwargs", None) or {}
    diffuse = np.asarray(material.diffuse, np.float64) / 255.0
    unset = "kd" not in given and np.allclose(diffuse[:3], UNSET)
    if unset or (_texture_of(material) is not None and not diffuse[:3].any()):
        return None
    opacity = _number(given.get("d"), 1.0) * (1.0 - _number(given.get("tr"), 0.0))
    return np.array([*diffuse[:3], diffuse[3] * opacity])


def _number(words: Any, default: float) -> float:
    try:
        return float(words[-1])
    except (TypeError, ValueError, LookupError):
        return default


def _heeds_alpha(material: Any) -> bool:
    """Whether a material means its alpha: glTF's ignore it unless they say otherwise."""
    return not hasattr(material, "baseColorFactor") or material.alphaMode in ("MASK", "BLEND")


def _texture_of(material: Any) -> Image | None:
    """The picture of a material's base colour; what trimesh makes up for a file without one is none."""
    found = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    made_up = found is not None and found.size == (2, 2) and found.format is None
    return None if made_up else found


def _texels(picture: Image) -> tuple[np.ndarray, bool]:
    """A picture as display RGB, shape (H, W, 3), uint8, and whether some of it is transparent."""
    from PIL import Image

    if picture.mode.startswith("I") or picture.mode == "F":  # 16 bits or more; `convert` would clip them
        values = np.asarray(picture, np.float64)
        top = 65535.0 if picture.mode.startswith("I") else 1.0
        picture = Image.fromarray(np.clip(255.0 * values / top, 0, 255).astype(np.uint8))
    whole = picture.convert("RGBA")
    transparent = int(np.asarray(whole)[..., 3].min()) < 255 * CLEAR
    shrink = max(whole.size) / TEXTURE_MOST
    plain = whole.convert("RGB")
    if shrink > 1.0:
        width, height = (max(1, round(side / shrink)) for side in plain.size)
        plain = plain.resize((width, height), Image.Resampling.BOX)
    return np.asarray(plain), transparent


def _raw_colors(mesh: Trimesh) -> np.ndarray | None:
    """Colours of a .ply at the corners of each face, shape (F, 3, 4), where they are no bytes.

    trimesh takes the lowest byte of each.
    """
    raw = mesh.metadata.get("_ply_raw", {}) if mesh.metadata else {}
    faces = np.asarray(mesh.faces)
    for element, count in (("face", len(faces)), ("vertex", len(mesh.vertices))):
        data = raw.get(element, {}).get("data")
        names = raw.get(element, {}).get("properties", {})
        if data is None or not all(channel in names for channel in ("red", "green", "blue")):
            continue
        channels = [np.asarray(data[name]).reshape(-1) for name in ("red", "green", "blue")]
        if len(channels[0]) != count or channels[0].dtype == np.uint8:
            continue
        colors = _with_alpha(_units(np.stack(channels, axis=-1)))
        return colors[faces] if element == "vertex" else colors[:, None].repeat(3, axis=1)
    return None


def _units(colors: np.ndarray) -> np.ndarray:
    """Colours as floats in [0, 1], whatever numbers they are stored as."""
    if np.issubdtype(colors.dtype, np.floating):
        values = np.nan_to_num(colors.astype(np.float64))
        top = float(values.max(initial=0.0))
        return np.clip(values / (255.0 if top > 2.0 else 1.0), 0.0, 1.0)
    return np.clip(colors / (255.0 if int(colors.max(initial=0)) <= 255 else 65535.0), 0.0, 1.0)


def _with_alpha(colors: np.ndarray) -> np.ndarray:
    """Colours (..., 3 or 4) as RGBA."""
    if colors.shape[-1] == 4:
        return colors
    return np.concatenate([colors, np.ones((*colors.shape[:-1], 1))], axis=-1)
