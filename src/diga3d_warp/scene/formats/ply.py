"""Elements of a .ply file, ASCII or binary, as structured arrays."""

from __future__ import annotations

import codecs
import re
import struct
from collections.abc import Collection
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import BinaryIO

import numpy as np

from diga3d_warp.errors import InputError

_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float": "f4", "double": "f8", "float32": "f4", "float64": "f8",
}  # fmt: skip
_BYTE_ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}
_HEADER_LIMIT = 1 << 20  # bytes; a 3DGS header takes 2 kB, comments may hold a whole command line or JSON
_HEADER_END = re.compile(rb"[\r\n]end_header[ \t]*(\r\n|\n|\r)")
_ASCII_LEAST = 2  # bytes of a number in a text file, with the space or line end after it
_MISSING_LINE_END = 1  # byte that a text file may lack after its last number


@dataclass(frozen=True)
class Property:
    """One column of an element.

    Attributes:
        name: Its name.
        kind: NumPy type of the values, without byte order.
        count_kind: NumPy type of the length before each list; None for a plain number.
    """

    name: str
    kind: str
    count_kind: str | None = None


@dataclass(frozen=True)
class Element:
    """One table of the file.

    Attributes:
        name: "vertex", "face", "chunk", ...
        count: Number of rows that the header announces.
        properties: Its columns.
    """

    name: str
    count: int
    properties: tuple[Property, ...]

    @property
    def names(self) -> frozenset[str]:
        """Names of the columns."""
        return frozenset(column.name for column in self.properties)

    @property
    def plain(self) -> bool:
        """Whether all columns are plain numbers, so that rows have one size."""
        return all(column.count_kind is None for column in self.properties)

    def row_size(self, form: str) -> int:
        """Bytes that a row takes at least: a list may be empty, a number in a text have one digit."""
        if form == "ascii":
            return len(self.properties) * _ASCII_LEAST
        return sum(np.dtype(column.count_kind or column.kind).itemsize for column in self.properties)

    def layout(self, order: str) -> np.dtype:
        """The row as a structured NumPy type, for plain elements."""
        return np.dtype([(column.name, order + column.kind) for column in self.properties])


@dataclass(frozen=True)
class Header:
    """What the header of a .ply says.

    Attributes:
        size: Length of the header [bytes].
        form: "ascii", "binary_little_endian" or "binary_big_endian".
        elements: In the order of the file.
        comments: Text of the comment lines.
    """

    size: int
    form: str
    elements: tuple[Element, ...]
    comments: tuple[str, ...]

    def element(self, name: str) -> Element | None:
        """The element of this name, if there is one."""
        return next((element for element in self.elements if element.name == name), None)


def read_header(path: Path) -> Header:
    """Read the header of a .ply file, with line ends of any system.

    Raises:
        InputError: the file cannot be read, is not a .ply, or its header is damaged.
    """
    try:
        with path.open("rb") as file:
            start = file.read(_HEADER_LIMIT)
    except OSError as error:
        raise InputError(f"{path} cannot be read ({(error.strerror or '').lower()})") from error
    end = _HEADER_END.search(start)
    if not start.removeprefix(codecs.BOM_UTF8).startswith(b"ply") or end is None:
        raise InputError(f"{path}: not a .ply file, its header is missing; export it again")
    form = ""
    comments: list[str] = []
    elements: list[tuple[str, int, list[Property]]] = []
    for line in start[: end.start()].decode("latin-1").splitlines():
        match line.split():
            case ["comment", *_]:
                comments.append(line.strip().removeprefix("comment").strip())
            case ["format", form, *_]:
                pass
            case ["element", name, count] if count.isascii() and count.isdecimal():
                elements.append((name, int(count), []))
            case ["property", "list", count_kind, kind, name] if elements and {count_kind, kind} <= set(
                _TYPES
            ):
                elements[-1][2].append(Property(name, _TYPES[kind], _TYPES[count_kind]))
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1][2].append(Property(name, _TYPES[kind]))
            case ["element" | "property", *_]:
                raise InputError(f"{path}: the .ply header has a line {line.strip()!r}; export it again")
    if form not in _BYTE_ORDERS or not elements:
        raise InputError(f"{path}: the .ply header names no known format or no element; export it again")
    for name, _, properties in elements:
        if len({column.name for column in properties}) < len(properties):
            raise InputError(f"{path}: the .ply header names a property of {name} twice; export it again")
    return Header(
        end.end(),
        form,
        tuple(Element(name, count, tuple(properties)) for name, count, properties in elements),
        tuple(comments),
    )


