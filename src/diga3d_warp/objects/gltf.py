"""glTF files made plain for trimesh: one binary, with colours and texture coordinates as floats.

trimesh reads the first set of texture coordinates only, takes normalised integers as they are, and passes
over what it does not know. Here the file is rewritten so that none of that is lost, or it is refused.
"""

from __future__ import annotations

import base64
import io
import json
import re
import struct
import urllib.parse
import warnings
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from diga3d_warp.errors import InputError

_GLB, _JSON, _BINARY = 0x46546C67, 0x4E4F534A, 0x004E4942
_DTYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}

_COMPRESSED = {
    "KHR_draco_mesh_compression": "Draco",
    "EXT_meshopt_compression": "meshopt",
    "KHR_meshopt_compression": "meshopt",
}
_READ = re.compile(
    "KHR_materials_.*|KHR_texture_(transform|basisu)|KHR_mesh_quantization|KHR_draco_mesh_compression"
    "|KHR_lights_punctual|EXT_texture_webp|KHR_xmp.*|EXT_lights_.*"
)
"""Extensions that are followed, or that change nothing of shape and base colour."""


def plain_gltf(path: Path) -> tuple[bytes, list[str]]:
    """A .glb or .gltf as one .glb that trimesh reads rightly.

    Args:
        path: The file. Buffers and images that it names lie beside it.

    Returns:
        The .glb, and a note for each thing that is left out.

    Raises:
        InputError: it is compressed in a way that is not read, its textures are, or they are too large.
        ValueError, LookupError, TypeError, OSError: it is damaged.
    """
    document, binary = _container(path)
    file = _Gltf(path, document, binary)
    file.check_extensions()
    file.gather_buffers()
    file.gather_images()
    file.make_plain()
    return file.packed(), file.notes


def _container(path: Path) -> tuple[dict[str, Any], bytes | None]:
    """The JSON of a file, and its binary chunk if it has one."""
    data = path.read_bytes()
    if len(data) < 12 or struct.unpack_from("<I", data)[0] != _GLB:
        return _object(json.loads(data.decode("utf-8-sig"))), None
    version = struct.unpack_from("<I", data, 4)[0]
    if version != 2:
        raise ValueError(f"glTF {version}, where 2 is read")
    document, binary, position = None, None, 12
    while position + 8 <= len(data):
        length, kind = struct.unpack_from("<II", data, position)
        chunk = data[position + 8 : position + 8 + length]
        if len(chunk) < length:
            raise ValueError("the file is cut short")
        if kind == _JSON and document is None:
            document = _object(json.loads(chunk.decode("utf-8")))
        elif kind == _BINARY and binary is None:
            binary = chunk
        position += 8 + length
    if document is None:
        raise ValueError("it holds no JSON")
    return document, binary


def _object(found: Any) -> dict[str, Any]:
    if not isinstance(found, dict):
        raise ValueError("its JSON is no object")
    return found


