"""Files written byte by byte, as exporters write them and libraries here do not."""

import json
import struct
import zlib
from pathlib import Path

import numpy as np


def announced(width: int, height: int) -> bytes:
    """A PNG that announces a size, with next to no data."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    body = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"\0" * 64)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body


CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], "<f4")
INDICES = np.array([0, 1, 2, 0, 2, 3], "<u2")


def gltf(path: Path, attributes=None, material=None, image=None, *, external=False, **document) -> Path:
    """A square of two triangles.

    Args:
        path: A .glb, or a .gltf with its data in the file or, if external, beside it.
        attributes: Arrays by their names in glTF.
        material: Of the square.
        image: Bytes of texture 0.
    """
    arrays = {"POSITION": CORNERS, **(attributes or {})}
    binary, views, accessors = b"", [], []

    def store(data: bytes) -> int:
        nonlocal binary
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(data)})
        binary += data + b"\0" * (-len(data) % 4)
        return len(views) - 1

    def accessor(array: np.ndarray) -> int:
        kind = {"<f4": 5126, "<u2": 5123, "|u1": 5121}[array.dtype.str]
        shape = "SCALAR" if array.ndim == 1 else f"VEC{array.shape[1]}"
        limits = {"min": array.min(0).tolist(), "max": array.max(0).tolist()} if array.ndim == 2 else {}
        normalized = {"normalized": True} if array.ndim == 2 and kind != 5126 else {}
        accessors.append({
            "bufferView": store(array.tobytes()), "componentType": kind, "count": len(array), "type": shape,
            **limits, **normalized,
        })  # fmt: skip
        return len(accessors) - 1

    names = {name: accessor(array) for name, array in arrays.items()}
    primitive = {"attributes": names, "indices": accessor(INDICES)}
    made = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}], "accessors": accessors, "bufferViews": views,
    }  # fmt: skip
    if material is not None:
        primitive["material"] = 0
        made["materials"] = [material]
    if image is not None:
        made["textures"] = [{"source": 0}]
        made["images"] = [image] if isinstance(image, dict) else [{"bufferView": store(image)}]
    made |= document
    made["buffers"] = [{"byteLength": len(binary)}]
    if path.suffix == ".gltf":
        made["buffers"][0]["uri"] = "square.bin"
        path.with_name("square.bin").write_bytes(binary)
        path.write_text(json.dumps(made))
        return path
    text = json.dumps(made).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<II", len(binary), 0x004E4942) + binary
    path.write_bytes(struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks)
    return path
