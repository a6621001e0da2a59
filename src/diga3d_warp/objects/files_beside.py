"""The files beside a mesh: materials and textures, found under the names by which the mesh calls them."""

from __future__ import annotations

import re
from functools import cached_property
from pathlib import Path, PureWindowsPath
from typing import Any

from diga3d_warp.errors import InputError
from diga3d_warp.objects.gltf import check_texture

PICTURES = (".png", ".jpg", ".jpeg", ".webp", ".tga", ".bmp", ".tif", ".tiff", ".gif")
"""Endings of textures beside a mesh."""


class FilesBeside:
    """Resolver of the files that a mesh refers to, for trimesh.

    Names often come from another machine: with its folders, backslashes, options, or in other upper and lower
    case. trimesh passes over what it does not get, so what is missing is noted here.

    Args:
        path: The mesh.
        notes: Gets a line for each thing that is missing.
    """

    def __init__(self, path: Path, notes: list[str]) -> None:
        self.path, self.notes = path, notes
        self._error: InputError | None = None

    def resolver(self) -> Any:
        """For trimesh's `resolver`."""
        from trimesh.resolvers import FilePathResolver

        read = self.read

        class Resolver(FilePathResolver):
            def get(self, name: str) -> bytes:
                return read(name)

        return Resolver(str(self.path))

    def read(self, name: str) -> bytes:
        """A file that the mesh names.

        Raises:
            FileNotFoundError: it is missing, or cannot be used, which `check` then says.
        """
        if self.libraries and name.strip() == self.libraries[0]:
            return self._materials.encode()
        file = self._file(name) or self._file(name.split()[-1] if name.split() else "")  # after options
        if file is None:
            self._note(f"{name.strip()[:80]!r} is missing; what it belongs to has no texture")
            raise FileNotFoundError(name)
        data = file.read_bytes()
        if file.suffix.lower() in PICTURES:
            try:
                check_texture(data, str(file))
            except InputError as error:
                self._error = error
                raise FileNotFoundError(name) from error
        return data

    def check(self) -> None:
        """After reading: note materials that are missing.

        Raises:
            InputError: a texture is damaged or too large.
        """
        if self._error is not None:
            raise self._error
        if self.only_corners_are_colored:
            return
        defined = set(re.findall(r"^\s*newmtl\s+(.+?)\s*$", self._materials, re.MULTILINE))
        missing = sorted(self._used - defined)
        if missing:
            names = ", ".join(name[:40] for name in missing[:5]) + (", ..." if len(missing) > 5 else "")
            where = f"not in {', '.join(self.libraries)}" if self.libraries else "and no .mtl file is named"
            self._note(f"material {names} {where}; what is made of it has no colour")

    @property
    def only_corners_are_colored(self) -> bool:
        """Whether an .obj colours its corners, and its materials are plain: those would hide the colours."""
        colored = re.search(r"^v(?:\s+[-+.\deE]+){6,7}\s*$", self._text, re.MULTILINE)
        return colored is not None and re.search(r"^\s*map_Kd\s", self._materials, re.MULTILINE) is None

    @cached_property
    def libraries(self) -> list[str]:
        """What an .obj names after mtllib, line by line."""
        return [line.strip() for line in re.findall(r"^\s*mtllib\s+(.+)$", self._text, re.MULTILINE)]

    @cached_property
    def _text(self) -> str:
        """An .obj; nothing of other files."""
        if self.path.suffix.lower() != ".obj":
            return ""
        return self.path.read_text(encoding="utf-8", errors="replace")

    @cached_property
    def _used(self) -> set[str]:
        return set(re.findall(r"^\s*usemtl\s+(.+?)\s*$", self._text, re.MULTILINE))

    @cached_property
    def _materials(self) -> str:
        """All .mtl files of an .obj; trimesh reads the first only."""
        found = []
        for library in self.libraries:
            whole = self._file(library)  # names may hold spaces, or be several
            files = [whole] if whole else [self._file(name) for name in library.split()]
            for name, file in zip(library.split(), files, strict=False):
                if file is None:
                    self._note(f"material file {name[:80]!r} is missing")
            found += [file.read_text(encoding="utf-8", errors="replace") for file in files if file]
        return "\n".join(found)

    def _file(self, name: str) -> Path | None:
        """The file that a name means."""
        name = name.strip().strip("\"'")
        folder = self.path.parent
        last = PureWindowsPath(name).name
        for candidate in (name, name.replace("\\", "/"), last, f"textures/{last}"):
            file = folder / candidate
            if candidate and file.is_file():
                return file
        alike = [file for file in folder.iterdir() if file.name.lower() == last.lower() and file.is_file()]
        return alike[0] if alike else None

    def _note(self, line: str) -> None:
        line = f"{self.path.name}: {line}"
        if line not in self.notes:
            self.notes.append(line)