class _Gltf:
    """A glTF file that is being rewritten.

    Attributes:
        document: Its JSON.
        binary: All of its buffers, one behind another.
        notes: What is left out.
    """

    def __init__(self, path: Path, document: dict[str, Any], binary: bytes | None) -> None:
        self.path, self.document, self.notes = path, document, list[str]()
        self.binary = bytearray()
        self._chunk = binary

    def check_extensions(self) -> None:
        """Refuse what cannot be read, and note what is passed over."""
        required = set(self.document.get("extensionsRequired", []))
        used = set(self.document.get("extensionsUsed", [])) | required
        for name, what in _COMPRESSED.items():
            readable = name == "KHR_draco_mesh_compression" and find_spec("DracoPy") is not None
            if name in required and not readable:
                raise InputError(
                    f"{self.path}: its mesh is compressed with {what}, which is not read; export it without "
                    "compression"
                )
        other = sorted(name for name in used if not _READ.fullmatch(name) and name not in _COMPRESSED)
        refused = [name for name in other if name in required]
        if refused:
            raise InputError(f"{self.path}: needs {', '.join(refused)}, which is not read; export it without")
        if other:
            self.notes.append(f"{self.path.name}: {', '.join(other)} of glTF is not read")

    def gather_buffers(self) -> None:
        """Put all buffers into one."""
        starts = []
        for index, buffer in enumerate(self.document.get("buffers", [])):
            uri = buffer.get("uri")
            if uri is None and (index > 0 or self._chunk is None):
                raise ValueError("a buffer has no data")
            data = self._chunk if uri is None else self._bytes_of(uri)
            assert data is not None
            if len(data) < buffer["byteLength"]:
                raise ValueError("a buffer is cut short")
            starts.append(self._append(data))
        for view in self.document.get("bufferViews", []):
            view["byteOffset"] = view.get("byteOffset", 0) + starts[view.get("buffer", 0)]
            view["buffer"] = 0

    def gather_images(self) -> None:
        """Put the images of base colours into the buffer; drop all others."""
        wanted: set[int] = set()
        for material in self.document.get("materials", []):
            texture = _base_texture(material)
            if texture is not None:
                wanted |= {source for source in (self._image_of(texture),) if source is not None}
        for index, image in enumerate(self.document.get("images", [])):
            data = self._image(image) if index in wanted else None
            kept = {"name": image.get("name", "")} if data is None else self._stored(data)
            image.clear()
            image.update(kept)

    def make_plain(self) -> None:
        """Colours and texture coordinates of every triangle as floats, those that its base colour takes."""
        materials = self.document.setdefault("materials", [])
        bare: int | None = None
        for mesh in self.document.get("meshes", []):
            for primitive in mesh.get("primitives", []):
                if "material" not in primitive:
                    # With a material, trimesh keeps the colours as they are; without, it rounds them.
                    if bare is None:
                        bare = len(materials)
                        materials.append({"name": ""})
                    primitive["material"] = bare
                self._plain(primitive, materials[primitive["material"]])

    def packed(self) -> bytes:
        """The file as a .glb."""
        self.document["buffers"] = [{"byteLength": len(self.binary)}]
        text = json.dumps(self.document).encode()
        text += b" " * (-len(text) % 4)
        self.binary += b"\0" * (-len(self.binary) % 4)
        chunks = struct.pack("<II", len(text), _JSON) + text
        chunks += struct.pack("<II", len(self.binary), _BINARY) + bytes(self.binary)
        return struct.pack("<III", _GLB, 2, 12 + len(chunks)) + chunks

    def _plain(self, primitive: dict[str, Any], material: dict[str, Any]) -> None:
        attributes = primitive.get("attributes", {})
        texture = _base_texture(material)
        if texture is not None:
            transform = texture.get("extensions", {}).get("KHR_texture_transform", {})
            chosen = f"TEXCOORD_{transform.get('texCoord', texture.get('texCoord', 0))}"
            uv = self._floats(attributes.get(chosen))
            if uv is not None:
                attributes["TEXCOORD_0"] = self._store_floats(_moved(uv[:, :2], transform))
            elif chosen != "TEXCOORD_0":
                attributes.pop("TEXCOORD_0", None)
        colors = self._floats(attributes.get("COLOR_0"))
        if colors is not None:
            attributes["COLOR_0"] = self._store_floats(colors)

    def _floats(self, index: int | None) -> np.ndarray | None:
        """An accessor's numbers, shape (N, width), normalised ones in [-1, 1]; None if it has no data."""
        if index is None:
            return None
        accessor = self.document["accessors"][index]
        if "bufferView" not in accessor or "sparse" in accessor:
            return None  # compressed, or patched: trimesh fills it in
        dtype, width = np.dtype(_DTYPES[accessor["componentType"]]), _WIDTHS[accessor["type"]]
        view = self.document["bufferViews"][accessor["bufferView"]]
        count, row = int(accessor["count"]), dtype.itemsize * width
        stride = view.get("byteStride", row)
        start = view["byteOffset"] + accessor.get("byteOffset", 0)
        if count < 1 or start + (count - 1) * stride + row > len(self.binary):
            raise ValueError("an accessor reaches beyond its buffer")
        rows = np.lib.stride_tricks.as_strided(
            np.frombuffer(self.binary, np.uint8, (count - 1) * stride + row, start), (count, row), (stride, 1)
        )
        numbers = np.ascontiguousarray(rows).view(dtype).reshape(count, width).astype(np.float32)
        if dtype.kind == "f":
            return numbers
        return np.maximum(numbers / np.iinfo(dtype).max, -1.0) if accessor.get("normalized") else numbers

    def _store_floats(self, numbers: np.ndarray) -> int:
        data = np.ascontiguousarray(numbers, "<f4").tobytes()
        view = self._store(data)
        kind = next(name for name, width in _WIDTHS.items() if width == numbers.shape[1])
        accessor = {"bufferView": view, "componentType": 5126, "count": len(numbers), "type": kind}
        self.document["accessors"].append(accessor)
        return len(self.document["accessors"]) - 1

    def _image_of(self, texture: dict[str, Any]) -> int | None:
        """The image of a texture, one that can be decoded where it offers several."""
        found = self.document["textures"][texture["index"]]
        extensions = found.get("extensions", {})
        webp = extensions.get("EXT_texture_webp", {}).get("source")
        source = found.get("source") if webp is None else webp
        if source is None and "KHR_texture_basisu" in extensions:
            raise self._ktx()
        return source

    def _image(self, image: dict[str, Any]) -> bytes | None:
        """An image's file; None, with a note, where it is missing."""
        name = image.get("name") or _short(image.get("uri", "")) or "a texture"
        try:
            data = self._view(image["bufferView"]) if "bufferView" in image else self._bytes_of(image["uri"])
        except (OSError, LookupError, ValueError):
            self.notes.append(f"{self.path.name}: texture {name} is missing; its surfaces have no texture")
            return None
        if data.startswith(b"\xabKTX"):
            raise self._ktx()
        check_texture(data, f"{self.path}: texture {name}")
        return data

    def _ktx(self) -> InputError:
        return InputError(
            f"{self.path}: its textures are KTX2, which is not read; export them as PNG or JPEG"
        )

    def _stored(self, data: bytes) -> dict[str, Any]:
        return {
            "bufferView": self._store(data),
            "mimeType": "image/png" if data[1:4] == b"PNG" else "image/jpeg",
        }

    def _store(self, data: bytes) -> int:
        view = {"buffer": 0, "byteOffset": self._append(data), "byteLength": len(data)}
        self.document.setdefault("bufferViews", []).append(view)
        return len(self.document["bufferViews"]) - 1

    def _append(self, data: bytes) -> int:
        self.binary += b"\0" * (-len(self.binary) % 4)
        start = len(self.binary)
        self.binary += data
        return start

    def _view(self, index: int) -> bytes:
        view = self.document["bufferViews"][index]
        return bytes(self.binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]])

    def _bytes_of(self, uri: str) -> bytes:
        if uri.startswith("data:"):
            return base64.b64decode(uri.partition(",")[2])
        return self.path.parent.joinpath(urllib.parse.unquote(uri)).read_bytes()


