"""Built-in solids, named by a prompt such as "a golden sphere", in a material or a picture of one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from diga3d_warp.errors import InputError
from diga3d_warp.materials.prompt import no_material, read_prompt, shown
from diga3d_warp.objects.asset import MeshAsset, mesh_asset
from diga3d_warp.objects.frame import Frame
from diga3d_warp.objects.mesh_file import mesh_part
from diga3d_warp.objects.picture import picture_material
from diga3d_warp.objects.sheen import polished
from diga3d_warp.objects.wrapping import wrap

if TYPE_CHECKING:
    from trimesh import Trimesh

TEXTURE = 512
"""Edge of the texture on a solid [texels]; a solid shows about one repeat over its height."""


def _revolved(profile: list[tuple[float, float]]) -> Trimesh:
    """A profile of (radius, height) from the bottom up, turned about z."""
    from trimesh.creation import revolve

    return revolve(np.array(profile), sections=72)


def _cube() -> Trimesh:
    from trimesh.creation import box

    return box((1.0, 1.0, 1.0))


def _sphere() -> Trimesh:
    from trimesh.creation import icosphere

    return icosphere(subdivisions=5, radius=0.5)


def _torus() -> Trimesh:
    from trimesh.creation import torus

    return torus(0.35, 0.15, major_sections=96, minor_sections=48)


def _pyramid() -> Trimesh:
    from trimesh import Trimesh

    corners = [(-0.5, -0.5, 0), (0.5, -0.5, 0), (0.5, 0.5, 0), (-0.5, 0.5, 0), (0, 0, 0.8)]
    return Trimesh(corners, [(0, 2, 1), (0, 3, 2), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)])


def _vase() -> Trimesh:
    profile = [(0.0, 0.0), (0.16, 0.0), (0.18, 0.02), (0.26, 0.2), (0.29, 0.38), (0.24, 0.58), (0.14, 0.74)]
    lip = [(0.10, 0.84), (0.115, 0.93), (0.15, 1.0), (0.13, 0.99), (0.09, 0.86), (0.10, 0.7), (0.0, 0.66)]
    return _revolved([*profile, *lip])


SOLIDS: dict[str, Callable[[], Trimesh]] = {
    "cube": _cube,
    "sphere": _sphere,
    "cylinder": lambda: _revolved([(0.0, 0.0), (0.32, 0.0), (0.32, 1.0), (0.0, 1.0)]),
    "cone": lambda: _revolved([(0.0, 0.0), (0.4, 0.0), (0.0, 1.0)]),
    "torus": _torus,
    "pyramid": _pyramid,
    "vase": _vase,
}
"""The solids by name."""

ALSO = {
    "box": "cube", "block": "cube", "dice": "cube", "ball": "sphere", "globe": "sphere", "orb": "sphere",
    "column": "cylinder", "pillar": "cylinder", "can": "cylinder", "ring": "torus", "donut": "torus",
    "doughnut": "torus", "jar": "vase", "pot": "vase",
}  # fmt: skip
"""Other words for them."""

THINGS = {**{name: name for name in SOLIDS}, **ALSO}


def solid_of(prompt: str, seed: int, exemplar: Path | None = None) -> MeshAsset:
    """The solid that a prompt names, in the material that it names.

    Args:
        prompt: Such as "a wooden cube".
        seed: Seed of the material's texture.
        exemplar: A picture of the material, in place of the one that the prompt names.

    Raises:
        InputError: the prompt is empty or too long, or names no built-in solid or no material, or the picture
            is not usable.
    """
    reading = read_prompt(prompt, THINGS)
    if reading.thing is None:
        raise InputError(
            f"the prompt {shown(prompt)} names no built-in solid: use one of {', '.join(SOLIDS)}, or --asset "
            "FILE; for free text use --prior sd-inpainting or --prior powerpaint"
        )
    notes = [*reading.notes]
    if exemplar is not None:
        material = picture_material(exemplar)
        notes += [*material.notes, *(["the material is the picture's"] if reading.material else [])]
    elif reading.material is not None:
        material = reading.material
    else:
        raise no_material(prompt)
    texture = material.exemplar(TEXTURE, seed).astype(np.float64)
    frame = Frame(np.zeros(3), np.eye(3), np.ones(3))

    def painted(_: np.ndarray, __: np.ndarray, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        return polished(wrap(texture, points, normals, frame, period=1.0), normals, material.polish)

    part = mesh_part(SOLIDS[reading.thing]())
    return mesh_asset([part], upright_y=False, name=prompt, painter=painted, notes=tuple(notes))
