"""Cases of what an edit is given beside the capture: prompts, pictures, assets, priors."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from expectations import Refuses, case
from field_room import FieldRoom, write_picture

from written_files import announced, gltf


def masked(room: FieldRoom, folder: Path) -> Path:
    """The room in COLMAP's form with masks."""
    room.colmap(folder)
    for name, mask in room.masks.items():
        write_picture(folder / "masks" / f"{name}.png", mask.astype(np.uint8) * 255)
    return folder


def retexture(*options: str) -> tuple[str, ...]:
    return ("retexture", "--iterations", "2", *options)


def replace(*options: str) -> tuple[str, ...]:
    return ("replace", "--iterations", "2", *options)


DENIED = ("name the material that is wanted",)


@case(Refuses(("says 'not'", *DENIED), retexture("--prompt", "not wood")))
def prompt_that_denies(room: FieldRoom, folder: Path) -> Path:
    return masked(room, folder)


@case(Refuses(("says 'without'", *DENIED), replace("--prompt", "a marble cube without veins")))
def prompt_of_a_solid_that_denies(room: FieldRoom, folder: Path) -> Path:
    return masked(room, folder)


@case(Refuses(("'kryptonite' names no built-in material",), retexture("--prompt", "kryptonite")))
def prompt_of_an_unknown_material(room: FieldRoom, folder: Path) -> Path:
    return masked(room, folder)


@case(Refuses(("the prompt is empty",), retexture("--prompt", "...")))
def prompt_without_words(room: FieldRoom, folder: Path) -> Path:
    return masked(room, folder)


PICTURE = ("--exemplar", "{scene}/wood.png")


@case(Refuses(("wood.png: alpha is 0 everywhere",), retexture(*PICTURE)))
def picture_that_is_transparent(room: FieldRoom, folder: Path) -> Path:
    pixels = np.random.default_rng(0).integers(0, 255, (64, 64, 4), np.uint8)
    pixels[..., 3] = 0
    cv2.imwrite(str(masked(room, folder) / "wood.png"), pixels)
    return folder


@case(Refuses(("wood.png", "30000 x 30000 px"), retexture(*PICTURE)))
def picture_of_too_many_pixels(room: FieldRoom, folder: Path) -> Path:
    (masked(room, folder) / "wood.png").write_bytes(announced(30000, 30000))
    return folder


@case(Refuses(("wood.png: 1 x 1 px; give at least 32",), replace("--prompt", "a cube", *PICTURE)))
def picture_of_one_pixel(room: FieldRoom, folder: Path) -> Path:
    cv2.imwrite(str(masked(room, folder) / "wood.png"), np.zeros((1, 1, 3), np.uint8))
    return folder


ASSET = ("--asset", "{scene}/thing.glb")
UV = {"TEXCOORD_0": np.zeros((4, 2), "<f4")}
TEXTURED = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}


@case(Refuses(("thing.glb", "too many pixels for a texture"), replace(*ASSET)))
def asset_with_a_texture_of_too_many_pixels(room: FieldRoom, folder: Path) -> Path:
    gltf(masked(room, folder) / "thing.glb", UV, TEXTURED, announced(30000, 30000))
    return folder


@case(Refuses(("thing.glb", "compressed with meshopt"), replace(*ASSET)))
def asset_compressed_with_meshopt(room: FieldRoom, folder: Path) -> Path:
    gltf(masked(room, folder) / "thing.glb", extensionsRequired=["EXT_meshopt_compression"])
    return folder


@case(Refuses(("thing.glb", "its textures are KTX2"), replace(*ASSET)))
def asset_with_ktx_textures(room: FieldRoom, folder: Path) -> Path:
    ktx = b"\xabKTX 20\xbb\r\n\x1a\n" + bytes(60)
    gltf(masked(room, folder) / "thing.glb", UV, TEXTURED, ktx)
    return folder


@case(Refuses(("thing.glb: not readable as a mesh",), replace(*ASSET)))
def asset_cut_short(room: FieldRoom, folder: Path) -> Path:
    path = gltf(masked(room, folder) / "thing.glb")
    path.write_bytes(path.read_bytes()[:200])
    return folder


@case(Refuses(("prior",), ("remove", "--iterations", "2", "--prior", "")))
def prior_without_a_name(room: FieldRoom, folder: Path) -> Path:
    return masked(room, folder)