def read_elements(path: Path, header: Header, wanted: Collection[str]) -> dict[str, np.ndarray]:
    """Read elements of a .ply file, wherever in the file they stand.

    Nothing is allocated before the file is known to be long enough for the rows that it announces.

    Args:
        path: The file.
        header: Its header.
        wanted: Names of elements whose columns are plain numbers; those that the file lacks are left out.

    Returns:
        Structured arrays with one field per property, by the name of the element.

    Raises:
        InputError: the file is cut short or damaged, or a wanted element holds lists.
    """
    remaining = set(wanted) & {element.name for element in header.elements}
    found: dict[str, np.ndarray] = {}
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(header.size)
        for element in header.elements:
            if not remaining:
                break
            damaged = InputError(
                f"{path}: cut short or damaged: cannot read its {element.count} rows of {element.name}; "
                "export it again"
            )
            if element.count * element.row_size(header.form) > size - file.tell() + _MISSING_LINE_END:
                raise damaged
            if element.name in remaining and not element.plain:
                raise InputError(f"{path}: {element.name} holds lists instead of numbers; export it again")
            try:
                if element.name in remaining:
                    found[element.name] = _read(file, element, header.form)
                    remaining.remove(element.name)
                else:
                    _skip(file, element, header.form, size)
            except (ValueError, struct.error) as error:
                raise damaged from error
    return found


def read_vertices(path: Path) -> np.ndarray:
    """Vertices of a .ply file, a structured array with one field per property.

    Raises:
        InputError: the file is not a .ply, is cut short, or holds no vertices of plain numbers.
    """
    header = read_header(path)
    if header.element("vertex") is None:
        raise InputError(f"{path}: the .ply holds no vertices; export it again")
    return read_elements(path, header, {"vertex"})["vertex"]


def _read(file: BinaryIO, element: Element, form: str) -> np.ndarray:
    layout = element.layout(_BYTE_ORDERS[form])
    if form != "ascii":
        rows = np.fromfile(file, layout, element.count)
        if len(rows) < element.count:
            raise ValueError("fewer rows than the header says")
        return rows
    rows = np.empty(element.count, layout)
    if element.count == 0 or not element.properties:
        return rows
    lines = islice(filter(bytes.strip, file), element.count)
    table = np.loadtxt(lines, np.float64, comments=None, ndmin=2)
    if table.shape != (element.count, len(element.properties)):
        raise ValueError("rows of other lengths than the header says")
    for column, name in enumerate(layout.names or ()):
        with np.errstate(invalid="ignore", over="ignore"):
            rows[name] = table[:, column]
    return rows


def _skip(file: BinaryIO, element: Element, form: str, size: int) -> None:
    """Move behind an element that nobody wants."""
    if form == "ascii":
        count = sum(1 for _ in islice(filter(bytes.strip, file), element.count if element.properties else 0))
        if element.properties and count < element.count:
            raise ValueError("fewer rows than the header says")
        return
    order = _BYTE_ORDERS[form]
    if element.plain:
        file.seek(element.count * element.layout(order).itemsize, 1)
        return
    for _ in range(element.count):
        for column in element.properties:
            length = 1
            if column.count_kind is not None:
                count_type = np.dtype(column.count_kind)
                length = struct.unpack(order + count_type.char, file.read(count_type.itemsize))[0]
            if length < 0 or file.seek(length * np.dtype(column.kind).itemsize, 1) > size:
                raise ValueError("a list beyond the end of the file")