def _base_texture(material: dict[str, Any]) -> dict[str, Any] | None:
    """The texture of a material's base colour, as glTF refers to it."""
    glossy = material.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness", {})
    return glossy.get("diffuseTexture") or material.get("pbrMetallicRoughness", {}).get("baseColorTexture")


def _moved(uv: np.ndarray, transform: dict[str, Any]) -> np.ndarray:
    """Texture coordinates (N, 2) under KHR_texture_transform: scaled, turned, shifted."""
    angle, offset = transform.get("rotation", 0.0), np.array(transform.get("offset", (0.0, 0.0)))
    u, v = (uv * np.array(transform.get("scale", (1.0, 1.0)))).T
    cos, sin = np.cos(angle), np.sin(angle)
    return np.stack([cos * u + sin * v, -sin * u + cos * v], axis=-1) + offset


def _short(uri: str) -> str:
    return "" if uri.startswith("data:") else uri


def check_texture(data: bytes, name: str) -> None:
    """Refuse a texture that cannot be decoded; of one that announces too many pixels nothing is decoded.

    Pillow's own limit is 89 million pixels, which more than holds 8192 x 8192.

    Args:
        data: All of the image file.
        name: Name in errors and notes.

    Raises:
        InputError: it is no image, damaged, or larger than any texture should be.
    """
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(io.BytesIO(data)) as picture:
                picture.load()
    except (Image.DecompressionBombError, Image.DecompressionBombWarning) as error:
        raise InputError(f"{name}: too many pixels for a texture; scale it down to 8192 x 8192") from error
    except (OSError, SyntaxError, ValueError) as error:
        raise InputError(f"{name}: not readable as an image; export it again") from error
